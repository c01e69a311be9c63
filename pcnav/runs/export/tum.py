"""TUM: ``timestamp tx ty tz qx qy qz qw`` a line, as evo and the TUM tools read it."""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.runs.export.content import Export, Files, pose_numbers

ABOUT = (
    "T_cam_model a line: time stamp of the recording, s; position of the model's origin in the "
    "camera, m (x right, y down, z forward); quaternion scalar last. The truth of the same frames "
    "goes to NAME.truth.tum."
)


def write_tum(export: Export) -> Files:
    """Estimate and truth. Raises `InputError` for a run without poses."""
    frames, poses = export.poses()
    files = {"": _lines(export.stamps_s(export.run.time_s[frames]), poses)}
    truth = export.true_poses()
    if truth is not None:
        time_s, true = truth
        files["truth"] = _lines(export.stamps_s(time_s), true)
    return files


def _lines(stamp_s: FloatArray, T: FloatArray) -> bytes:
    rows = np.column_stack([stamp_s, pose_numbers(T)])
    return "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist()).encode()
