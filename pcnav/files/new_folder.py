"""A folder that is either whole or not there."""

import logging
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from pcnav.core.errors import InputError
from pcnav.files.manifest import MANIFEST_FILE, first_foreign, remove_listed, write_manifest
from pcnav.files.owned import collect, earlier_name, owned, owned_name

_log = logging.getLogger(__name__)

_NEW = "expected an empty or new folder; --overwrite (overwrite=True) replaces this one"


class Place:
    """Where a folder is written: a temporary sibling, which takes the folder's name."""

    def __init__(self, staging: Path, folder: Path, refuse: Callable[[], None]) -> None:
        self._staging, self._folder, self._refuse = staging, folder, refuse
        self.has_appeared = False

    @property
    def path(self) -> Path:
        """Where the files are now."""
        return self._folder if self.has_appeared else self._staging

    def appear(self, coming: Iterable[str] = ()) -> Path:
        """Take the name now; what was called so is replaced. Files that are open stay open.

        From then on whatever is written stays, however the process ends; ``coming`` are the names
        of files that will be. Raises `InputError` as `refuse_unless_replaceable` does.
        """
        if not self.has_appeared:
            write_manifest(self._staging, coming)
            self._refuse()
            _move_into_place(self._staging, self._folder)
            self.has_appeared = True
        return self._folder


@contextmanager
def new_folder(out: Path, overwrite: bool, marker: str) -> Iterator[Path]:
    """A folder that takes its name when the block ends well: see `new_place`."""
    with new_place(out, overwrite, marker) as place:
        yield place.path


@contextmanager
def new_place(out: Path, overwrite: bool, marker: str) -> Iterator[Place]:
    """A temporary sibling of a folder; it takes the folder's name when the block ends well.

    The finished folder lists its files (see `pcnav.files.manifest`). An exception in the block
    removes all that was written, unless that has the name already, and leaves an earlier folder as
    it was; what processes that were killed left beside it is collected. Raises `InputError` as
    `refuse_unless_replaceable` does, at once and again before the name is taken.
    """
    folder = out.resolve()
    refuse_unless_replaceable(folder, overwrite, marker)
    collect(folder.parent)
    # A sibling lies on the same file system, so that the final rename is atomic.
    staging = folder.parent / owned_name(folder.name)
    new_parents = [parent for parent in folder.parents if not parent.exists()]
    with ExitStack() as ownership:
        try:
            try:
                staging.mkdir(parents=True)
                ownership.enter_context(owned(staging))
            except OSError as error:
                expected = f"expected a place that can be written ({error.strerror})"
                raise InputError(out, "folder", expected) from error
            place = Place(
                staging, folder, lambda: refuse_unless_replaceable(folder, overwrite, marker)
            )
            yield place
            if place.has_appeared:
                write_manifest(folder)
            place.appear()
        finally:
            # Does nothing after a successful move.
            shutil.rmtree(staging, ignore_errors=True)
            for parent in new_parents:
                with suppress(OSError):
                    parent.rmdir()


def refuse_unless_replaceable(folder: Path, overwrite: bool, marker: str) -> None:
    """Raise `InputError` where putting a folder there would cost somebody a file.

    What is there must be an empty folder, or, told to ``overwrite``, one of the same kind, which
    has a file named ``marker``, and holds nothing but what pcnav wrote and listed in it.
    """
    if not os.path.lexists(folder):
        return
    if not folder.is_dir():
        raise InputError(folder, "folder", "expected a folder, this is a file")
    if not any(folder.iterdir()):
        return
    if not overwrite:
        raise InputError(folder, "folder", _NEW)
    if not (folder / marker).is_file():
        expected = f"expected an earlier folder of this kind to overwrite, but it has no {marker}"
        raise InputError(folder, "folder", expected)
    _refuse_foreign(folder, folder)


def _refuse_foreign(content: Path, folder: Path) -> None:
    foreign = first_foreign(content)
    if foreign is not None:
        expected = (
            f"expected only files that pcnav wrote, to overwrite them, but it has {foreign}, "
            f"which its list {MANIFEST_FILE} does not name: move it or remove the folder yourself"
        )
        raise InputError(folder, "folder", expected)


def _move_into_place(staging: Path, folder: Path) -> None:
    """Rename the complete folder to its name; an earlier one is deleted only afterwards."""
    if not folder.exists():
        staging.rename(folder)
        return
    earlier = staging.with_name(earlier_name(staging.name))
    folder.rename(earlier)
    try:
        # Whatever came between the last look and now is in there as well.
        _refuse_foreign(earlier, folder)
        staging.rename(folder)
    except BaseException:
        if not folder.exists():
            earlier.rename(folder)
        raise
    try:
        remove_listed(earlier)
    except OSError as error:
        # Such as the file of somebody who still works in the folder.
        _log.warning("%s: stays, not all of it can be removed (%s)", earlier, error.strerror)
