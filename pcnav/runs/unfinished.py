"""A result folder that is still being written, or whose run was killed: what is whole in it."""

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pcnav.core.errors import InputError
from pcnav.runs.results import (
    COVARIANCES_FILE,
    MEASUREMENT_COLUMNS,
    MEASUREMENTS_FILE,
    POSES_FILE,
    STATES_FILE,
    TRACK_COLUMNS,
)

_FIRST_STATE = TRACK_COLUMNS.index("r_x_m")


def is_unfinished(folder: Path) -> bool:
    """Whether the folder of a run on depth frames has not been completed."""
    return (folder / STATES_FILE).is_file() and not (folder / COVARIANCES_FILE).is_file()


@contextmanager
def whole_rows(folder: Path) -> Iterator[Path]:
    """A temporary copy of states, poses and measurements, cut where the first of them ends.

    The files are written through buffers of their own, so that each may end in the middle of
    another frame. Raises `InputError` when one of them is missing or cannot be read.
    """
    states = _whole_lines(folder / STATES_FILE)
    poses = _whole_lines(folder / POSES_FILE)
    measurements = _whole_lines(folder / MEASUREMENTS_FILE)
    # Headers, too, may still be in a buffer.
    kept, used = states[:1] or [_line(TRACK_COLUMNS)], 0
    for line in states[1:]:
        fields = line.split(",")
        if len(fields) != len(TRACK_COLUMNS):
            break
        if fields[_FIRST_STATE]:
            if used == len(poses):
                break
            used += 1
        kept.append(line)
    last_s = float(kept[-1].split(",")[0]) if len(kept) > 1 else float("-inf")
    seen = [line for line in measurements[1:] if float(line.split(",")[0]) <= last_s]
    with tempfile.TemporaryDirectory(prefix="pcnav-unfinished-") as name:
        copy = Path(name)
        (copy / STATES_FILE).write_text("".join(kept), encoding="utf-8")
        (copy / POSES_FILE).write_text("".join(poses[:used]), encoding="utf-8")
        text = "".join([*(measurements[:1] or [_line(MEASUREMENT_COLUMNS)]), *seen])
        (copy / MEASUREMENTS_FILE).write_text(text, encoding="utf-8")
        yield copy


def _whole_lines(path: Path) -> list[str]:
    """The lines of a text file that end."""
    try:
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, "file", f"expected a readable text file ({error})") from error
    return [line for line in lines if line.endswith("\n")]


def _line(names: tuple[str, ...]) -> str:
    return ",".join(names) + "\n"
