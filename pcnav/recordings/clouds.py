"""Organised point clouds as depth images: a PCD file, or a folder of them.

The camera is fitted to the rows and columns that the points stand in, unless --camera or
depth_camera.toml says it. Clouds without rows and columns, and PLY files, which keep none, are not
read yet.
"""

from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np

from pcnav.config.recording import AS_IT_IS, RecordingTable
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.recordings.assembling import Parts, assembled
from pcnav.recordings.depth_camera import DepthCamera, camera_file, depth_camera
from pcnav.recordings.depth_folder import named_stamps, number_of
from pcnav.recordings.depth_image import StoredDepth
from pcnav.recordings.organised import depth_of_points, pinhole_of
from pcnav.recordings.sequence import Sequence

SUFFIXES = (".pcd", ".ply")
_KINDS = {"F4": "f4", "F8": "f8", "U1": "u1", "U2": "u2", "U4": "u4", "I1": "i1", "I2": "i2"}
_KINDS |= {"I4": "i4", "U8": "u8", "I8": "i8"}
_MAX_HEADER, _MAX_POINTS, _MAX_FIELDS = 10_000, 64_000_000, 64
_TRIED = 10
"""Clouds that a camera is looked for in: the first may be empty."""


def is_clouds(path: Path) -> bool:
    """Whether a path is a cloud, or a folder of them."""
    return bool(_files(path))


def read_clouds(
    path: Path,
    target_mesh: Path | None = None,
    skip_bad_frames: bool = False,
    table: RecordingTable = AS_IT_IS,
) -> Sequence:
    """The clouds in order of their numbers. Raises `InputError`."""
    files = tuple(sorted(_files(path), key=number_of))
    folder = path if path.is_dir() else path.parent
    stamp_s = named_stamps([Path(file).stem for file in files])
    camera = _camera(folder, files, table)
    parts = Parts(path, folder, files, camera, stamp_s, read_image=_read)
    return assembled(parts, target_mesh, table, skip_bad_frames)


def read_pcd(path: Path) -> FloatArray:
    """(height, width, 3) points of an organised PCD. Raises `InputError` for any other."""
    if path.suffix.lower() != ".pcd":
        expected = "expected an organised PCD; unorganised clouds, as of PLY, are not read yet"
        raise InputError(path, "file", expected)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, "file", f"expected a readable file ({error.strerror})") from error
    header, body = _header(path, data)
    if header.height < 2:
        expected = f"expected rows and columns; {header.width} points in one row are not read yet"
        raise InputError(path, "HEIGHT", expected)
    count = header.width * header.height
    if header.data == "binary":
        if len(body) < count * header.dtype.itemsize:
            raise InputError(path, "file", "expected a whole PCD, but it ends early")
        rows = np.frombuffer(body, dtype=header.dtype, count=count)
        columns = [rows[axis].astype(np.float64) for axis in "xyz"]
    else:
        columns = _ascii(path, header, body, count)
    return np.stack(columns, axis=-1).reshape(header.height, header.width, 3)


@dataclass(frozen=True)
class _Header:
    width: int
    height: int
    dtype: "np.dtype[np.void]"
    names: tuple[str, ...]
    """Of the columns of a text: a field of several numbers has as many."""
    data: str


def _header(path: Path, data: bytes) -> tuple[_Header, bytes]:
    end = data.find(b"\nDATA ", 0, _MAX_HEADER)
    line_end = data.find(b"\n", end + 1)
    if end < 0 or line_end < 0:
        raise InputError(path, "header", "expected a PCD with a line DATA")
    lines = data[:line_end].decode("ascii", errors="replace").splitlines()
    words = {line.split()[0]: line.split()[1:] for line in lines if line.split()}
    try:
        names, sizes, types = (words[key] for key in ("FIELDS", "SIZE", "TYPE"))
        counts = [int(word) for word in words.get("COUNT", ["1"] * len(names))]
        width, height, kind = int(words["WIDTH"][0]), int(words["HEIGHT"][0]), words["DATA"][0]
        kinds = [_KINDS[t + s] for t, s in zip(types, sizes, strict=True)]
        fields = list(zip(names, kinds, counts, strict=True))
    except (KeyError, ValueError, IndexError) as error:
        expected = f"expected FIELDS, SIZE, TYPE, WIDTH, HEIGHT and DATA of a PCD ({error})"
        raise InputError(path, "header", expected) from error
    if kind not in ("ascii", "binary"):
        expected = "expected ascii or binary; compressed PCDs are not read yet"
        raise InputError(path, "DATA", f"{expected}, got {kind[:40]}")
    if not 0 < prod((max(width, 0), max(height, 0))) <= _MAX_POINTS or len(names) > _MAX_FIELDS:
        raise InputError(path, "WIDTH", f"expected 1 to {_MAX_POINTS:,} points")
    wrong = any(count < 1 or count > _MAX_HEADER for count in counts)
    single = all(counts[names.index(axis)] == 1 for axis in "xyz" if axis in names)
    if wrong or not single or not {"x", "y", "z"} <= set(names):
        raise InputError(path, "FIELDS", f"expected x, y and z once each, got {names[:9]}")
    # Names such as _ for padding may stand several times.
    unique = [n if n in ("x", "y", "z") else f"{k}" for k, n in enumerate(names)]
    packed = [
        (u, f"<{f}", (c,)) if c > 1 else (u, f"<{f}")
        for u, (_, f, c) in zip(unique, fields, strict=True)
    ]
    columns = tuple(u for u, (_, _, c) in zip(unique, fields, strict=True) for _ in range(c))
    header = _Header(width, height, np.dtype(packed), columns, kind)
    return header, data[line_end + 1 :]


def _ascii(path: Path, header: _Header, body: bytes, count: int) -> list[FloatArray]:
    wide = len(header.names)
    try:
        numbers = np.array(body.split(), dtype=np.float64)
    except ValueError as error:
        raise InputError(path, "points", f"expected numbers ({error})") from error
    if len(numbers) != count * wide:
        expected = f"expected {count} points of {wide} numbers"
        raise InputError(path, "points", f"{expected}, got {len(numbers)} numbers")
    rows = numbers.reshape(count, wide)
    return [rows[:, header.names.index(axis)] for axis in "xyz"]


def _read(path: Path) -> StoredDepth:
    return depth_of_points(read_pcd(path))


def _files(path: Path) -> list[str]:
    if path.is_file():
        return [path.name] if path.suffix.lower() in SUFFIXES else []
    if not path.is_dir():
        return []
    return [file.name for file in path.iterdir() if file.suffix.lower() in SUFFIXES]


def _camera(folder: Path, files: tuple[str, ...], table: RecordingTable) -> DepthCamera:
    if table.camera_px is not None or camera_file(folder) is not None:
        return depth_camera(folder, table)
    failure: ValueError | None = None
    for file in files[:_TRIED]:
        points = read_pcd(folder / file)
        try:
            return DepthCamera(pinhole_of(points), None, table.unit_m)
        except ValueError as error:
            failure = failure or error
    raise InputError(folder / files[0], "points", str(failure)) from failure
