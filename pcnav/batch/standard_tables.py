"""Which tables a batch gets: those asked for, or the ones that every batch has."""

from collections.abc import Sequence
from dataclasses import dataclass

from pcnav.batch.case import ESTIMATOR_AXIS
from pcnav.batch.metrics import METRICS, Family, Metric, named_metrics, of_family
from pcnav.batch.pivot import AxisOrder, Layout
from pcnav.core.errors import InputError

DEFAULT_METRICS = ("position_sym_rms_m", "attitude_sym_rms_deg")
"""Of a pivot that names none, of figures and of comparisons."""
_SATELLITE = "satellite"
_RESOLUTION = "resolution_px"
STATISTICS = "statistics"
"""Key of the table with every metric of every case, for programs."""


@dataclass(frozen=True)
class Wanted:
    """A pivot as asked for on the command line; None where nothing was said."""

    rows: tuple[str, ...] | None = None
    columns: tuple[str, ...] | None = None
    metrics: tuple[str, ...] | None = None

    @property
    def anything(self) -> bool:
        """Whether a pivot was asked for."""
        return not (self.rows is None and self.columns is None and self.metrics is None)


STANDARD = Wanted()
"""Nothing in particular: the tables that every batch has."""


def asked_layout(wanted: Wanted, order: AxisOrder) -> Layout:
    """The table asked for. Raises `InputError` for an unknown axis or metric, or one given twice.

    Without rows: every axis on which cases differ and that is not a column. Without columns: the
    estimator, if it is not a row.
    """
    columns = wanted.columns
    if columns is None:
        columns = () if ESTIMATOR_AXIS in (wanted.rows or ()) else (ESTIMATOR_AXIS,)
        columns = tuple(axis for axis in columns if axis in order.values)
    order.check("--columns", columns)
    rows = wanted.rows
    if rows is None:
        rows = _scenario(order, but=columns)
    order.check("--rows", rows)
    both = set(rows) & set(columns)
    if both:
        raise InputError("--columns", min(both), "expected an axis that is not among the rows")
    metrics = named_metrics(DEFAULT_METRICS if wanted.metrics is None else wanted.metrics)
    return Layout("pivot", "As asked for", rows, columns, metrics)


def default_layouts(order: AxisOrder) -> tuple[Layout, ...]:
    """The tables that every batch has; the cost is apart, because no two machines agree on it."""
    scenario = _scenario(order, but=(ESTIMATOR_AXIS,))
    who = tuple(axis for axis in (_SATELLITE, ESTIMATOR_AXIS) if axis in order.values)
    cases = (*scenario, ESTIMATOR_AXIS) if ESTIMATOR_AXIS in order.values else scenario
    summary = (
        *("position_sym_median_m", "position_sym_p95_m"),
        *("attitude_sym_median_deg", "attitude_sym_p95_deg"),
        *("locked_right_pct", "locked_wrong_pct", "pose_pct"),
    )
    model = ("add_rms_m", "add_s_rms_m", "ate_rmse_m", "rpe_translation_rmse_m")
    states = ("velocity_rms_m_s", "rate_rms_deg_s", "com_rms_m", "inertia_ratio_rms")
    shown = tuple(axis for axis in (_SATELLITE, _RESOLUTION) if axis in order.varying)
    layouts = (
        ("summary", "Summary, cases pooled", who, (), named_metrics(summary), True),
        _errors(order, scenario),
        (
            "model",
            "Distances of the model's points, and of the trajectory",
            cases,
            (),
            named_metrics((*model, "rpe_rotation_rmse_deg")),
        ),
        ("states", "Errors of the other states", cases, (), named_metrics(states)),
        ("locking", "Locking", cases, (), of_family(Family.LOCKING)),
        ("consistency", "Consistency", cases, (), of_family(Family.CONSISTENCY)),
        ("bound", "RMS error over the posterior Cramer-Rao bound", cases, (), _bound()),
        ("cost", "Cost", (*shown, ESTIMATOR_AXIS), (), of_family(Family.COST)),
    )
    return tuple(Layout(*layout) for layout in layouts)


def statistics_layout(order: AxisOrder) -> Layout:
    """Every metric of every case but the cost."""
    metrics = tuple(m for m in METRICS.values() if m.quantity.family is not Family.COST)
    return Layout(STATISTICS, "Every metric of every case", tuple(order.values), (), metrics)


def _errors(
    order: AxisOrder, scenario: tuple[str, ...]
) -> tuple[str, str, tuple[str, ...], tuple[str, ...], tuple[Metric, ...]]:
    columns = (ESTIMATOR_AXIS,) if ESTIMATOR_AXIS in order.values else ()
    return "errors", "Errors of the pose", scenario, columns, named_metrics(DEFAULT_METRICS)


def _bound() -> tuple[Metric, ...]:
    return of_family(Family.BOUND)


def _scenario(order: AxisOrder, but: Sequence[str]) -> tuple[str, ...]:
    """The axes on which cases differ, or the first one where they differ in none."""
    axes = tuple(axis for axis in order.varying if axis not in but)
    return axes or tuple(axis for axis in order.values if axis not in but)[:1]
