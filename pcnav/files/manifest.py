"""What pcnav wrote into a folder, listed in the folder itself: nothing else is ever removed."""

import json
import os
from collections.abc import Iterable, Iterator
from pathlib import Path, PurePath, PurePosixPath

MANIFEST_FILE = ".pcnav-files"
"""A JSON list of the paths of all other files, relative to the folder, with slashes."""
_MAX_BYTES = 100_000_000
"""Of a list: a million frames fit."""


def write_manifest(folder: Path, coming: Iterable[str] = ()) -> None:
    """List all files that a folder holds now, as written by pcnav, and those that it will."""
    names = sorted({*_names_below(folder), *coming} - {MANIFEST_FILE})
    text = json.dumps(names, indent=0) + "\n"
    (folder / MANIFEST_FILE).write_text(text, encoding="utf-8")


def first_foreign(folder: Path) -> str | None:
    """The first file, link or empty folder that the folder's own list does not name, if any."""
    listed = _listed(folder)
    return min((name for name in _names_below(folder) if name not in listed), default=None)


def remove_listed(folder: Path) -> None:
    """Remove the files that a folder lists, then the folder; whatever else is there stays.

    Links are removed and not followed. Raises ``OSError`` when the folder is not empty then.
    """
    listed = _listed(folder)
    for where, folders, files in os.walk(folder, topdown=False):
        for name in files:
            path = Path(where, name)
            if path.relative_to(folder).as_posix() in listed:
                path.unlink(missing_ok=True)
        for name in folders:
            path = Path(where, name)
            if not path.is_symlink() and not any(path.iterdir()):
                path.rmdir()
    folder.rmdir()


def _names_below(folder: Path) -> Iterator[str]:
    """Paths of files, links and empty folders, these with a slash at the end.

    What a link leads to is not looked into.
    """
    for where, folders, files in os.walk(folder):
        links = [name for name in folders if Path(where, name).is_symlink()]
        for name in (*files, *links):
            yield Path(where, name).relative_to(folder).as_posix()
        if not files and not folders and Path(where) != folder:
            yield _as_folder(Path(where).relative_to(folder))


def _listed(folder: Path) -> frozenset[str]:
    """What the list names, with the folders that are in and itself; nothing without a list."""
    path = folder / MANIFEST_FILE
    try:
        if path.is_symlink() or not path.is_file() or path.stat().st_size > _MAX_BYTES:
            return frozenset()
        names = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return frozenset()
    if not isinstance(names, list):
        return frozenset()
    named = [name for name in names if isinstance(name, str)]
    # A folder whose files somebody removed is still ours.
    folders = {_as_folder(each) for name in named for each in PurePosixPath(name).parents}
    return frozenset([MANIFEST_FILE, *named, *folders])


def _as_folder(path: PurePath) -> str:
    return f"{path.as_posix()}/"
