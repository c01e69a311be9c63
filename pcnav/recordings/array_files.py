"""Arrays in .npy and .npz files, one slice at a time: memory does not grow with their lengths."""

import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from math import prod
from pathlib import Path
from threading import Lock
from tokenize import TokenError
from typing import IO, Any
from weakref import finalize

import numpy as np
import numpy.typing as npt

from pcnav.core.errors import InputError

Array = npt.NDArray[Any]
_DAMAGED = (
    *(OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, NotImplementedError),
    *(zlib.error, TokenError, SyntaxError, RuntimeError, OverflowError, MemoryError),
)
"""What NumPy's parser of headers and the archive's decompression raise."""
_MAX_WHOLE_BYTES = 64_000_000
"""Of an array that is read at once: times, cameras and poses."""


@dataclass(frozen=True)
class ArrayHeader:
    """What an array is."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    is_fortran: bool
    offset: int
    """Of its data in the file or member."""


class ArrayFile:
    """The arrays of a .npz file by name, or the one of a .npy file, called "array"."""

    def __init__(self, path: Path) -> None:
        """Reads headers alone. Raises `InputError`."""
        self._path, self._lock = path, Lock()
        self._open: dict[str, IO[bytes]] = {}
        self._archive: zipfile.ZipFile | None = None
        try:
            if path.suffix.lower() == ".npz":
                self._archive = zipfile.ZipFile(path)
                finalize(self, _close, self._archive, self._open)
                names = [n for n in self._archive.namelist() if n.endswith(".npy")]
                members = {name.removesuffix(".npy"): name for name in names}
            else:
                members = {"array": ""}
            self._members = members
            self.headers: Mapping[str, ArrayHeader] = {name: self._header(name) for name in members}
        except _DAMAGED as error:
            raise self._damaged(error) from error

    def whole(self, name: str) -> Array:
        """A small array. Raises `InputError` where it is large or damaged."""
        header = self.headers[name]
        if _bytes_of(header) > _MAX_WHOLE_BYTES:
            expected = f"expected at most {_MAX_WHOLE_BYTES:,} bytes, got an array {header.shape}"
            raise InputError(self._path, name, expected)
        with self._lock:
            flat = self._read(name, 0, prod(header.shape))
        return flat.reshape(header.shape, order="F" if header.is_fortran else "C")

    def slice_of(self, name: str, index: int) -> Array:
        """One member along the first axis. Raises `InputError` where it is damaged."""
        header = self.headers[name]
        size = prod(header.shape[1:])
        with self._lock:
            return self._read(name, index * size, size).reshape(header.shape[1:])

    def _read(self, name: str, first: int, count: int) -> Array:
        header = self.headers[name]
        wanted = count * header.dtype.itemsize
        try:
            with self._stream(name) as file:
                file.seek(header.offset + first * header.dtype.itemsize)
                data = file.read(wanted)
            if len(data) != wanted:
                raise ValueError("it ends early")
        except _DAMAGED as error:
            raise self._damaged(error) from error
        return np.frombuffer(data, dtype=header.dtype).copy()

    @contextmanager
    def _stream(self, name: str) -> Iterator[IO[bytes]]:
        """A compressed member is kept open: it is read on, not from its beginning again."""
        if self._archive is None:
            with self._path.open("rb") as file:
                yield file
            return
        if name not in self._open:
            self._open[name] = self._archive.open(self._members[name])
        yield self._open[name]

    def _header(self, name: str) -> ArrayHeader:
        with self._stream(name) as file:
            version = np.lib.format.read_magic(file)
            read = np.lib.format.read_array_header_2_0
            if version == (1, 0):
                read = np.lib.format.read_array_header_1_0
            shape, is_fortran, dtype = read(file)
            offset = file.tell()
        header = ArrayHeader(shape, dtype, is_fortran, offset)
        if dtype.hasobject:
            raise ValueError(f"{name} holds objects")
        if self._bytes_there(name) < header.offset + _bytes_of(header):
            raise ValueError(f"{name} ends early")
        return header

    def _bytes_there(self, name: str) -> int:
        if self._archive is None:
            return self._path.stat().st_size
        return self._archive.getinfo(self._members[name]).file_size

    def _damaged(self, error: Exception) -> InputError:
        why = str(getattr(error, "strerror", None) or error)[:200]
        return InputError(self._path, "file", f"expected undamaged NumPy arrays ({why})")


def _bytes_of(header: ArrayHeader) -> int:
    return prod(header.shape) * header.dtype.itemsize


def _close(archive: zipfile.ZipFile, members: Mapping[str, IO[bytes]]) -> None:
    for member in members.values():
        member.close()
    archive.close()
