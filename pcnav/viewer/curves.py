"""What the plots show, as numbers: series over time with their bounds. No drawing here."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.spatial import log_rotation
from pcnav.dynamics.blocks import ATTITUDE, CENTRE, POSITION, RATE, RATIOS, Block
from pcnav.evaluation.errors import Errors
from pcnav.evaluation.information_gain import MAX_PRIOR_SHARE
from pcnav.evaluation.metrics import error_norms
from pcnav.files.text_table import display_unit
from pcnav.report.envelope import envelope
from pcnav.viewer.assessment import nis_over_bound
from pcnav.viewer.loaded_run import LoadedRun

_BUCKETS = 400
"""Long series are drawn by the extremes of so many spans of time."""
_DECADES_FROM = 20.0
_MAX_DOTS = 1600
_KNOWN_FROM = float(np.sqrt(MAX_PRIOR_SHARE))
"""A mass property is known from data once its sd is this share of the prior's."""
_LAST_TENTH = 0.9
_GROUPS = {
    "position": POSITION,
    "attitude": ATTITUDE,
    "rate": RATE,
    "mass centre": CENTRE,
    "inertia ratios": RATIOS,
}
_MEASURED = "sd_measured_rad"
"""A column that has a value where an attitude was used."""
_USED = {
    "n_rectangles": "rectangles",
    "n_used": "features",
    "agreeing": "matches",
    _MEASURED: "attitudes",
}
"""What a frame used, by the column that tells how many, or `_MEASURED`."""


