"""A single output file: never replaced unless told to, never half-written."""

import os
from contextlib import suppress
from pathlib import Path

from pcnav.core.errors import InputError
from pcnav.files.owned import collect, locked, part_name


def refuse_existing(path: Path, overwrite: bool) -> None:
    """Raise `InputError` where a file would be replaced without having been told to."""
    if path.exists() and not (overwrite and path.is_file()):
        expected = "expected a new file; --overwrite replaces an existing one"
        raise InputError(path, "file", expected)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that is either whole or not there. Raises `InputError` where it cannot be."""
    part = path.with_name(part_name(path.name))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        collect(path.parent)
        with locked(part) as descriptor, os.fdopen(descriptor, "wb", closefd=False) as file:
            file.write(content)
        part.replace(path)
    except OSError as error:
        expected = f"expected a place that can be written ({error.strerror})"
        raise InputError(path, "file", expected) from error
    finally:
        with suppress(OSError):
            part.unlink()
