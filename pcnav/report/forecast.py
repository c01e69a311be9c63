"""A forecast as people read it: tables for a terminal, and a figure."""

import numpy as np
from matplotlib.figure import Figure

from pcnav.core.arrays import FloatArray
from pcnav.evaluation.forecast.hindcast import Hindcast
from pcnav.evaluation.forecast.point import Forecast, Instant, Limits
from pcnav.evaluation.forecast.windows import LIKELY, SURE, Window, stays_within, windows
from pcnav.files.text_table import MISSING, TextTable, display_unit, number
from pcnav.report.figures import LINE
from pcnav.report.panels import Curve, Panel, Scale, panels_figure

_SHOWN_S = (0.0, 1.0, 3.0, 10.0, 30.0, 60.0, 120.0, 300.0, 600.0)
_WINDOW = "#16a34a"
_HEADER = (
    *("ahead, s", "position in hill, m", "95 % within", "velocity in hill, m/s", "95 % within"),
    *("attitude\n95 % within, deg", "facing, deg\n5, 50, 95 %", "probability"),
)


def forecast_table(forecast: Forecast) -> TextTable:
    """The forecast at a few times."""
    ahead = forecast.ahead_s
    shown = sorted({int(np.abs(ahead - t).argmin()) for t in (*_SHOWN_S, ahead[-1])})
    rows = tuple(_row(float(ahead[k]), forecast.instants[k]) for k in shown)
    moves = "as a free body" if forecast.start.torque_free else "in any way"
    note = (
        "Position and velocity seen from the chaser's mass centre in the turning Hill frame. 95 % "
        "of the drawn motions are within the distances and angles of the mean. Probability: of "
        f"{_limits(forecast.limits)}."
    )
    at = number(forecast.start.time_s)
    title = f"{forecast.point.name}, from the estimate at {at} s, moving {moves}"
    return TextTable("forecast", title, _HEADER, rows, note)


def _row(ahead: float, at: Instant) -> tuple[str, ...]:
    facing = MISSING
    if at.facing_rad is not None:
        facing = ", ".join(number(angle) for angle in np.rad2deg(at.facing_rad).tolist())
    return (
        number(ahead),
        _vector(at.position.mean, at.position.radius),
        _length(at.position.radius, "m"),
        _vector(at.velocity.mean, at.velocity.radius),
        _length(at.velocity.radius, "m/s"),
        number(float(np.rad2deg(at.attitude.radius))),
        facing,
        f"{at.probability:.0%}",
    )


def _vector(values: FloatArray, radius: float) -> str:
    decimals = int(np.clip(-np.floor(np.log10(max(radius, 1e-9))), 1, 6))
    return ", ".join(f"{value:.{decimals}f}" for value in values.tolist())


def _length(radius: float, unit: str) -> str:
    scale, unit = display_unit(unit, radius)
    return f"{number(scale * radius)} {unit}"


def _limits(limits: Limits) -> str:
    told = []
    if limits.facing_rad is not None:
        told.append(f"facing the chaser within {number(np.rad2deg(limits.facing_rad))} deg")
    if limits.speed_m_s is not None:
        told.append(f"moving by at most {_length(limits.speed_m_s, 'm/s')}")
    if limits.turning_rad_s is not None:
        told.append(f"turning by at most {number(np.rad2deg(limits.turning_rad_s))} deg/s")
    return ", ".join(told) or "nothing, since no limit was told"


def window_sentences(forecast: Forecast) -> list[str]:
    """When the point is within its limits."""
    if forecast.limits == Limits():
        return []
    told = []
    for probability in (SURE, LIKELY):
        found = windows(forecast, probability)
        spans = ", ".join(map(_span, found)) or "never"
        told.append(f"{_limits(forecast.limits)}, with {probability:.0%} or more: {spans}")
    return told


def _span(window: Window) -> str:
    return f"{number(window.begin_s)} to {number(window.end_s)} s"


