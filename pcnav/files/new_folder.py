"""A folder that is either whole or not there."""

import os
import secrets
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from pcnav.core.errors import InputError


@contextmanager
def new_folder(
    out: Path, overwrite: bool, marker: str, only: Collection[str] | None = None
) -> Iterator[Path]:
    """A temporary sibling of a folder; it takes the folder's name when the block ends well.

    An exception in the block removes all that was written and leaves an earlier folder as it was.
    Raises `InputError`, at once and again before the name is taken, when the folder holds anything
    and ``overwrite`` is false, or when it has no file named ``marker`` or anything besides names in
    ``only``: being told to overwrite must not cost somebody a folder that never was of this kind.
    """
    folder = out.resolve()
    _refuse_unless_replaceable(folder, overwrite, marker, only)
    # A sibling lies on the same file system, so that the final rename is atomic.
    staging = folder.parent / f".{folder.name}-{secrets.token_hex(4)}"
    new_parents = [parent for parent in folder.parents if not parent.exists()]
    try:
        try:
            staging.mkdir(parents=True)
        except OSError as error:
            expected = f"expected a place that can be written ({error.strerror})"
            raise InputError(out, "folder", expected) from error
        yield staging
        _refuse_unless_replaceable(folder, overwrite, marker, only)
        _move_into_place(staging, folder)
    finally:
        # Does nothing after a successful move.
        shutil.rmtree(staging, ignore_errors=True)
        for parent in new_parents:
            with suppress(OSError):
                parent.rmdir()


def _refuse_unless_replaceable(
    folder: Path, overwrite: bool, marker: str, only: Collection[str] | None
) -> None:
    if not os.path.lexists(folder):
        return
    if not folder.is_dir():
        raise InputError(folder, "folder", "expected a folder, this is a file")
    names = sorted(path.name for path in folder.iterdir())
    if not names:
        return
    if not overwrite:
        raise InputError(folder, "folder", "expected an empty or new folder (or ask to overwrite)")
    if not (folder / marker).is_file():
        expected = f"expected an earlier folder of this kind to overwrite, but it has no {marker}"
        raise InputError(folder, "folder", expected)
    foreign = [name for name in names if only is not None and name not in only]
    if foreign:
        expected = f"expected an earlier folder of this kind to overwrite, but it has {foreign[0]}"
        raise InputError(folder, "folder", expected)


def _move_into_place(staging: Path, folder: Path) -> None:
    """Rename the complete folder to its name; an earlier one is deleted only afterwards."""
    if not folder.exists():
        staging.rename(folder)
        return
    earlier = staging.with_name(f"{staging.name}-earlier")
    folder.rename(earlier)
    try:
        staging.rename(folder)
    except BaseException:
        if not folder.exists():
            earlier.rename(folder)
        raise
    shutil.rmtree(earlier, ignore_errors=True)
