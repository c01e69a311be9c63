"""Opening a sequence of whatever format a folder holds."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from pcnav.core.errors import InputError
from pcnav.recordings.bop import BopSequence
from pcnav.recordings.bop_scene import SCENE_CAMERA_FILE
from pcnav.recordings.sequence import Sequence
from pcnav.recordings.sequence_file import SEQUENCE_FILE
from pcnav.recordings.tsdf_fusion import INTRINSICS_FILE, TsdfFusionSequence


@dataclass(frozen=True)
class SequenceFormat:
    """One format a folder may hold."""

    name: str
    markers: tuple[str, ...]
    """Files any of which tells the format."""
    open: Callable[[Path, Path | None], Sequence]
    """From the folder and, where given, the target's mesh."""


FORMATS = (
    SequenceFormat("BOP scene", (SCENE_CAMERA_FILE, SEQUENCE_FILE), BopSequence),
    SequenceFormat("tsdf-fusion recording", (INTRINSICS_FILE,), TsdfFusionSequence),
)
"""Known formats; the first whose marker is present is taken."""


def open_sequence(path: Path, target_mesh: Path | None = None) -> Sequence:
    """Open a depth sequence; ``target_mesh`` replaces the mesh it names.

    Raises `InputError` when the folder is missing, of no known format, or invalid.
    """
    known = " or ".join(f"{form.markers[0]} ({form.name})" for form in FORMATS)
    if not path.is_dir():
        raise InputError(path, "folder", f"expected a folder with {known}")
    for form in FORMATS:
        if any((path / marker).is_file() for marker in form.markers):
            return form.open(path, target_mesh)
    raise InputError(path, "folder", f"expected {known} in it")