def tolerance_sentences(forecast: Forecast, tolerance_m: float, tolerance_rad: float) -> list[str]:
    """For how long the forecast is good enough."""
    position, attitude = _radii(forecast)
    told = []
    for name, radius, tolerance, unit in (
        ("position", position, tolerance_m, _length(tolerance_m, "m")),
        ("attitude", attitude, tolerance_rad, f"{number(np.rad2deg(tolerance_rad))} deg"),
    ):
        until = stays_within(forecast.ahead_s, radius, tolerance)
        span = f"for {number(until)} s"
        if np.isinf(until):
            span = f"for all of the {number(float(forecast.ahead_s[-1]))} s"
        elif np.isnan(until):
            span = "at no time"
        told.append(f"{name} known to {unit} (95 %): {span}")
    return told


def hindcast_sentence(checked: Hindcast) -> str:
    """How well the run's earlier estimates foretold its last ones."""
    text = (
        f"of {checked.forecasts} forecasts over {number(checked.span_s)} s within the run, "
        f"{checked.held} hold the later estimate in their 95 % ellipsoids"
    )
    if not checked.is_refuted:
        return text
    return f"warning: {text}: it does not move as it is followed, do not rely on this forecast"


def _radii(forecast: Forecast) -> tuple[FloatArray, FloatArray]:
    position = np.array([each.position.radius for each in forecast.instants])
    return position, np.array([each.attitude.radius for each in forecast.instants])


def forecast_figure(forecast: Forecast, tolerance_m: float, tolerance_rad: float) -> Figure:
    """Doubts over time with their tolerances; where the point is, and which way it faces."""
    position, attitude = _radii(forecast)
    scale, unit = display_unit("m", float(np.median(position)))
    levels = (scale * tolerance_m, float(np.rad2deg(tolerance_rad)))
    where = np.array([each.position.mean for each in forecast.instants])
    where = (where - where.mean(axis=0)).T
    panels = [
        Panel(
            "position, m",
            [Curve(f"{axis} in hill", each) for axis, each in zip("xyz", where, strict=True)],
            title="mean position, from its own mean over the time shown",
        ),
        _doubt(f"within, {unit}", scale * position, levels[0], "95 % of positions"),
        _doubt("within, deg", np.rad2deg(attitude), levels[1], "95 % of attitudes"),
    ]
    facing = [each.facing_rad for each in forecast.instants if each.facing_rad is not None]
    if facing:
        low, middle, high = np.rad2deg(np.array(facing)).T
        limit = forecast.limits.facing_rad
        panels.append(
            Panel(
                "facing, deg",
                [Curve("", middle, colour=LINE)],
                bands={"5 to 95 %": (low, high)},
                levels={} if limit is None else {"limit": float(np.rad2deg(limit))},
                limits=(0.0, 180.0),
                title="angle between normal and direction to the chaser, 5 to 95 %; dashed: limit",
            )
        )
    if forecast.limits != Limits():
        likely = np.array([each.probability for each in forecast.instants])
        title = "probability of being within the limits; shaded: 95 % or more"
        curve = Curve("", likely, colour=_WINDOW)
        panels.append(Panel("probability", [curve], title=title, limits=(-0.02, 1.04)))
    figure = panels_figure(forecast.ahead_s, panels, row_in=1.6, at_label="ahead, s")
    for window in windows(forecast, SURE):
        for axes in figure.axes:
            axes.axvspan(window.begin_s, window.end_s, color=_WINDOW, alpha=0.12, linewidth=0)
    return figure


def _doubt(label: str, radius: FloatArray, tolerance: float, title: str) -> Panel:
    curves = [Curve("", radius, colour=LINE)]
    levels = {"tolerance": tolerance}
    return Panel(
        label,
        curves,
        Scale.LOG,
        levels=levels,
        title=f"{title} are so near the mean; dashed: tolerance",
    )
