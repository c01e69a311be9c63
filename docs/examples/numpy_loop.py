"""From your own arrays to poses. Needs satellite.stl and frames.npz."""

import numpy as np

import pcnav

data = np.load("frames.npz")  # depth (n, height, width) m, time_s (n,), K (3, 3)
target = pcnav.Target.from_mesh("satellite.stl", unit="mm")
tracker = pcnav.Tracker(target, camera=data["K"])
for depth, t in zip(data["depth"], data["time_s"], strict=True):
    est = tracker.step(depth, t)
    print(est)
    if est.is_claimed:
        sd_mm = 1e3 * np.sqrt(np.diag(est.pose_covariance)[:3])
        print(est.pose, "+-", sd_mm, "mm")  # T_cam_model, 4 x 4

tracker.save("run")  # pcnav view run
