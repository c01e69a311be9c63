"""Opening a recording of whatever kind and format a path holds."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

from pcnav.config.recording import AS_IT_IS, RecordingTable
from pcnav.core.errors import InputError
from pcnav.recordings.attitudes import ATTITUDES_FILE, is_attitude_recording, read_attitudes
from pcnav.recordings.bag import METADATA, is_bag, read_bag
from pcnav.recordings.bop import read_bop
from pcnav.recordings.bop_models import refuse_data_set, scenes_of
from pcnav.recordings.bop_scene import SCENE_CAMERA_FILE
from pcnav.recordings.clouds import is_clouds, read_clouds
from pcnav.recordings.depth_folder import is_depth_folder, read_depth_folder
from pcnav.recordings.depth_stack import is_depth_stack, read_depth_stack
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
from pcnav.recordings.tum_rgbd import DEPTH_LIST, is_tum_rgbd, read_tum_rgbd


@dataclass(frozen=True)
class RecordingFormat:
    """One format that a path may hold."""

    name: str
    kind: RecordingKind
    marker: str
    """What tells it, in words."""
    fits: Callable[[Path], bool]
    read: Callable[..., Recording]
    """From the path and, of depth frames, the target's mesh where it is given, whether images may
    be bad, and what is said of the recording."""
    options: frozenset[str] = frozenset()
    """Keys of [recording] that it has a use for, beside those that select frames."""


def _holds(*markers: str) -> Callable[[Path], bool]:
    """Tells a folder by the presence of any of some files."""
    return lambda path: any((path / marker).is_file() for marker in markers)


_OF_IMAGES = frozenset({"camera_px", "unit_m", "frame_rate_hz"})
_OPTION = {"frame_rate_hz": "--rate", "camera_px": "--camera", "unit_m": "--unit"}
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
    RecordingFormat(
        *("TUM RGB-D recording", RecordingKind.DEPTH, DEPTH_LIST, is_tum_rgbd, read_tum_rgbd),
        _OF_IMAGES - {"frame_rate_hz"},
    ),
    RecordingFormat(
        *("bag", RecordingKind.DEPTH, f".bag, .mcap or {METADATA}", is_bag, read_bag),
        frozenset({"camera_px", "unit_m", "topic", "camera_topic"}),
    ),
    RecordingFormat(
        *("point clouds", RecordingKind.DEPTH, ".pcd, .ply, .bin, or arrays of points"),
        *(is_clouds, read_clouds, _OF_IMAGES),
    ),
    RecordingFormat(
        *("folder of depth images", RecordingKind.DEPTH, "depth images with their camera"),
        *(is_depth_folder, read_depth_folder, _OF_IMAGES),
    ),
    RecordingFormat(
        *("BOP scene", RecordingKind.DEPTH, SCENE_CAMERA_FILE),
        *(_holds(SCENE_CAMERA_FILE, SEQUENCE_FILE), read_bop),
        frozenset({"object"}),
    ),
    RecordingFormat(
        *("BOP data set", RecordingKind.DEPTH, f"scenes with {SCENE_CAMERA_FILE}"),
        *(lambda path: bool(scenes_of(path)), refuse_data_set, frozenset({"object"})),
    ),
    RecordingFormat(
        *("tsdf-fusion recording", RecordingKind.DEPTH, INTRINSICS_FILE),
        *(_holds(INTRINSICS_FILE), read_tsdf_fusion),
    ),
    RecordingFormat(
        *("one file of depth images", RecordingKind.DEPTH, ".npz, .npy or .tif"),
        *(is_depth_stack, read_depth_stack, _OF_IMAGES),
    ),
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
    table: RecordingTable = AS_IT_IS,
) -> Recording:
    """Open a recording; of depth frames ``target_mesh`` replaces the mesh it names.

    With ``skip_bad_frames`` some of its depth images may be missing or damaged. ``kinds`` are those
    that can be made use of: a folder may hold several. ``table`` says of depth frames what they do
    not say themselves, and which are taken. Raises `InputError`, which names what would
    tell each format, when the path is missing or of no known format of these kinds; when it is
    invalid; and for a mesh or an option where none is of use.
    """
    path = Path(path)
    found = format_of(path, kinds)
    if found is None:
        known = (f"{form.marker} ({form.name})" for form in FORMATS if form.kind in kinds)
        markers = " or ".join(known)
        in_it = f"expected {markers} in it" if path.is_dir() else ""
        raise InputError(path, "folder", in_it or f"expected a folder with {markers}")
    if found.kind is not RecordingKind.DEPTH:
        if target_mesh is not None:
            raise InputError(path, "target_mesh", "expected none: only depth frames need a mesh")
        _refuse_options(path, found, table, table.selects)
        return found.read(path)
    _refuse_options(path, found, table, False)
    sequence = found.read(path, target_mesh, skip_bad_frames, table)
    assert isinstance(sequence, Sequence)
    return sequence.taken(table.rows) if table.selects else sequence


def open_sequence(
    path: Path | str,
    target_mesh: Path | None = None,
    skip_bad_frames: bool = False,
    table: RecordingTable = AS_IT_IS,
) -> Sequence:
    """Open a recording of depth frames: see `open_recording`."""
    found = open_recording(path, target_mesh, (RecordingKind.DEPTH,), skip_bad_frames, table)
    assert isinstance(found, Sequence)
    return found


def _refuse_options(
    path: Path, found: RecordingFormat, table: RecordingTable, also_selection: bool
) -> None:
    """Raise `InputError` for a key of [recording] that the format has no use for."""
    chosen = {"start", "frames", "every"}
    of_no_use = set(RecordingTable.model_fields) - found.options
    for key in sorted(of_no_use if also_selection else of_no_use - chosen):
        if getattr(table, key) != getattr(AS_IT_IS, key):
            option = _OPTION.get(key, f"--{key.replace('_', '-')}")
            raise InputError(path, option, f"expected none: of no use for a {found.name}")
