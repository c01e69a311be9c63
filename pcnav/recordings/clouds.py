"""Point clouds in files: PCD, PLY, KITTI's BIN, NPY and NPZ; one of them, or a folder.

Organised ones, in the rows and columns of a pinhole camera, are depth images: the camera is fitted
to the points, unless --camera or depth_camera.toml says it. All others are scans, see
`pcnav.recordings.cloud_scans`. `[sensor] axes` of a sequence.toml says which way their axes point.
"""

from pathlib import Path

from pcnav.config.recording import AS_IT_IS, RecordingTable
from pcnav.core.errors import InputError
from pcnav.recordings.assembling import Parts, assembled, settings_file
from pcnav.recordings.bop_scene import SCENE_CAMERA_FILE
from pcnav.recordings.cloud import Cloud
from pcnav.recordings.cloud_files import SUFFIXES, holds_points, read_cloud
from pcnav.recordings.cloud_scans import CloudScans, scans_assembled
from pcnav.recordings.depth_camera import DepthCamera, camera_file, depth_camera
from pcnav.recordings.depth_folder import number_of, stamps_of
from pcnav.recordings.depth_image import StoredDepth
from pcnav.recordings.organised import depth_of_points, pinhole_of
from pcnav.recordings.sequence import Sequence
from pcnav.recordings.sequence_file import stated_axes

_ARRAYS = (".npy", ".npz")
_TRIED = 10
"""Clouds that a camera is looked for in: the first may be empty."""


def is_clouds(path: Path) -> bool:
    """Whether a path is a cloud, or a folder of them."""
    files = _files(path)
    folder = path if path.is_dir() else path.parent
    if not files or (folder / SCENE_CAMERA_FILE).is_file():
        return False
    return Path(files[0]).suffix.lower() not in _ARRAYS or holds_points(folder / min(files))


def read_clouds(
    path: Path,
    target_mesh: Path | None = None,
    skip_bad_frames: bool = False,
    table: RecordingTable = AS_IT_IS,
) -> Sequence:
    """The clouds in order of their numbers. Raises `InputError`."""
    files = tuple(sorted(_files(path), key=number_of))
    folder = path if path.is_dir() else path.parent
    stamp_s = stamps_of(path, [Path(file).stem for file in files])
    found = _camera(folder, files, table)
    if isinstance(found, DepthCamera):
        parts = Parts(path, folder, files, found, stamp_s, read_image=_read_image)
        return assembled(parts, target_mesh, table, skip_bad_frames)
    scans = CloudScans.of(path, found, stated_axes(settings_file(path)), table.unit_m)
    return scans_assembled(
        Parts(path, folder, files, scans.depth_camera, stamp_s),
        *(target_mesh, table, skip_bad_frames, scans, read_cloud),
    )


def _read_image(path: Path) -> StoredDepth:
    points = read_cloud(path).points
    if min(points.shape[:2]) < 2:
        expected = "expected rows and columns of the camera that is stated"
        raise InputError(path, "points", f"{expected}, got {points.shape[1]} in one row")
    return depth_of_points(points)


def _files(path: Path) -> list[str]:
    if path.is_file():
        # A file of arrays may hold a whole recording.
        is_cloud = path.suffix.lower() in SUFFIXES and path.suffix.lower() not in _ARRAYS
        return [path.name] if is_cloud else []
    if not path.is_dir():
        return []
    names = [file.name for file in path.iterdir() if file.suffix.lower() in SUFFIXES]
    kinds = {Path(name).suffix.lower() for name in names}
    return names if len(kinds) == 1 else []


def _camera(
    folder: Path, files: tuple[str, ...], table: RecordingTable
) -> DepthCamera | list[Cloud]:
    """The camera whose pixels the points stand in; the first clouds where that is none."""
    if table.camera_px is not None or camera_file(folder) is not None:
        return depth_camera(folder, table)
    clouds = [read_cloud(folder / file) for file in files[:_TRIED]]
    for cloud in clouds:
        if min(cloud.points.shape[:2]) < 2 or cloud.time is not None:
            continue
        try:
            return DepthCamera(pinhole_of(cloud.points), None, table.unit_m)
        except ValueError:
            continue
    return clouds
