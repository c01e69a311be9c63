"""Depth images of a whole recording in one file: .npz, .npy or a TIFF of many pages.

Arrays of a .npz: depth (n, height, width), or the only one of three dimensions; optional K (3, 3)
or (n, 3, 3), or camera (fx, fy, cx, cy); time_s (n,); T_cam_world or T_world_cam (n, 4, 4);
depth_scale (mm per unit); true_T_cam_model (n, 4, 4), which is truth. What is not there comes from
options, from depth_camera.toml beside the file, and from NAME.toml as from a sequence.toml.
"""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image

from pcnav.config.recording import AS_IT_IS, RecordingTable
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import invert_transform
from pcnav.dynamics.blocks import POSE_LAYOUT
from pcnav.dynamics.trajectory import Trajectory
from pcnav.files.decoding import decoding
from pcnav.recordings.array_files import ArrayFile
from pcnav.recordings.assembling import Parts, assembled
from pcnav.recordings.depth_camera import DepthCamera, camera_file, depth_camera
from pcnav.recordings.depth_image import StoredDepth
from pcnav.recordings.depth_png import require_few_pixels
from pcnav.recordings.frame_checks import checked_transform
from pcnav.recordings.sequence import Sequence

SUFFIXES = (".npz", ".npy", ".tif", ".tiff")
_DEPTH = ("depth", "depth_m", "depths", "array")
_TIMES = ("time_s", "timestamps", "timestamp", "times", "t")
_TRUTH = "true_T_cam_model"
_MAX_PAGES = 1_000_000


def is_depth_stack(path: Path) -> bool:
    """Whether a path is a file that may hold depth images."""
    return path.is_file() and path.suffix.lower() in SUFFIXES


def read_depth_stack(
    path: Path,
    target_mesh: Path | None = None,
    skip_bad_frames: bool = False,
    table: RecordingTable = AS_IT_IS,
) -> Sequence:
    """The images of one file, in its order. Raises `InputError`."""
    if path.suffix.lower() in (".tif", ".tiff"):
        pages = _Pages(path)
        camera = depth_camera(path.parent, table, path)
        parts = Parts(path, path, pages.names, camera, read_image=pages.read)
        return assembled(parts, target_mesh, table, skip_bad_frames)
    arrays = _Arrays(path)
    parts = Parts(
        path,
        path,
        arrays.names,
        arrays.camera(table),
        arrays.times(),
        arrays.poses(),
        read_image=arrays.read,
    )
    return assembled(parts, target_mesh, table, skip_bad_frames)


def read_stack_truth(path: Path, time_zero_s: float) -> Trajectory | None:
    """The true poses of a .npz, times from a zero on; None without. Raises `InputError`."""
    if path.suffix.lower() != ".npz":
        return None
    arrays = _Arrays(path)
    T = arrays.transforms(_TRUTH)
    if T is None:
        return None
    stamp_s = arrays.times()
    time_s = np.arange(float(len(T))) if stamp_s is None else stamp_s - time_zero_s
    order = np.argsort(time_s)
    return Trajectory(time_s[order], POSE_LAYOUT, T_cam_target=T[order])


