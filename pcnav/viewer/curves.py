"""What the plots show, as numbers: series over time with their bounds. No drawing here."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pcnav.core import chi_square
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, OMEGA_BODY, R_HILL, THETA_BODY
from pcnav.files.text_table import display_unit
from pcnav.report.envelope import envelope
from pcnav.viewer.loaded_run import LoadedRun

_BUCKETS = 400
"""Long series are drawn by the extremes of so many spans of time."""
_DECADES_FROM = 20.0
_CONFIDENCE = 0.95
_KNOWN_FROM = 0.5
"""A mass property is known from data once its sd is this share of the prior's."""
_LAST_TENTH = 0.9


@dataclass(frozen=True)
class Curve:
    """A line over time, and its 3 sigma bounds where it has any."""

    values: FloatArray
    """(n,) in the unit of its chart; nan where there is no value."""
    low: FloatArray | None = None
    high: FloatArray | None = None
    """(n,) bounds."""
    dots: bool = False


@dataclass(frozen=True)
class Chart:
    """One plot of one run."""

    label: str
    """Of the vertical axis, with its unit."""
    time_s: FloatArray
    curve: Curve
    is_error: bool = False
    linear_to: float | None = None
    """Beyond this the axis is logarithmic; None for a linear axis."""
    bound: float | None = None
    """A level that most values should stay below."""
    known: BoolArray | None = None
    """(n,) where the value is known from data rather than from the prior."""

    def shown(self) -> FloatArray:
        """Indices of the frames that draw the curve and its bounds without losing a peak."""
        wanted = [envelope(self.curve.values, _BUCKETS)]
        if self.curve.high is not None:
            wanted.append(envelope(self.curve.high, _BUCKETS // 4))
        return np.unique(np.concatenate(wanted))


@dataclass(frozen=True)
class ChartGroup:
    """Plots that are shown together."""

    title: str
    charts: tuple[Chart, ...]
    remark: str = ""


def groups_of(loaded: LoadedRun) -> dict[str, Callable[[], ChartGroup]]:
    """The groups of plots that a run has, by name, made when asked for."""
    groups: dict[str, Callable[[], ChartGroup]] = {}
    if loaded.has_position:
        groups["position"] = lambda: _position(loaded)
    groups["attitude"] = lambda: _attitude(loaded)
    groups["rate"] = lambda: _components(loaded, "rate", OMEGA_BODY, _AXES, "deg/s")
    if loaded.has_mass_centre:
        groups["mass centre"] = lambda: _components(loaded, "mass centre", COM_MODEL, _AXES, "m")
    if loaded.has_inertia:
        groups["inertia ratios"] = lambda: _inertia(loaded)
    groups["consistency"] = lambda: _consistency(loaded)
    return groups


_AXES = ("x", "y", "z")
_RATIOS = ("Iyy / Ixx", "Izz / Ixx", "Ixy / Ixx", "Ixz / Ixx", "Iyz / Ixx")
_RATIO_COLUMNS = ("i_yy", "i_zz", "i_xy", "i_xz", "i_yz")
_VALUES: dict[str, Callable[[LoadedRun], FloatArray]] = {
    "rate": lambda loaded: np.rad2deg(loaded.track.omega_body),
    "mass centre": lambda loaded: loaded.track.com_model,
    "inertia ratios": lambda loaded: loaded.track.inertia_ratios,
}


def _position(loaded: LoadedRun) -> ChartGroup:
    track = loaded.track
    error = _state_error(loaded, R_HILL)
    if error is None:
        return _group(loaded, "position, hill axes", track.r_hill, track.sd[:, R_HILL], _AXES, "m")
    return _group(
        loaded, "position, hill axes", error, track.sd[:, R_HILL], _AXES, "m", is_error=True
    )


def _attitude(loaded: LoadedRun) -> ChartGroup:
    sd = np.rad2deg(loaded.track.sd[:, THETA_BODY])
    error = _state_error(loaded, THETA_BODY)
    if error is None and loaded.evaluation is not None:
        error = loaded.evaluation.errors.theta_model_rad
    if error is not None:
        return _group(
            loaded, "attitude, body axes", np.rad2deg(error), sd, _AXES, "deg", is_error=True
        )
    # An attitude has no value per axis; its three standard deviations do.
    return _group(loaded, "attitude, 3 sigma", 3.0 * sd, None, _AXES, "deg")


def _components(
    loaded: LoadedRun, title: str, block: slice, names: tuple[str, ...], unit: str
) -> ChartGroup:
    scale = 180.0 / np.pi if unit == "deg/s" else 1.0
    sd = scale * loaded.track.sd[:, block]
    error = _state_error(loaded, block)
    if error is not None:
        return _group(loaded, title, scale * error, sd, names, unit, is_error=True)
    return _group(loaded, title, _VALUES[title](loaded), sd, names, unit)


def _inertia(loaded: LoadedRun) -> ChartGroup:
    group = _components(loaded, "inertia ratios", INERTIA_RATIOS, _RATIOS, "1")
    charts: list[Chart] = []
    known_names: list[str] = []
    prior_names: list[str] = []
    for chart, column, name in zip(group.charts, _RATIO_COLUMNS, _RATIOS, strict=True):
        verdict = loaded.verdicts.get(column)
        if verdict is None:
            charts.append(chart)
            continue
        (known_names if verdict.from_data else prior_names).append(name.split(" ")[0])
        sd = loaded.track.sd[:, INERTIA_RATIOS][:, _RATIO_COLUMNS.index(column)]
        known = (sd <= _KNOWN_FROM * verdict.prior_sd) & verdict.from_data
        charts.append(
            Chart(
                chart.label,
                chart.time_s,
                chart.curve,
                chart.is_error,
                chart.linear_to,
                known=known,
            )
        )
    remark = ""
    if loaded.verdicts:
        parts = [f"known from data: {', '.join(known_names) or 'none'}"]
        parts.append(f"prior only: {', '.join(prior_names) or 'none'}")
        remark = "; ".join(parts)
    return ChartGroup(group.title, tuple(charts), remark)


def _consistency(loaded: LoadedRun) -> ChartGroup:
    track = loaded.track
    used = np.isfinite(track.nis) & (track.nis_dof > 0)
    ratio = np.full(len(track), np.nan)
    ratio[used] = track.nis[used] / chi_square.quantile(_CONFIDENCE, track.nis_dof[used])
    charts = []
    if used.any():
        charts.append(
            Chart(
                "NIS / its 95 % bound",
                track.time_s,
                Curve(ratio, dots=True),
                linear_to=2.0 if np.nanmax(ratio) > _DECADES_FROM else None,
                bound=1.0,
            )
        )
    if np.isfinite(track.inlier_ratio).any():
        charts.append(Chart("inlier ratio, %", track.time_s, Curve(100.0 * track.inlier_ratio)))
    counts = track.n_rectangles.astype(np.float64)
    charts.append(Chart(f"{loaded.counted} used, count", track.time_s, Curve(counts)))
    return ChartGroup("consistency", tuple(charts))


def _group(
    loaded: LoadedRun,
    title: str,
    values: FloatArray,
    sd: FloatArray | None,
    names: tuple[str, ...],
    unit: str,
    *,
    is_error: bool = False,
) -> ChartGroup:
    time_s = loaded.track.time_s
    scale, unit = _shown_unit(values, unit, time_s) if is_error else (1.0, unit)
    what = "error " if is_error else ""
    suffix = "" if unit == "1" else f", {unit}"
    charts = []
    for k, name in enumerate(names):
        value = scale * values[:, k]
        low = high = None
        if sd is not None and np.isfinite(sd[:, k]).any():
            centre = np.zeros_like(value) if is_error else value
            bound = 3.0 * scale * sd[:, k]
            low, high = centre - bound, centre + bound
        curve = Curve(value, low, high)
        linear = linear_range(time_s, high) if is_error and high is not None else None
        charts.append(Chart(f"{name} {what}".strip() + suffix, time_s, curve, is_error, linear))
    return ChartGroup(title, tuple(charts))


def linear_range(time_s: FloatArray, bound: FloatArray) -> float | None:
    """Where an axis may stop being linear, for a bound that shrinks by decades; else None.

    The power of ten from the settled bound on, the median of the last tenth of the time.
    """
    last = bound[time_s >= time_s[0] + _LAST_TENTH * np.ptp(time_s)]
    last = last[np.isfinite(last) & (last > 0.0)]
    known = bound[np.isfinite(bound)]
    if not last.size or known.max() <= _DECADES_FROM * np.median(last):
        return None
    return float(10.0 ** np.ceil(np.log10(np.median(last))))


def _state_error(loaded: LoadedRun, block: slice) -> FloatArray | None:
    """(n, k) true minus estimated; None where the truth does not know it."""
    if loaded.evaluation is None:
        return None
    error = loaded.evaluation.errors.state[:, block]
    return error if np.isfinite(error).any() else None


def _shown_unit(error: FloatArray, unit: str, time_s: FloatArray) -> tuple[float, str]:
    settled = np.abs(error[time_s >= time_s[0] + 0.1 * np.ptp(time_s)])
    known = settled[np.isfinite(settled)]
    return display_unit(unit, float(np.median(known)) if known.size else 1.0)
