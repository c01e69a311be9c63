"""Reader of folders in the layout of the tsdf-fusion example data (7-Scenes recordings)."""

import logging
import re
from pathlib import Path

import numpy as np

from pcnav.config.recording import AS_IT_IS, RecordingTable
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import (
    invert_transform,
    make_transform,
    nearest_orthogonal,
    orthonormality_error,
)
from pcnav.files.regular_file import read_bytes
from pcnav.recordings.depth_form import DepthForm
from pcnav.recordings.depth_image import first_size
from pcnav.recordings.depth_png import MAXIMUM_UNITS
from pcnav.recordings.sequence import Sequence, SequenceInfo

INTRINSICS_FILE = "camera-intrinsics.txt"
POSE_TOLERANCE = 1e-2
"""Largest orthonormality error of a stored pose; such poses are tracked, and rounded."""

_DEPTH_NAME = re.compile(r"frame-(\d+)\.depth\.png")
_EXACT = 1e-9
_MAX_BYTES = 100_000
"""Of a file with one matrix."""
_LOG = logging.getLogger("pcnav")


def read_tsdf_fusion(
    path: Path,
    target_mesh: Path | None = None,
    skip_bad_frames: bool = False,
    table: RecordingTable = AS_IT_IS,
) -> Sequence:
    """frame-000000.depth.png (mm), frame-000000.pose.txt (camera to world), camera-intrinsics.txt.

    Depth 0 and 65535 mean no return. The format has no times and no noise figure: 0, 1, 2, ... s
    are assumed and the noise is unknown; poses are turned into the nearest rotation, all said in
    one warning. With ``skip_bad_frames`` images may be damaged, but for one. Raises `InputError`.
    """
    if not path.is_dir():
        raise InputError(path, "folder", f"expected a folder with {INTRINSICS_FILE}")
    matches = (_DEPTH_NAME.fullmatch(file.name) for file in path.iterdir())
    names = [match for match in matches if match is not None]
    if not names:
        raise InputError(path, "folder", "expected images named frame-000000.depth.png")
    names.sort(key=lambda match: int(match[1]))
    n, files = len(names), tuple(match[0] for match in names)
    K = _matrix(path / INTRINSICS_FILE, 3)
    _require_pinhole(path / INTRINSICS_FILE, K)
    poses = [_pose(path / f"frame-{match[1]}.pose.txt") for match in names]
    worst = max(error for _, error in poses)
    assumed = "0, 1, 2, ... s assumed; the range noise is unknown"
    if worst > _EXACT:
        assumed += f"; poses replaced by the nearest rotation (off by up to {worst:.1e})"
    _LOG.warning("%s: %s", path, assumed)
    return Sequence(
        path=path,
        info=SequenceInfo(path.absolute().name, 0.0, None, target_mesh),
        images=path,
        files=files,
        size=first_size(path, files, skip_bad_frames),
        times_s=np.arange(float(n)),
        intrinsics=np.tile([K[0, 0], K[1, 1], K[0, 2], K[1, 2]], (n, 1)),
        depth_step_m=np.full(n, 0.001),
        T_cam_world=invert_transform(np.stack([T for T, _ in poses])),
        form=DepthForm(invalid_units=MAXIMUM_UNITS),
    )


def _matrix(path: Path, size: int) -> FloatArray:
    """A square matrix of finite numbers from a text file."""
    expected = f"expected {size} rows of {size} finite numbers"
    try:
        text = read_bytes(path, _MAX_BYTES, expected.removeprefix("expected ")).decode("utf-8")
        rows = [line.split() for line in text.splitlines()]
        matrix = np.array([[float(word) for word in row] for row in rows if row])
    except InputError:
        raise
    except ValueError as error:
        raise InputError(path, "matrix", f"{expected} ({error})") from error
    if matrix.shape != (size, size) or not np.isfinite(matrix).all():
        raise InputError(path, "matrix", expected)
    return matrix


def _require_pinhole(path: Path, K: FloatArray) -> None:
    if not (K[0, 0] > 0.0 and K[1, 1] > 0.0):
        raise InputError(path, "matrix", "expected focal lengths above 0")
    if K[0, 1] != 0.0 or K[1, 0] != 0.0 or (K[2] != [0.0, 0.0, 1.0]).any():
        raise InputError(path, "matrix", "expected fx 0 cx, 0 fy cy, 0 0 1 (no skew)")


def _pose(path: Path) -> tuple[FloatArray, float]:
    """(4, 4) T_world_cam made rigid, and how far its matrix was from a rotation."""
    T = _matrix(path, 4)
    error = float(orthonormality_error(T[:3, :3]))
    if error > POSE_TOLERANCE or (T[3] != [0.0, 0.0, 0.0, 1.0]).any():
        expected = f"expected a rigid camera-to-world transform (orthonormal to {POSE_TOLERANCE:g})"
        raise InputError(path, "matrix", expected)
    return make_transform(nearest_orthogonal(T[:3, :3]), T[:3, 3]), error
