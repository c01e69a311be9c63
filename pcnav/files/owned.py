"""Temporary folders and files that belong to a process, and those whose process has ended.

A lock that the system takes back when a process ends, however it ends, tells the one from the
other. Where there are no such locks, nothing is ever taken for abandoned.
"""

import logging
import os
import re
import secrets
import shutil
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pcnav.files.manifest import MANIFEST_FILE, first_foreign, remove_listed

if sys.platform != "win32":
    import fcntl

_BEGUN = "[]\n"
"""A list without files: what the folder holds is not finished."""
_DIGITS = 8
_OWNED = re.compile(rf"\.(.+)-[0-9a-f]{{{_DIGITS}}}")
_EARLIER = "-earlier"
_PART = re.compile(rf"\..+-[0-9a-f]{{{_DIGITS}}}\.pcnav-part")
_PART_AFTER_S = 60.0
"""Between making a file and locking it a process may be slow, but not so slow."""

_log = logging.getLogger(__name__)


def owned_name(name: str) -> str:
    """A hidden name of one's own for what will be called ``name``."""
    return f".{name}-{secrets.token_hex(_DIGITS // 2)}"


def part_name(name: str) -> str:
    """Likewise for a single file that is being written."""
    return f"{owned_name(name)}.pcnav-part"


def earlier_name(staging: str) -> str:
    """What the folder that a finished one replaces is called for a moment."""
    return staging + _EARLIER


@contextmanager
def owned(folder: Path) -> Iterator[int]:
    """Mark a folder that was just made as this process's, until the block or the process ends.

    Gives the descriptor that holds the lock: a process that inherits it owns the folder, too.
    Raises ``OSError`` where the folder cannot be written.
    """
    with locked(folder / MANIFEST_FILE) as descriptor:
        # Only a file that says so is taken for ours, so this comes after the lock.
        os.write(descriptor, _BEGUN.encode("ascii"))
        yield descriptor


@contextmanager
def locked(path: Path) -> Iterator[int]:
    """Make a file and hold its lock. Raises ``OSError``, also where there is such a file."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    try:
        if sys.platform != "win32":
            # A file system may have no locks; then nobody gets one, and nothing is collected.
            with suppress(OSError):
                fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield descriptor
    finally:
        os.close(descriptor)


def collect(parent: Path) -> None:
    """Remove what processes that are no more left in a folder; theirs alone, never anybody's.

    An earlier result that a process had put aside when it was killed gets its name back. What
    cannot be removed stays.
    """
    if sys.platform == "win32":
        return
    with suppress(OSError):
        for path in sorted(parent.iterdir()):
            with suppress(OSError):
                _collect(path)


def _collect(path: Path) -> None:
    if _PART.fullmatch(path.name) and path.is_file() and not path.is_symlink():
        if time.time() - path.stat().st_mtime > _PART_AFTER_S and _is_free(path):
            path.unlink()
        return
    staging = path.name.removesuffix(_EARLIER)
    match = _OWNED.fullmatch(staging)
    if match is None or path.is_symlink() or not path.is_dir():
        return
    if path.name != staging:
        _settle_earlier(path, path.with_name(staging), path.with_name(match[1]))
    elif _is_abandoned(path):
        shutil.rmtree(path, ignore_errors=True)
        _log.info("%s: removed, a process that was killed left it unfinished", path)


def _settle_earlier(earlier: Path, staging: Path, folder: Path) -> None:
    """The one moment in which neither the earlier folder nor the new one has the name."""
    if first_foreign(earlier) is not None or (staging.exists() and not _is_abandoned(staging)):
        return
    if folder.exists():
        remove_listed(earlier)
    else:
        earlier.rename(folder)
        _log.info("%s: put back, a process was killed while it replaced it", folder)


def _is_abandoned(folder: Path) -> bool:
    """Whether a folder was begun by pcnav and no process has it."""
    marker = folder / MANIFEST_FILE
    return marker.is_file() and marker.stat().st_size > 0 and _is_free(marker)


def in_use(folder: Path) -> bool:
    """Whether a process writes a folder that was begun by pcnav."""
    marker = folder / MANIFEST_FILE
    return marker.is_file() and not _is_free(marker)


def _is_free(path: Path) -> bool:
    """Whether no process holds the lock of a file."""
    if sys.platform == "win32":
        return False
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    finally:
        os.close(descriptor)
    return True
