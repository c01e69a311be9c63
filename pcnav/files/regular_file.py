"""Files that are what a name promises: no pipe that never ends, no device, not beyond a size."""

import errno
import os
import stat
from pathlib import Path

from pcnav.core.errors import InputError


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
            content = file.read(max_bytes + 1)
    except OSError as error:
        raise InputError(path, "file", f"expected {what} ({error.strerror})") from error
    if len(content) > max_bytes:
        raise InputError(path, "file", f"expected at most {max_bytes:,} bytes")
    return content
