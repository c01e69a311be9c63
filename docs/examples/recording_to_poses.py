"""Frames of any recording that pcnav reads, taken one by one. Needs a folder frames."""

import pcnav

recording = pcnav.open_sequence("frames")
print(recording)
target = pcnav.Target.from_mesh(recording.info.target_mesh, recording.info.mesh_unit)
tracker = pcnav.Tracker(target, recording.camera(0), range_sigma_m=recording.info.range_sigma_m)
for frame in recording:
    near = frame.depth_m < 20.0  # your own idea of where the target may be
    print(tracker.step(frame.depth_m, frame.time_s, frame.T_cam_world, mask=near))
