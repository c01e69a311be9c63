"""Where a result goes when nobody says where."""

import os
import re
from contextlib import suppress
from datetime import datetime
from pathlib import Path

RUNS = Path("runs")
LATEST = "latest"
"""A link beside the results to the one that was made last."""


def dated_folder(recording: Path, now: datetime) -> Path:
    """A new folder in ``runs``, named after the time and the recording."""
    name = re.sub(r"[^\w.-]+", "-", recording.resolve().stem).strip("-.") or "run"
    stem = f"{now:%Y%m%d-%H%M%S}-{name}"
    names = (stem, *(f"{stem}-{k}" for k in range(2, 1000)))
    return next(RUNS / each for each in names if not (RUNS / each).exists())


def link_latest(folder: Path) -> None:
    """Let ``latest`` beside a folder lead to it, where the system has links and nothing else is
    called so."""
    link = folder.parent / LATEST
    if link.exists() and not link.is_symlink():
        return
    new = folder.parent / f".{LATEST}-{os.getpid()}"
    with suppress(OSError):
        new.symlink_to(folder.name, target_is_directory=True)
        new.replace(link)
