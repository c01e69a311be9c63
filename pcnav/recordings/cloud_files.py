"""Files of point clouds: PCD, PLY, KITTI's BIN, NPY and NPZ, each with times where it has them."""

import re
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.files.regular_file import read_bytes
from pcnav.recordings.array_files import ArrayFile
from pcnav.recordings.cloud import MAX_POINTS, Cloud, time_name
from pcnav.recordings.pcd import read_pcd

_MAX_BYTES, _MAX_HEADER = 4_000_000_000, 20_000
_OF_BIN = 4
"""Numbers of a point of KITTI: x, y, z and reflectance, floats of 32 bits."""
_COLUMNS = range(3, 9)
_POINTS = ("points", "xyz", "pts")
_PLY_TYPES = {
    **{"char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2"},
    **{"ushort": "u2", "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4"},
    **{"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"},
}
_PLY_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


def read_cloud(path: Path) -> Cloud:
    """The points of a file, by its suffix. Raises `InputError`."""
    return _READERS[path.suffix.lower()](path)


def holds_points(path: Path) -> bool:
    """Whether a file of NumPy arrays holds points, and no image."""
    try:
        headers = ArrayFile(path).headers
    except InputError:
        return False
    if path.suffix.lower() == ".npz":
        return any(name in headers for name in _POINTS)
    shape = headers["array"].shape
    return len(shape) == 2 and shape[1] in _COLUMNS and shape[0] > _COLUMNS.stop


def _read_bin(path: Path) -> Cloud:
    data = read_bytes(path, _MAX_BYTES, "a point cloud")
    if not data or len(data) % (4 * _OF_BIN):
        expected = "expected x, y, z and reflectance of each point, 32-bit floats (KITTI)"
        raise InputError(path, "file", f"{expected}, got {len(data)} bytes")
    rows = np.frombuffer(data, dtype="<f4").reshape(-1, _OF_BIN)
    return Cloud(rows[None, :, :3].astype(np.float64))


def _read_arrays(path: Path) -> Cloud:
    arrays = ArrayFile(path)
    name = next((n for n in ("array", *_POINTS) if n in arrays.headers), None)
    if name is None:
        have = ", ".join(sorted(arrays.headers))[:200] or "nothing"
        raise InputError(path, "points", f"expected an array points (n, 3), got {have}")
    points = _numbers(path, name, arrays)
    if points.ndim not in (2, 3) or points.shape[-1] not in _COLUMNS or not points.size:
        raise InputError(path, name, f"expected (n, 3) or (rows, columns, 3), got {points.shape}")
    points = (points if points.ndim == 3 else points[None])[..., :3]
    time = time_name(arrays.headers)
    if time is None:
        return Cloud(points)
    times = _numbers(path, time, arrays)
    if times.size != points.size // 3:
        raise InputError(path, time, f"expected one time a point, got {times.shape}")
    return Cloud(points, times.reshape(points.shape[:2]))


def _numbers(path: Path, name: str, arrays: ArrayFile) -> FloatArray:
    found = arrays.whole(name)
    if found.dtype.kind not in "uif":
        raise InputError(path, name, f"expected numbers, got {found.dtype}")
    return found.astype(np.float64)


def _read_ply(path: Path) -> Cloud:
    data = read_bytes(path, _MAX_BYTES, "a point cloud")
    end = re.search(rb"end_header\r?\n", data[:_MAX_HEADER])
    if not data.startswith(b"ply") or end is None:
        raise InputError(path, "header", "expected a PLY with a line end_header")
    lines = data[: end.start()].decode("ascii", errors="replace").splitlines()
    order, count, fields = _ply_header(path, [line.split() for line in lines if line.split()])
    names = [name for name, _ in fields]
    if not {"x", "y", "z"} <= set(names) or len(set(names)) < len(names):
        raise InputError(path, "vertex", f"expected x, y and z once each, got {names[:9]}")
    time = time_name(names)
    wanted = ["x", "y", "z", *([time] if time else [])]
    columns = _ply_columns(path, data[end.end() :], order, count, fields, wanted)
    points = np.stack(columns[:3], axis=-1)[None]
    return Cloud(points, columns[3][None] if time else None)


def _ply_header(path: Path, lines: list[list[str]]) -> tuple[str, int, list[tuple[str, str]]]:
    """Byte order ("" for text), number of points, and their fields with their kinds."""
    order, count, fields, element = None, 0, [], ""
    try:
        for first, *words in lines:
            if first == "format":
                order = _PLY_FORMATS[words[0]]
            elif first == "element":
                # What comes after the points is left alone; before them nothing may come.
                if not element and words[0] != "vertex":
                    raise ValueError(f"the first element is {words[0][:40]}")
                element = words[0]
                count = int(words[1]) if element == "vertex" else count
            elif first == "property" and element == "vertex":
                fields.append((words[1], _PLY_TYPES[words[0]]))
    except (KeyError, ValueError, IndexError) as error:
        raise InputError(path, "header", f"expected points of a PLY ({error})") from error
    if order is None or not 0 < count <= MAX_POINTS:
        raise InputError(path, "vertex", f"expected 1 to {MAX_POINTS:,} points")
    return order, count, fields


def _ply_columns(
    path: Path,
    body: bytes,
    order: str,
    count: int,
    fields: list[tuple[str, str]],
    wanted: list[str],
) -> list[FloatArray]:
    """(count,) numbers of each of the wanted fields."""
    if order:
        form = np.dtype([(name, order + kind) for name, kind in fields])
        if len(body) < count * form.itemsize:
            raise InputError(path, "file", "expected a whole PLY, but it ends early")
        records = np.frombuffer(body, dtype=form, count=count)
        return [records[name].astype(np.float64) for name in wanted]
    size = count * len(fields)
    try:
        numbers = np.array(body.split(maxsplit=size)[:size], dtype=np.float64)
    except ValueError as error:
        raise InputError(path, "points", f"expected numbers ({error})") from error
    if len(numbers) < size:
        raise InputError(path, "file", "expected a whole PLY, but it ends early")
    rows, names = numbers.reshape(count, len(fields)), [name for name, _ in fields]
    return [rows[:, names.index(name)] for name in wanted]


_READERS: Mapping[str, Callable[[Path], Cloud]] = {
    ".pcd": read_pcd,
    ".ply": _read_ply,
    ".bin": _read_bin,
    ".npy": _read_arrays,
    ".npz": _read_arrays,
}
SUFFIXES = tuple(_READERS)
"""Of files that may hold points."""
