"""Own arrays as recordings that every command reads. Needs frames.npz: depth, time_s, K."""

from pathlib import Path

import numpy as np
from PIL import Image

import pcnav

data = np.load("frames.npz")  # depth (n, height, width) m, time_s (n,), K (3, 3)
depth = np.where(np.isfinite(data["depth"]) & (data["depth"] > 0.0), data["depth"], 0.0)
(fx, _, cx), (_, fy, cy), _ = data["K"]

# One file. T_cam_world (n, 4, 4) and true_T_cam_model (n, 4, 4) may go along.
np.savez("one.npz", depth=depth.astype(np.float32), time_s=data["time_s"], K=data["K"])

# An array and its camera; times come from --rate.
np.save("stack.npy", depth.astype(np.float32))
camera = f"fx = {fx}\nfy = {fy}\ncx = {cx}\ncy = {cy}\n"

# A folder of 16-bit images, here in steps of 0.1 mm.
folder = Path("folder")
folder.mkdir(exist_ok=True)
(folder / "depth_camera.toml").write_text(camera + "depth_scale = 0.1  # mm\n")
for k, image in enumerate(depth):
    Image.fromarray(np.rint(image * 1e4).astype(np.uint16)).save(folder / f"{k:06d}.png")
lines = [f"{t!r}" for t in data["time_s"].tolist()]
(folder / "times.csv").write_text("\n".join(["time_s", *lines]) + "\n")

# TUM RGB-D: a list of images by their stamps.
tum = Path("tum")
(tum / "depth").mkdir(parents=True, exist_ok=True)
(tum / "depth_camera.toml").write_text(camera)
for k, image in enumerate(depth):
    Image.fromarray(np.rint(image * 5000.0).astype(np.uint16)).save(tum / f"depth/{k:06d}.png")
listed = [f"{t!r} depth/{k:06d}.png" for k, t in enumerate(data["time_s"].tolist())]
(tum / "depth.txt").write_text("\n".join(listed) + "\n")

for place in ("one.npz", "folder", "tum"):
    print(place, len(pcnav.open_recording(place, "satellite.stl")))
