"""Whether a folder can be looked at; asked before anything slow is loaded."""

from pathlib import Path

from pcnav.core.errors import InputError
from pcnav.runs.result_files import STATES_FILE


def refuse_what_is_no_run(folder: Path) -> None:
    """Raise `InputError` unless a folder holds a run, finished or not."""
    if not folder.is_dir():
        raise InputError(folder, "folder", _expected(folder))
    if not (folder / STATES_FILE).is_file():
        raise InputError(folder / STATES_FILE, "file", "expected a result folder, which has one")


def _expected(folder: Path) -> str:
    staged = sorted(folder.parent.glob(f".{folder.name}-*")) if folder.parent.is_dir() else []
    if staged:
        return f"expected a result folder; an unfinished run of this name is {staged[-1]}"
    return "expected a result folder of pcnav run"
