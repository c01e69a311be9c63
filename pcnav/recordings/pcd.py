"""Point clouds in PCD files, ascii or binary, with or without rows and columns."""

from dataclasses import dataclass
from math import prod
from pathlib import Path

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.files.regular_file import read_bytes
from pcnav.recordings.cloud import MAX_POINTS, Cloud, time_name

_KINDS = {"F4": "f4", "F8": "f8", "U1": "u1", "U2": "u2", "U4": "u4", "I1": "i1", "I2": "i2"}
_KINDS |= {"I4": "i4", "U8": "u8", "I8": "i8"}
_MAX_HEADER, _MAX_FIELDS = 10_000, 64
_MAX_BYTES = 4_000_000_000


@dataclass(frozen=True)
class _Header:
    width: int
    height: int
    dtype: "np.dtype[np.void]"
    names: tuple[str, ...]
    """Of the columns of a text: a field of several numbers has as many."""
    time: str | None
    """The one that tells when a point was seen."""
    data: str


def read_pcd(path: Path) -> Cloud:
    """Raises `InputError` for a file that is damaged or compressed."""
    header, body = _header(path, read_bytes(path, _MAX_BYTES, "a point cloud"))
    count = header.width * header.height
    wanted = ["x", "y", "z", *([header.time] if header.time else [])]
    if header.data == "binary":
        if len(body) < count * header.dtype.itemsize:
            raise InputError(path, "file", "expected a whole PCD, but it ends early")
        rows = np.frombuffer(body, dtype=header.dtype, count=count)
        columns = [rows[name].astype(np.float64) for name in wanted]
    else:
        columns = _ascii(path, header, body, count, wanted)
    shape = header.height, header.width
    points = np.stack(columns[:3], axis=-1).reshape(*shape, 3)
    return Cloud(points, columns[3].reshape(shape) if header.time else None)


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
    if not 0 < prod((max(width, 0), max(height, 0))) <= MAX_POINTS or len(names) > _MAX_FIELDS:
        raise InputError(path, "WIDTH", f"expected 1 to {MAX_POINTS:,} points")
    wrong = any(count < 1 or count > _MAX_HEADER for count in counts)
    single = all(counts[names.index(axis)] == 1 for axis in "xyz" if axis in names)
    if wrong or not single or not {"x", "y", "z"} <= set(names):
        raise InputError(path, "FIELDS", f"expected x, y and z once each, got {names[:9]}")
    time = time_name([n for n, count in zip(names, counts, strict=True) if count == 1])
    # Names such as _ for padding may stand several times.
    unique = [n if n in ("x", "y", "z", time) else f"{k}" for k, n in enumerate(names)]
    packed = [
        (u, f"<{f}", (c,)) if c > 1 else (u, f"<{f}")
        for u, (_, f, c) in zip(unique, fields, strict=True)
    ]
    columns = tuple(u for u, (_, _, c) in zip(unique, fields, strict=True) for _ in range(c))
    header = _Header(width, height, np.dtype(packed), columns, time, kind)
    return header, data[line_end + 1 :]


def _ascii(
    path: Path, header: _Header, body: bytes, count: int, wanted: list[str]
) -> list[FloatArray]:
    wide = len(header.names)
    try:
        numbers = np.array(body.split(), dtype=np.float64)
    except ValueError as error:
        raise InputError(path, "points", f"expected numbers ({error})") from error
    if len(numbers) != count * wide:
        expected = f"expected {count} points of {wide} numbers"
        raise InputError(path, "points", f"{expected}, got {len(numbers)} numbers")
    rows = numbers.reshape(count, wide)
    return [rows[:, header.names.index(name)] for name in wanted]
