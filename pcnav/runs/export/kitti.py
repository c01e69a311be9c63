"""KITTI: the first three rows of a pose a line, twelve numbers."""

from pcnav.core.arrays import FloatArray
from pcnav.runs.export.content import Export, Files

ABOUT = (
    "The upper three rows of T_cam_model a line, row by row, m. Only frames with an estimate have "
    "a line; their time stamps, s, are in NAME.times.kitti, and the true poses of the same "
    "frames, where all are known, in NAME.truth.kitti."
)


def write_kitti(export: Export) -> Files:
    """Estimate, time stamps and truth. Raises `InputError` for a run without poses."""
    frames, poses = export.poses()
    stamps = export.stamps_s(export.run.time_s[frames]).tolist()
    files = {"": _lines(poses), "times": "".join(f"{stamp!r}\n" for stamp in stamps).encode()}
    true = export.true_poses_at(frames)
    if true is not None and bool((true == true).all()):
        files["truth"] = _lines(true)
    return files


def _lines(T: FloatArray) -> bytes:
    rows = T[:, :3].reshape(-1, 12).tolist()
    return "".join(" ".join(map(repr, row)) + "\n" for row in rows).encode()