class _Arrays:
    """The arrays of a recording."""

    def __init__(self, path: Path) -> None:
        self._path, self._file = path, ArrayFile(path)
        headers = self._file.headers
        cubes = [name for name, header in headers.items() if len(header.shape) == 3]
        named = [name for name in _DEPTH if name in cubes]
        others = [n for n in cubes if headers[n].shape[1:] not in ((3, 3), (4, 4))]
        found = named[:1] or others
        if len(found) != 1:
            have = ", ".join(f"{n} {h.shape}" for n, h in headers.items())[:200] or "nothing"
            expected = "expected one array depth (frames, height, width)"
            raise InputError(path, "depth", f"{expected}, got {have}")
        (self._depth,) = found
        header = headers[self._depth]
        if header.is_fortran or 0 in header.shape or header.dtype.kind not in "uif":
            expected = "expected integers or floats, frame after frame (C order)"
            raise InputError(path, self._depth, f"{expected}, got {header.dtype} {header.shape}")
        self.names = tuple(f"{self._depth}[{k}]" for k in range(header.shape[0]))
        self._places = {name: k for k, name in enumerate(self.names)}

    def read(self, path: Path) -> StoredDepth:
        """One of the images, by its name."""
        return self._file.slice_of(self._depth, self._places[path.name])

    def camera(self, table: RecordingTable) -> DepthCamera:
        """As the file has it, else as options or a file beside it say. Raises `InputError`."""
        stated = self._intrinsics()
        if table.camera_px is None and stated is not None:
            return DepthCamera(stated, None, table.unit_m or self._unit_m())
        beside = depth_camera(self._path.parent, table, self._path)
        if camera_file(self._path.parent) is None:
            return DepthCamera(beside.intrinsics, None, table.unit_m or self._unit_m())
        return beside

    def times(self) -> FloatArray | None:
        """(n,) stamps, s; None without. Raises `InputError`."""
        name = next((name for name in _TIMES if name in self._file.headers), None)
        if name is None:
            return None
        found = self._file.whole(name)
        if found.shape != (len(self.names),) or found.dtype.kind not in "uif":
            expected = f"expected {len(self.names)} numbers, one a frame"
            raise InputError(self._path, name, f"{expected}, got {found.dtype} {found.shape}")
        return found.astype(np.float64)

    def poses(self) -> FloatArray | None:
        """(n, 4, 4) T_cam_world; None without. Raises `InputError`."""
        T = self.transforms("T_cam_world")
        if T is not None:
            return T
        T = self.transforms("T_world_cam")
        return None if T is None else invert_transform(T)

    def transforms(self, name: str) -> FloatArray | None:
        """(n, 4, 4) of a name; None without. Raises `InputError` for what are none."""
        if name not in self._file.headers:
            return None
        T = self._file.whole(name)
        if T.shape != (len(self.names), 4, 4) or T.dtype.kind != "f":
            expected = f"expected transforms ({len(self.names)}, 4, 4)"
            raise InputError(self._path, name, f"{expected}, got {T.dtype} {T.shape}")
        rigid = [
            checked_transform(str(self._path), f"{name}[{k}]", each)
            for k, each in enumerate(T.astype(np.float64))
        ]
        return np.stack(rigid)

    def _intrinsics(self) -> tuple[float, float, float, float] | None:
        for name in ("K", "camera"):
            if name not in self._file.headers:
                continue
            found = self._file.whole(name).astype(np.float64)
            same = found.ndim == 3 and len(found) and bool((found == found[0]).all())
            found = found[0] if same else found
            if found.shape == (3, 3):
                found = found[[0, 1, 0, 1], [0, 1, 2, 2]]
            if found.shape != (4,) or not np.isfinite(found).all() or (found[:2] <= 0.0).any():
                expected = "expected K (3, 3), the same for all frames, or fx, fy, cx, cy"
                raise InputError(self._path, name, f"{expected}, got {found.shape}")
            fx, fy, cx, cy = found.tolist()
            return fx, fy, cx, cy
        return None

    def _unit_m(self, name: str = "depth_scale") -> float | None:
        if name not in self._file.headers:
            return None
        found = self._file.whole(name)
        if found.size != 1 or not 0.0 < float(found.ravel()[0]) < np.inf:
            expected = "expected one finite number above 0, mm per stored unit"
            raise InputError(self._path, name, expected)
        return float(found.ravel()[0]) / 1000.0


class _Pages:
    """The pages of a TIFF."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with self._opened(path) as image:
            count = int(getattr(image, "n_frames", 1))
        if count > _MAX_PAGES:
            raise InputError(path, "pages", f"expected at most {_MAX_PAGES:,}")
        self.names = tuple(f"page {k}" for k in range(count))

    def read(self, path: Path) -> StoredDepth:
        """One page, by its name."""
        with self._opened(path) as image:
            image.seek(int(path.name.split()[1]))
            require_few_pixels(path, image)
            pixels = np.asarray(image)
        if pixels.ndim != 2 or pixels.dtype.kind not in "uif" or pixels.dtype == np.uint8:
            expected = "expected one plane of 16-bit or 32-bit depth"
            raise InputError(path, "pixels", f"{expected}, got {pixels.dtype} {pixels.shape}")
        return pixels

    @contextmanager
    def _opened(self, path: Path) -> Iterator[Image.Image]:
        with (
            warnings.catch_warnings(action="ignore"),
            decoding(path, "an undamaged TIFF"),
            Image.open(self._path, formats=["TIFF"]) as image,
        ):
            yield image
