"""CSV: one row a frame with status, pose, its deviations and the true pose."""

import csv
import io

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.runs.export.content import Export, Files, pose_numbers
from pcnav.runs.export.pose_covariance import pose_covariances

ABOUT = (
    "One row a frame: frame, stamp_s, time_s, status; T_cam_model as x_m, y_m, z_m and the "
    "scalar-last quaternion q_x to q_w; standard deviations sd_x_m ... of the position and "
    "sd_rot_x_rad ... of the attitude about the camera's axes; true_x_m ... where the truth is "
    "known. Empty where there is no value."
)
_POSE = ("x_m", "y_m", "z_m", "q_x", "q_y", "q_z", "q_w")
_SD = ("sd_x_m", "sd_y_m", "sd_z_m", "sd_rot_x_rad", "sd_rot_y_rad", "sd_rot_z_rad")
COLUMNS = ("frame", "stamp_s", "time_s", "status", *_POSE, *_SD, *(f"true_{n}" for n in _POSE))


def write_csv_poses(export: Export) -> Files:
    """All frames. Raises `InputError` for a run without poses."""
    run, n = export.run, len(export.run)
    frames, poses = export.poses()
    values = np.full((n, 20), np.nan)
    values[frames, :7] = pose_numbers(poses)
    covariances = pose_covariances(export)
    if covariances is not None:
        variances = np.diagonal(covariances[frames], axis1=1, axis2=2)
        values[frames, 7:13] = np.sqrt(np.maximum(variances, 0.0))
    true = export.true_poses_at(np.arange(n))
    if true is not None:
        known = np.isfinite(true[:, 0, 0])
        values[known, 13:] = pose_numbers(true[known])
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(COLUMNS)
    stamps = export.stamps_s(run.time_s).tolist()
    for k, (stamp, time_s, row) in enumerate(zip(stamps, run.time_s.tolist(), values, strict=True)):
        table.writerow([k, stamp, time_s, run.status[k], *_fields(row)])
    return {"": text.getvalue().encode()}


def _fields(row: FloatArray) -> list[object]:
    return ["" if np.isnan(value) else value for value in row.tolist()]
