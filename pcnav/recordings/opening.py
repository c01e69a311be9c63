"""Opening a recording of whatever kind and format a path holds."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

from pcnav.core.errors import InputError
from pcnav.recordings.attitudes import ATTITUDES_FILE, is_attitude_recording, read_attitudes
from pcnav.recordings.bop import read_bop
from pcnav.recordings.bop_scene import SCENE_CAMERA_FILE
from pcnav.recordings.images import is_image_sequence, open_images
from pcnav.recordings.monocular_tracks import (
    CAMERA_FILE,
    is_monocular_recording,
    read_monocular_tracks,
)
from pcnav.recordings.recording import Recording, RecordingKind
from pcnav.recordings.sequence import Sequence
from pcnav.recordings.sequence_file import SEQUENCE_FILE
from pcnav.recordings.stereo_tracks import read_stereo_tracks
from pcnav.recordings.tracks import TRACKS_FILE, tracks_folder
from pcnav.recordings.tsdf_fusion import INTRINSICS_FILE, read_tsdf_fusion


@dataclass(frozen=True)
class RecordingFormat:
    """One format that a path may hold."""

    name: str
    kind: RecordingKind
    marker: str
    """What tells it, in words."""
    fits: Callable[[Path], bool]
    read: Callable[..., Recording]
    """From the path and, of depth frames, the target's mesh where it is given, and whether images
    may be bad."""


def _depth(name: str, markers: tuple[str, ...], read: Callable[..., Sequence]) -> RecordingFormat:
    """A folder of depth frames, told by the presence of any of its files."""

    def fits(path: Path) -> bool:
        return any((path / marker).is_file() for marker in markers)

    return RecordingFormat(name, RecordingKind.DEPTH, markers[0], fits, read)


FORMATS = (
    RecordingFormat(
        *("tracks of one camera", RecordingKind.IMAGES, f"{TRACKS_FILE} with {CAMERA_FILE}"),
        *(is_monocular_recording, read_monocular_tracks),
    ),
    RecordingFormat(
        *("images of one camera", RecordingKind.IMAGES, f"images with {CAMERA_FILE}"),
        *(is_image_sequence, open_images),
    ),
    RecordingFormat(
        *("stereo tracks", RecordingKind.STEREO_TRACKS, TRACKS_FILE),
        *(lambda path: tracks_folder(path) is not None, read_stereo_tracks),
    ),
    RecordingFormat(
        *("attitudes", RecordingKind.ATTITUDES, ATTITUDES_FILE),
        *(is_attitude_recording, read_attitudes),
    ),
    _depth("BOP scene", (SCENE_CAMERA_FILE, SEQUENCE_FILE), read_bop),
    _depth("tsdf-fusion recording", (INTRINSICS_FILE,), read_tsdf_fusion),
)
"""Known formats; the first that fits is taken."""
ALL_KINDS = frozenset(RecordingKind)


def format_of(path: Path, kinds: Collection[RecordingKind] = ALL_KINDS) -> RecordingFormat | None:
    """The format that a path holds, among those of some kinds; None where none fits."""
    return next((form for form in FORMATS if form.kind in kinds and form.fits(path)), None)


def open_recording(
    path: Path | str,
    target_mesh: Path | None = None,
    kinds: Collection[RecordingKind] = ALL_KINDS,
    skip_bad_frames: bool = False,
) -> Recording:
    """Open a recording; of depth frames ``target_mesh`` replaces the mesh it names.

    With ``skip_bad_frames`` some of its depth images may be missing or damaged. ``kinds`` are those
    that can be made use of: a folder may hold several. Raises `InputError`, which names what would
    tell each format, when the path is missing or of no known format of these kinds; when it is
    invalid; and for a mesh where none is shown.
    """
    path = Path(path)
    found = format_of(path, kinds)
    if found is None:
        known = (f"{form.marker} ({form.name})" for form in FORMATS if form.kind in kinds)
        markers = " or ".join(known)
        in_it = f"expected {markers} in it" if path.is_dir() else ""
        raise InputError(path, "folder", in_it or f"expected a folder with {markers}")
    if found.kind is RecordingKind.DEPTH:
        return found.read(path, target_mesh, skip_bad_frames)
    if target_mesh is not None:
        raise InputError(path, "target_mesh", "expected none: only depth frames need a mesh")
    return found.read(path)


def open_sequence(
    path: Path | str, target_mesh: Path | None = None, skip_bad_frames: bool = False
) -> Sequence:
    """Open a recording of depth frames: see `open_recording`."""
    found = open_recording(path, target_mesh, (RecordingKind.DEPTH,), skip_bad_frames)
    assert isinstance(found, Sequence)
    return found