@dataclass(frozen=True)
class Chart:
    """One plot of one run: a line over time, and its 3 sigma bounds where it has any."""

    label: str
    """Of the vertical axis, with its unit."""
    time_s: FloatArray
    """(n,)"""
    values: FloatArray
    """(n,) in the unit of the axis; nan where there is no value."""
    low: FloatArray | None = None
    high: FloatArray | None = None
    """(n,) bounds."""
    is_dots: bool = False
    is_error: bool = False
    linear_to: float | None = None
    """Beyond this the axis is logarithmic; None for a linear axis."""
    bound: float | None = None
    """A level that most values should stay below."""
    known: BoolArray | None = None
    """(n,) where the value is known from data rather than from the prior."""
    estimated: BoolArray | None = None
    """(n,) frames that have an estimate; None where that is not asked."""

    def shown(self) -> IntArray:
        """Indices of the frames that draw the curve and its bounds without losing a peak."""
        wanted = [envelope(self.values, _BUCKETS)]
        if self.high is not None:
            wanted.append(envelope(self.high, _BUCKETS // 4))
        return np.unique(np.concatenate(wanted))


@dataclass(frozen=True)
class ChartGroup:
    """Plots that are shown together."""

    title: str
    charts: tuple[Chart, ...]
    remark: str = ""


def groups_of(loaded: LoadedRun) -> dict[str, Callable[[], ChartGroup]]:
    """The groups of plots that a run has, by name, made when asked for."""
    groups: dict[str, Callable[[], ChartGroup]] = {
        name: partial(_quantity, loaded, name, block)
        for name, block in _GROUPS.items()
        if loaded.has(block) or loaded.error(block) is not None
    }
    if loaded.errors is not None:
        groups["error norms"] = partial(_error_norms, loaded, loaded.errors)
    groups["consistency"] = partial(_consistency, loaded)
    return groups


def _error_norms(loaded: LoadedRun, compared: Errors) -> ChartGroup:
    """Of every quantity that metrics.json has statistics of."""
    time_s, charts = loaded.run.time_s, []
    for quantity, norms in error_norms(compared):
        scale, unit = _unit_of(norms, quantity.unit, time_s)
        label = f"{quantity.title}, {'norm' if unit == '1' else unit}"
        charts.append(Chart(label, time_s, scale * norms, is_error=True))
    return ChartGroup("norms of the errors", tuple(charts))


def _quantity(loaded: LoadedRun, name: str, block: Block) -> ChartGroup:
    """The errors of an estimated quantity where they are known, else its values."""
    to_shown = 180.0 / np.pi if block.unit.startswith("rad") else 1.0
    time_s, sd = loaded.run.time_s, to_shown * loaded.trajectory.sd_of(block)
    error, unit, title = loaded.error(block), block.shown_unit, name
    if error is not None:
        values = to_shown * error
        scale, unit = _unit_of(values, unit, time_s)
        values, sd, centre = scale * values, scale * sd, np.zeros_like(values)
        title += {POSITION: ", hill axes", ATTITUDE: ", body axes"}.get(block, "")
        if block is POSITION and not loaded.has(POSITION):
            title = f"{name}, camera axes"
    elif block is ATTITUDE:
        # An attitude has no value per axis; its three standard deviations do.
        values, sd, title = 3.0 * sd, np.full_like(sd, np.nan), f"{title}, 3 sigma"
        centre = values
    else:
        values = centre = to_shown * loaded.trajectory[block]
        title += {POSITION: ", hill axes"}.get(block, "")
    charts = []
    for k, component in enumerate(block.components):
        of_what = f"{component} / Ixx" if block is RATIOS else component
        words = [of_what, "error"] if error is not None else [of_what]
        suffix = "" if unit == "1" else f", {unit}"
        low = high = None
        if np.isfinite(sd[:, k]).any():
            low, high = centre[:, k] - 3.0 * sd[:, k], centre[:, k] + 3.0 * sd[:, k]
        linear = None if error is None or high is None else linear_range(time_s, high)
        charts.append(
            Chart(
                " ".join(words) + suffix,
                time_s,
                values[:, k],
                low,
                high,
                is_error=error is not None,
                linear_to=linear,
                known=_known(loaded, block, k),
                estimated=loaded.run.has_estimate,
            )
        )
    return ChartGroup(title, tuple(charts), _remark(loaded, block))


def _known(loaded: LoadedRun, block: Block, k: int) -> BoolArray | None:
    """(n,) where a component of the inertia is known from data; None where nothing tells."""
    verdict = loaded.verdicts.get(block.columns[k])
    if block is not RATIOS or verdict is None:
        return None
    sd = loaded.trajectory.sd_of(block)[:, k]
    return np.asarray((sd <= _KNOWN_FROM * verdict.prior_sd) & verdict.from_data)


def _remark(loaded: LoadedRun, block: Block) -> str:
    if block is not RATIOS or not loaded.verdicts:
        return ""
    told = [
        (component, loaded.verdicts[column].from_data)
        for component, column in zip(block.components, block.columns, strict=True)
        if column in loaded.verdicts
    ]
    known = ", ".join(name for name, from_data in told if from_data)
    prior = ", ".join(name for name, from_data in told if not from_data)
    return f"known from data: {known or 'none'}; prior only: {prior or 'none'}"


def _consistency(loaded: LoadedRun) -> ChartGroup:
    run, charts = loaded.run, []
    ratio = nis_over_bound(loaded)
    if np.isfinite(ratio).any():
        charts.append(_nis_chart(run.time_s, ratio))
    inliers = run.notes.get("inlier_ratio", np.full(len(run), np.nan))
    if np.isfinite(inliers).any():
        charts.append(Chart("inlier ratio, %", run.time_s, 100.0 * inliers))
    for column, what in _USED.items():
        if column in run.notes:
            told = run.notes[column]
            counts = np.isfinite(told).astype(np.float64) if column == _MEASURED else told
            charts.append(Chart(f"{what} used, count", run.time_s, counts))
    return ChartGroup("consistency", tuple(charts))


def _nis_chart(time_s: FloatArray, ratio: FloatArray) -> Chart:
    """A dot a frame; of a long run what 5, 50 and 95 % of the frames of a span stay below.

    Extremes of spans would put many times as many dots above the bound as there are frames.
    """
    linear = 2.0 if np.nanmax(ratio) > _DECADES_FROM else None
    if len(ratio) <= _MAX_DOTS:
        name = "NIS / its 95 % bound"
        return Chart(name, time_s, ratio, is_dots=True, linear_to=linear, bound=1.0)
    size = -(-len(ratio) // (_MAX_DOTS // 8))
    padded = np.full(-(-len(ratio) // size) * size, np.nan)
    padded[: len(ratio)] = ratio
    spans = padded.reshape(-1, size)
    some = np.isfinite(spans).any(axis=1)
    levels = np.full((3, len(spans)), np.nan)
    levels[:, some] = np.nanquantile(spans[some], (0.05, 0.5, 0.95), axis=1)
    low, middle, high = levels
    ends = np.minimum(np.arange(1, len(spans) + 1) * size, len(time_s)) - 1
    middles_s = 0.5 * (time_s[::size] + time_s[ends])
    name = f"NIS / its 95 % bound: median, 5 to 95 % of {size} frames"
    return Chart(name, middles_s, middle, low, high, linear_to=linear, bound=1.0)


def differences(runs: tuple[LoadedRun, ...], name: str) -> ChartGroup:
    """Of a quantity that both runs estimate: the second run's value minus the first's."""
    block, (first, second) = _GROUPS[name], runs
    nearest = [second.nearest_frame(float(t)) for t in first.run.time_s]
    at = np.array([-1 if k is None else k for k in nearest], dtype=np.intp)
    both = (at >= 0) & first.run.has_estimate
    both[both] &= second.run.has_estimate[at[both]]
    values = np.full((len(first), block.size), np.nan)
    a, b = first.trajectory[block][both], second.trajectory[block][at[both]]
    to_shown = 180.0 / np.pi if block.unit.startswith("rad") else 1.0
    turned = block is ATTITUDE
    values[both] = to_shown * (log_rotation(np.swapaxes(a, -1, -2) @ b) if turned else b - a)
    scale, unit = _unit_of(values, block.shown_unit, first.run.time_s)
    suffix = "" if unit == "1" else f", {unit}"
    charts = [
        Chart(f"{component} difference{suffix}", first.run.time_s, scale * values[:, k])
        for k, component in enumerate(block.components)
    ]
    return ChartGroup(f"{name}: {second.name} minus {first.name}", tuple(charts))


def difference_names(runs: tuple[LoadedRun, ...]) -> tuple[str, ...]:
    """The quantities that both runs estimate; none of a single run."""
    if len(runs) < 2:
        return ()
    return tuple(name for name, block in _GROUPS.items() if all(run.has(block) for run in runs))


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


def _unit_of(error: FloatArray, unit: str, time_s: FloatArray) -> tuple[float, str]:
    """Factor and unit to draw errors in, by those of the settled run."""
    settled = np.abs(error[time_s >= time_s[0] + 0.1 * np.ptp(time_s)])
    known = settled[np.isfinite(settled)]
    return display_unit(unit, float(np.median(known)) if known.size else 1.0)
