"""Files that are what a name promises: no pipe that never ends, no device, not beyond a size."""

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from pcnav.core.errors import InputError

_CHUNK = 1 << 20


def require_regular(
    path: Path, max_bytes: int | None = None, what: str = "a readable file"
) -> None:
    """Raise `InputError` unless a path is a file, ``what`` it should be, of at most so many bytes.

    Opening a pipe (FIFO) waits for whoever writes into it, for ever; a device may never end.
    """
    try:
        found = path.stat()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(path, "file", f"expected {what} ({reason})") from error
    if stat.S_ISDIR(found.st_mode):
        raise InputError(path, "file", f"expected {what} ({os.strerror(errno.EISDIR)})")
    if not stat.S_ISREG(found.st_mode):
        raise InputError(path, "file", f"expected {what}, this is a pipe, a socket or a device")
    if max_bytes is not None and found.st_size > max_bytes:
        expected = f"expected at most {max_bytes:,} bytes, it has {found.st_size:,}"
        raise InputError(path, "file", expected)


def read_bytes(path: Path, max_bytes: int, what: str = "a readable file") -> bytes:
    """All of a file of at most so many bytes, ``what`` it should be. Raises `InputError`."""
    require_regular(path, max_bytes, what)
    try:
        with path.open("rb") as file:
            content = _read(file, max_bytes)
    except OSError as error:
        raise InputError(path, "file", f"expected {what} ({error.strerror})") from error
    if len(content) > max_bytes:
        raise InputError(path, "file", f"expected at most {max_bytes:,} bytes")
    return content


def _read(file: BinaryIO, max_bytes: int) -> bytes:
    """All of a file, or more than so many bytes of it.

    A buffer of as many bytes as are asked for is made first: so what is there is asked for.
    """
    left = max_bytes + 1
    content = file.read(min(os.fstat(file.fileno()).st_size + 1, left))
    if len(content) == left:
        return content
    # It has grown since, or tells no size.
    more, left = [content], left - len(content)
    while part := file.read(min(_CHUNK, left)):
        more.append(part)
        left -= len(part)
    return b"".join(more) if len(more) > 1 else content
