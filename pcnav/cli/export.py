"""``pcnav export``: a run in the formats that other tools read."""

import logging
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from pcnav.cli.options import Overwrite
from pcnav.cli.verbosity import say
from pcnav.core.errors import InputError

_LOG = logging.getLogger("pcnav")
_HELP = """Write the poses of a run, or all of it, in a format that other tools read.

**tum**, **kitti**, **csv**: poses of the model in the camera (T_cam_model, x right, y down, z
forward), m, quaternions scalar last; the truth beside them. **bop**: results of the BOP challenge
(mm). **oem**, **aem**: CCSDS ephemeris messages of the mass centre (km) and the attitude relative
to the chaser, UTC. **npz**: every array. **mcap**: ROS 2 messages (extra `bags`).
docs/formats.md says what each of them holds, to the unit.

Example: `pcnav export runs/boxsat-result --to tum -o boxsat.tum`
"""


def export(
    run: Annotated[Path, typer.Argument(help="Result folder.")],
    to: Annotated[str, typer.Option("--to", help="tum, kitti, csv, bop, oem, aem, npz or mcap.")],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="File; beside the result folder if not told."),
    ] = None,
    sequence: Annotated[
        Path | None, typer.Option(help="The recording, where it is no longer as the run names it.")
    ] = None,
    epoch: Annotated[
        str | None,
        typer.Option(
            help="UTC of time 0 of the run, like 2026-03-01T12:00:00, where the recording's time "
            "stamps are of no epoch."
        ),
    ] = None,
    claimed: Annotated[
        bool, typer.Option("--claimed", help="Only poses that are locked or ambiguous.")
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    from pcnav.files.new_file import refuse_existing, write_whole
    from pcnav.runs.export.content import exported
    from pcnav.runs.export.registry import FORMATS, companion

    if to not in FORMATS:
        raise InputError("pcnav export", "--to", f"expected one of {', '.join(FORMATS)}, got {to}")
    chosen, zero = FORMATS[to], None if epoch is None else _utc(epoch)
    found, missing = exported(run, recording=sequence, epoch=zero, only_claimed=claimed)
    whole = run.resolve()
    out = out or whole.with_name(whole.name + chosen.suffix)
    files = {companion(out, word): content for word, content in chosen.write(found).items()}
    for path in files:
        refuse_existing(path, overwrite)
    for sentence in missing:
        _LOG.warning("%s", sentence)
    for path, content in files.items():
        write_whole(path, content)
        say(f"{to}: {path}")
    # Who opens the file next must know its frames, orders and units.
    _LOG.info("%s", chosen.about)


export.__doc__ = _HELP


def _utc(text: str) -> datetime:
    try:
        found = datetime.fromisoformat(text)
    except ValueError as error:
        expected = f"expected UTC like 2026-03-01T12:00:00, got {text}"
        raise InputError("pcnav export", "--epoch", expected) from error
    return found.replace(tzinfo=UTC) if found.tzinfo is None else found
