"""``pcnav forecast``: where a point of the target will be."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pcnav.cli.options import Overwrite
from pcnav.core.errors import InputError

if TYPE_CHECKING:
    from pcnav.evaluation.forecast.point import Forecast

_TABLE, _PICTURES = ".csv", (".png", ".svg")
_MAX_TIMES = 20_000


def forecast(
    run: Annotated[Path, typer.Argument(help="Result folder.")],
    point: Annotated[
        str,
        typer.Option(
            help="'x y z' in m, model frame; com, origin, or the name of a face, as "
            "`pcnav target` lists them."
        ),
    ] = "com",
    normal: Annotated[
        str | None,
        typer.Option(help="Outward normal there, 'x y z'; a face that is named has its own."),
    ] = None,
    ahead: Annotated[
        float, typer.Option(min=1e-3, max=1e6, help="Seconds after the last estimate.")
    ] = 120.0,
    step: Annotated[float, typer.Option(min=1e-3, help="Seconds between its times.")] = 1.0,
    facing_deg: Annotated[
        float | None,
        typer.Option(
            min=0.0,
            max=180.0,
            help="Windows: largest angle between the normal and the direction to the chaser; 30 "
            "of a point with a normal unless another limit is told.",
        ),
    ] = None,
    speed_m_s: Annotated[
        float | None, typer.Option(min=0.0, help="Windows: largest speed, in the Hill frame.")
    ] = None,
    turning_deg_s: Annotated[
        float | None, typer.Option(min=0.0, help="Windows: largest rate of the normal.")
    ] = None,
    tolerance_m: Annotated[float, typer.Option(min=1e-9, help="Of the position.")] = 0.1,
    tolerance_deg: Annotated[float, typer.Option(min=1e-9, help="Of the attitude.")] = 5.0,
    out: Annotated[
        list[Path] | None,
        typer.Option("-o", "--out", help="Also write a .csv, .png or .svg; repeatable."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Tell where a point of the target will be, how well that is known, and when it can be reached.

    Motions drawn from the run's last estimate and its covariance are carried forward: as a free
    body's, or, where the run was followed as kinematic, under accelerations as strong as it showed.

    Example: `pcnav forecast runs/boxsat-result --point bus_x_plus --ahead 120 -o forecast.png`
    """
    import numpy as np
    from rich.console import Console

    from pcnav.evaluation.forecast.hindcast import hindcast
    from pcnav.evaluation.forecast.named_point import named_point
    from pcnav.evaluation.forecast.point import Limits
    from pcnav.evaluation.forecast.point import forecast as forecast_point
    from pcnav.evaluation.forecast.start import read_start
    from pcnav.files.new_file import refuse_existing
    from pcnav.report.forecast import (
        forecast_table,
        hindcast_sentence,
        tolerance_sentences,
        window_sentences,
    )

    for path in out or ():
        refuse_existing(path, overwrite)
        if path.suffix.lower() not in (_TABLE, *_PICTURES):
            raise InputError(path, "--out", "expected a name ending in .csv, .png or .svg")
    if ahead / step > _MAX_TIMES:
        raise InputError(run, "--step", f"expected at most {_MAX_TIMES} times until --ahead")
    start, answer, found_run = read_start(run)
    pipeline = found_run.pipeline
    at = named_point(point, normal, run, pipeline)
    if at.normal_model is None and (facing_deg is not None or turning_deg_s is not None):
        raise InputError(run, "--normal", "expected one, for the windows that it is asked for")
    if (facing_deg, speed_m_s, turning_deg_s) == (None,) * 3 and at.normal_model is not None:
        facing_deg = 30.0
    limits = Limits(_radians(facing_deg), speed_m_s, _radians(turning_deg_s))
    times = np.append(np.arange(0.0, ahead - 1e-9 * step, step), ahead)
    rng = np.random.default_rng(0 if pipeline is None else pipeline.seed)
    found = forecast_point(start, at, times, rng, limits)
    console = Console(width=max(Console().width, 130))
    console.print(forecast_table(found).to_rich())
    tolerances = (tolerance_m, float(np.deg2rad(tolerance_deg)))
    for sentence in (*window_sentences(found), *tolerance_sentences(found, *tolerances)):
        typer.echo(sentence)
    checked = hindcast(found_run, start, rng)
    if checked is not None:
        typer.echo(hindcast_sentence(checked))
    for text in answer.warnings:
        typer.echo(f"warning of the run: {text}")
    for path in out or ():
        _write(path, found, tolerances)
        typer.echo(f"forecast: {path}")


def _write(path: Path, found: "Forecast", tolerances: tuple[float, float]) -> None:
    from pcnav.evaluation.forecast.csv_file import forecast_csv
    from pcnav.files.new_file import write_whole
    from pcnav.report.figures import svg_bytes
    from pcnav.report.forecast import forecast_figure
    from pcnav.report.target_picture import png_of

    if path.suffix.lower() == _TABLE:
        write_whole(path, forecast_csv(found).encode())
        return
    figure = forecast_figure(found, *tolerances)
    write_whole(path, svg_bytes(figure) if path.suffix.lower() == ".svg" else png_of(figure))


def _radians(degrees: float | None) -> float | None:
    return None if degrees is None else math.radians(degrees)
