"""Several recordings in one call of ``pcnav run``: each into a folder of its own."""

from collections import Counter
from collections.abc import Callable, Sequence
from datetime import datetime
from pathlib import Path

import typer

from pcnav.cli.dated_folder import dated_folder
from pcnav.cli.verbosity import say
from pcnav.core.errors import InputError


def folders_of(recordings: Sequence[Path], out: Path | None, now: datetime) -> list[Path]:
    """Result folders: in ``out`` by the recordings' names, with those above where names are alike.

    Without ``out`` dated ones. Raises `InputError` for a recording that is named twice.
    """
    places = [path.resolve() for path in recordings]
    twice = next((path for path, count in Counter(places).items() if count > 1), None)
    if twice is not None:
        raise InputError(twice, "recording", "expected every recording once")
    depth = 1
    while len({_name(place, depth) for place in places}) < len(places):
        depth += 1
    names = [_name(place, depth) for place in places]
    if out is not None:
        return [out / name for name in names]
    return [dated_folder(Path(name), now) for name in names]


def run_several(
    recordings: Sequence[Path],
    folders: Sequence[Path],
    run: Callable[[Path, Path], bool],
    as_json: bool = False,
) -> bool:
    """Run one after another; whether all found something.

    One that cannot be run is said, and the others are. Raises `InputError` at the end for such.
    """
    failed, found = [], []
    for recording, folder in zip(recordings, folders, strict=True):
        if not as_json:
            say(f"== {recording}")
        try:
            found.append(run(recording, folder))
        except InputError as error:
            typer.echo(f"error: {error}", err=True)
            failed.append(recording)
    if failed:
        names = ", ".join(map(str, failed))
        expected = f"expected recordings that can be run; not run: {names}"
        raise InputError("pcnav run", f"{len(failed)} of {len(recordings)}", expected)
    return all(found)


def _name(place: Path, depth: int) -> str:
    *above, last = place.parts[-depth:]
    stem = Path(last).stem if place.is_file() else last
    return "-".join([*(part for part in above if part != place.anchor), stem])
