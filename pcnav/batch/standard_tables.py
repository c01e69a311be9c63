"""Which tables a batch gets: those asked for, or the ones that every batch has."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import pandas as pd

from pcnav.batch.axes import ESTIMATOR_AXIS, RECORDING_AXIS, RESOLUTION_AXIS, SATELLITE_AXIS
from pcnav.batch.metrics import METRICS, Family, Metric, named_metrics, of_family
from pcnav.batch.tables import TableLayout, axes_of, varying_axes
from pcnav.core.errors import InputError

Measured = Collection[str]
"""Columns that the records of a batch have."""
PIVOT = "pivot"
"""Key of the table that was asked for."""
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


def position_of(measured: Measured) -> str:
    """The quantity that says how far off a position is: of the pose, or without poses of the mass
    centre."""
    has_poses = "position_error_m" in measured or "r_hill_error_m" not in measured
    return "position_sym" if has_poses else "r_hill"


def default_metrics(measured: Measured) -> tuple[Metric, ...]:
    """Of a pivot that names none, and of figures."""
    return named_metrics((f"{position_of(measured)}_rms_m", "attitude_sym_rms_deg"))


def asked_layout(wanted: Wanted, runs: pd.DataFrame, measured: Measured = ()) -> TableLayout:
    """The table asked for. Raises `InputError` for an unknown axis or metric, or one given twice.

    Without rows: every axis on which cases differ and that is not a column. Without columns: the
    estimator, if it is not a row.
    """
    columns = wanted.columns
    if columns is None:
        columns = () if ESTIMATOR_AXIS in (wanted.rows or ()) else _estimator(runs)
    _check_axes("--columns", columns, runs)
    rows = _scenario(runs, but=columns) if wanted.rows is None else wanted.rows
    _check_axes("--rows", rows, runs)
    both = set(rows) & set(columns)
    if both:
        raise InputError("--columns", min(both), "expected an axis that is not among the rows")
    default = default_metrics(measured)
    metrics = default if wanted.metrics is None else named_metrics(wanted.metrics)
    return TableLayout(PIVOT, "As asked for", rows, columns, metrics)


def default_layouts(runs: pd.DataFrame, measured: Measured = ()) -> tuple[TableLayout, ...]:
    """The tables that every batch has; the cost is apart, because no two machines agree on it."""
    if RECORDING_AXIS in runs:
        return _of_recordings(runs, measured)
    scenario, estimator = _scenario(runs, but=(ESTIMATOR_AXIS,)), _estimator(runs)
    position = position_of(measured)
    cases, satellite = (*scenario, *estimator), tuple({SATELLITE_AXIS} & set(axes_of(runs)))
    shown = tuple(axis for axis in (SATELLITE_AXIS, RESOLUTION_AXIS) if axis in varying_axes(runs))
    summary = (
        *(f"{position}_median_m", f"{position}_p95_m"),
        *("attitude_sym_median_deg", "attitude_sym_p95_deg"),
        *("locked_right_pct", "locked_wrong_pct", "pose_pct"),
    )
    trajectory = ("ate_rmse_m", "rpe_translation_rmse_m", "rpe_rotation_rmse_deg")
    model = ("add_rms_m", "add_s_rms_m", *trajectory)
    states = ("velocity_rms_m_s", "rate_rms_deg_s", "com_rms_m", "inertia_ratio_rms")
    layouts = (
        ("summary", "Summary, cases pooled", (*satellite, *estimator), named_metrics(summary)),
        ("errors", "Errors of the pose", scenario, default_metrics(measured)),
        (
            "model",
            "Distances of the model's points, and of the trajectory",
            cases,
            named_metrics(model),
        ),
        ("states", "Errors of the other states", cases, named_metrics(states)),
        ("locking", "Locking", cases, of_family(Family.LOCKING)),
        ("consistency", "Consistency", cases, of_family(Family.CONSISTENCY)),
        (
            "bound",
            "RMS error over the least that the comparison of frames allows",
            cases,
            of_family(Family.BOUND),
        ),
        ("cost", "Cost", (*shown, *estimator), of_family(Family.COST)),
    )
    return tuple(
        TableLayout(
            *(key, title, rows, estimator if key == "errors" else (), metrics),
            shared=key == "summary",
        )
        for key, title, rows, metrics in layouts
    )


def _of_recordings(runs: pd.DataFrame, measured: Measured) -> tuple[TableLayout, ...]:
    """Recording by recording, and pooled; what needs a truth where there is any."""
    estimator = _estimator(runs)
    rows = (*_scenario(runs, but=(ESTIMATOR_AXIS,)), *estimator)
    position = position_of(measured)
    found = (
        *("with_pose_pct", "status_locked_pct", "status_ambiguous_pct", "status_coasting_pct"),
        *("time_to_lock_s", "explained_median_pct", "nis"),
    )
    errors = (
        *(f"{position}_median_m", f"{position}_p95_m"),
        *("attitude_sym_median_deg", "attitude_sym_p95_deg", "locked_right_pct"),
        "locked_wrong_pct",
    )
    bop = (
        *("add_median_m", "add_s_median_m", "mssd_median_m", "mspd_median_px"),
        *("recall_mssd_pct", "recall_mspd_pct"),
    )
    trajectory = ("ate_rmse_m", "rpe_translation_rmse_m", "rpe_rotation_rmse_deg")
    parts = [
        ("found", "What was found", rows, found),
        ("found_pooled", "What was found, recordings pooled", estimator, found),
        ("errors", "Errors, against the recordings' truth", rows, errors),
        ("errors_pooled", "Errors, recordings pooled", estimator, errors),
        ("bop", "Errors and recalls of the BOP challenge", rows, bop),
        ("bop_pooled", "Errors and recalls of BOP, recordings pooled", estimator, bop),
        ("trajectory", "Errors of the trajectory", rows, trajectory),
    ]
    has_truth = "attitude_error_deg" in measured
    kept = [each for each in parts if has_truth or each[0].startswith("found")]
    layouts = [TableLayout(key, title, by, (), named_metrics(m)) for key, title, by, m in kept]
    cost = TableLayout("cost", "Cost", rows, (), of_family(Family.COST))
    return (*layouts, cost)


def statistics_layout(runs: pd.DataFrame) -> TableLayout:
    """Every metric of every case but the cost."""
    metrics = tuple(m for m in METRICS.values() if m.quantity.family is not Family.COST)
    return TableLayout(STATISTICS, "Every metric of every case", axes_of(runs), (), metrics)


def _estimator(runs: pd.DataFrame) -> tuple[str, ...]:
    return (ESTIMATOR_AXIS,) if ESTIMATOR_AXIS in runs else ()


def _scenario(runs: pd.DataFrame, but: Sequence[str]) -> tuple[str, ...]:
    """The axes on which cases differ, or the first one where they differ in none."""
    axes = tuple(axis for axis in varying_axes(runs) if axis not in but)
    return axes or tuple(axis for axis in axes_of(runs) if axis not in but)[:1]


def _check_axes(option: str, axes: Sequence[str], runs: pd.DataFrame) -> None:
    """Raises `InputError`, which lists the axes, for one that the batch does not have."""
    for axis in axes:
        if axis not in axes_of(runs):
            raise InputError(option, axis, f"expected some of: {', '.join(axes_of(runs))}")
    if len(set(axes)) < len(axes):
        raise InputError(option, ",".join(axes), "expected each axis once")
