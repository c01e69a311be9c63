"""Where the target will be, and how well that is known. Needs satellite.stl and frames.npz."""

import numpy as np

import pcnav

data = np.load("frames.npz")
tracker = pcnav.Tracker(pcnav.Target.from_mesh("satellite.stl", unit="mm"), camera=data["K"])
for depth, t in zip(data["depth"], data["time_s"], strict=True):
    tracker.step(depth, t)

for ahead_s in (1.0, 10.0, 60.0):
    est = tracker.predict(data["time_s"][-1] + ahead_s)
    if est.pose is None or est.pose_covariance is None:
        print(f"in {ahead_s:g} s: not known, {est.status}")
        continue
    sd = np.sqrt(np.diag(est.pose_covariance))
    print(f"in {ahead_s:g} s: at {est.pose[:3, 3]} m, sd {sd[:3].max():.3g} m,", end=" ")
    print(f"turned by sd {np.degrees(sd[3:].max()):.3g} deg")
