"""Every number that a table may show: its name on the command line, title, unit and meaning.

A metric is a statistic of a quantity: the quantity says which numbers of a run it is about, the
statistic what is made of those of many runs.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from pcnav.batch.samples import (
    SampleOf,
    column,
    columns_ratio,
    per_cent_known,
    per_cent_without,
    per_degree,
    value,
)
from pcnav.core.errors import InputError
from pcnav.evaluation.metrics import BLOCKS, PERCENTILES


class Family(StrEnum):
    """What a metric is about: one default table each."""

    ERRORS = "errors"
    CONSISTENCY = "consistency"
    BOUND = "bound"
    LOCKING = "locking"
    COST = "cost"


class Better(StrEnum):
    """Which way a metric improves."""

    LOWER = "lower"
    HIGHER = "higher"
    NEAR_ONE = "near one"


class Statistic(StrEnum):
    """What is made of the numbers of many runs."""

    RMS = "rms"
    MEAN = "mean"
    MEDIAN = "median"
    P70 = "p70"
    P90 = "p90"
    P95 = "p95"
    P99 = "p99"
    MAX = "max"

    @property
    def percent(self) -> int | None:
        """The percentile that it is, if it is one."""
        return _PERCENT.get(self)

    @property
    def words(self) -> str:
        """As in a title; empty for a plain mean, which needs none."""
        percent = self.percent
        if self is Statistic.MEDIAN or percent is None:
            return _TITLES[self]
        return f"{percent} %"


_PERCENT = {
    Statistic.MEDIAN: 50,
    Statistic.P70: 70,
    Statistic.P90: 90,
    Statistic.P95: 95,
    Statistic.P99: 99,
}
_TITLES = {
    Statistic.RMS: "RMS",
    Statistic.MEAN: "",
    Statistic.MEDIAN: "median",
    Statistic.MAX: "maximum",
}
if tuple(_PERCENT.values()) != PERCENTILES:
    raise RuntimeError("the percentiles of tables are those of a single run's metrics")


@dataclass(frozen=True)
class Quantity:
    """The numbers of a run that metrics are statistics of."""

    name: str
    title: str
    unit: str
    """m, m/s, deg, deg/s, s, ms, MB, %, or 1 for a ratio or a count."""
    family: Family
    sample_of: SampleOf
    better: Better = Better.LOWER


@dataclass(frozen=True)
class Metric:
    """One number of a table."""

    name: str
    """As typed on the command line and as it heads a CSV column; its unit ends it."""
    quantity: Quantity
    statistic: Statistic
    degrees_per_run: int | None = None
    """Of a mean squared normalised error: degrees of freedom of one frame, where the frames of one
    run are correlated; None where each frame stands for itself."""

    @property
    def title(self) -> str:
        """Quantity and statistic, without the unit."""
        statistic = self.statistic.words
        return f"{self.quantity.title}, {statistic}" if statistic else self.quantity.title

    @property
    def unit(self) -> str:
        """As of the quantity."""
        return self.quantity.unit

    @property
    def is_consistency(self) -> bool:
        """Whether it is judged against chi-square bounds."""
        return self.quantity.family is Family.CONSISTENCY

    @property
    def differs_by_factors(self) -> bool:
        """Errors and times do, from run to run and from batch to batch; shares and counts differ
        by so much more or less."""
        return self.quantity.family is not Family.LOCKING


_SUFFIX = {
    "m": "_m",
    "m/s": "_m_s",
    "deg": "_deg",
    "deg/s": "_deg_s",
    "s": "_s",
    "ms": "_ms",
    "MB": "_mb",
    "%": "_pct",
    "1": "",
}
_OF_ERRORS = (
    Statistic.RMS,
    Statistic.MEDIAN,
    Statistic.P70,
    Statistic.P90,
    Statistic.P95,
    Statistic.P99,
    Statistic.MAX,
)
_ERRORS = tuple(
    Quantity(name, title, unit, Family.ERRORS, column(source))
    for name, title, unit, source in (
        ("position", "position", "m", "position_error_m"),
        ("attitude", "attitude", "deg", "attitude_error_deg"),
        ("position_sym", "position up to symmetry", "m", "position_sym_error_m"),
        ("attitude_sym", "attitude up to symmetry", "deg", "attitude_sym_error_deg"),
        ("add", "ADD", "m", "add_m"),
        ("add_s", "ADD-S", "m", "add_s_m"),
        ("velocity", "velocity", "m/s", "velocity_error_m_s"),
        ("rate", "rate", "deg/s", "rate_error_deg_s"),
        ("com", "mass centre", "m", "com_error_m"),
        ("inertia_ratio", "inertia ratios", "1", "inertia_ratio_error"),
    )
)
_TRAJECTORY = (
    ("ate_rmse_m", "absolute trajectory error", "m", "ate_rmse_m"),
    ("rpe_translation_rmse_m", "relative translation error", "m", "rpe_translation_rmse_m"),
    ("rpe_rotation_rmse_deg", "relative rotation error", "deg", "rpe_rotation_rmse_deg"),
)
_BLOCK_TITLES = {
    "r_hill": "NEES of position",
    "v_hill": "NEES of velocity",
    "com_model": "NEES of mass centre",
    "theta_body": "NEES of attitude",
    "omega_body": "NEES of rate",
    "inertia_ratios": "NEES of inertia ratios",
    "all": "NEES of all states",
}
_BOUNDED = (
    ("position_over_crb", "position over bound", "position_sym_error_m", "crb_position_m"),
    ("attitude_over_crb", "attitude over bound", "attitude_sym_error_deg", "crb_attitude_deg"),
    ("rate_over_crb", "rate over bound", "rate_error_deg_s", "crb_rate_deg_s"),
    ("com_over_crb", "mass centre over bound", "com_error_m", "crb_com_m"),
    (
        "inertia_ratio_over_crb",
        "inertia ratios over bound",
        "inertia_ratio_error",
        "crb_inertia_ratio",
    ),
)


def _all_metrics() -> tuple[Metric, ...]:
    metrics = [
        Metric(f"{quantity.name}_{statistic}{_SUFFIX[quantity.unit]}", quantity, statistic)
        for quantity in _ERRORS
        for statistic in _OF_ERRORS
    ]
    for name, title, unit, source in _TRAJECTORY:
        quantity = Quantity(name, title, unit, Family.ERRORS, value(source))
        metrics.append(Metric(name, quantity, Statistic.RMS))
    for block, part in BLOCKS.items():
        name, size = f"nees_{block}", part.stop - part.start
        metrics.append(_consistency(name, _BLOCK_TITLES[block], per_degree(name, size), size))
    metrics.append(_consistency("nis", "NIS", per_degree("nis", "nis_dof"), None))
    for name, title, source, bound in _BOUNDED:
        ratio = columns_ratio(source, bound)
        quantity = Quantity(name, title, "1", Family.BOUND, ratio, Better.NEAR_ONE)
        metrics.append(Metric(name, quantity, Statistic.RMS))
    return (*metrics, *_locking(), *_cost())


def _consistency(name: str, title: str, sample_of: SampleOf, size: int | None) -> Metric:
    quantity = Quantity(name, title, "1", Family.CONSISTENCY, sample_of, Better.NEAR_ONE)
    return Metric(name, quantity, Statistic.MEAN, size)


def _locking() -> list[Metric]:
    rows = (
        ("time_to_lock", "time to lock", "s", value("time_to_lock_s"), Statistic.MEDIAN),
        ("never_locked", "runs never locked", "%", per_cent_without("time_to_lock_s"), None),
        ("locked_right", "frames locked right", "%", value("share_locked_right", 100.0), None),
        ("locked_wrong", "frames locked wrong", "%", value("share_locked_wrong", 100.0), None),
        ("unlocked", "frames not locked", "%", value("share_unlocked", 100.0), None),
        ("frames_lost", "frames lost after the lock, a run", "1", value("frames_lost"), None),
        ("pose", "frames with a pose", "%", per_cent_known("position_error_m"), None),
    )
    higher = {"locked_right", "pose"}
    return [
        Metric(
            name + _SUFFIX[unit],
            Quantity(
                name,
                title,
                unit,
                Family.LOCKING,
                sample_of,
                Better.HIGHER if name in higher else Better.LOWER,
            ),
            statistic or Statistic.MEAN,
        )
        for name, title, unit, sample_of, statistic in rows
    ]


def _cost() -> list[Metric]:
    per_frame = Quantity("frame", "time of a frame", "ms", Family.COST, column("frame_ms"))
    of_frames = [
        Metric(f"frame_{statistic}_ms", per_frame, statistic)
        for statistic in (Statistic.MEDIAN, Statistic.P95, Statistic.P99, Statistic.MAX)
    ]
    mean_ms = value("ms_per_frame")
    per_run = Quantity("ms_per_frame", "mean time of a frame", "ms", Family.COST, mean_ms)
    memory = Quantity("peak_memory", "peak memory", "MB", Family.COST, value("peak_memory_mb"))
    return [
        Metric("ms_per_frame", per_run, Statistic.MEAN),
        *of_frames,
        Metric("peak_memory_mb", memory, Statistic.MAX),
    ]


METRICS = {metric.name: metric for metric in _all_metrics()}
"""Every metric by its name."""


def named_metrics(names: Sequence[str]) -> tuple[Metric, ...]:
    """The metrics of these names. Raises `InputError`, which tells all, for an unknown one."""
    for name in names:
        if name not in METRICS:
            raise InputError("--metrics", name, f"expected some of: {_all_names()}")
    if not names or len(set(names)) < len(names):
        raise InputError("--metrics", ",".join(names), "expected one or more, each once")
    return tuple(METRICS[name] for name in names)


def _all_names() -> str:
    """Every name; those that differ in their statistic alone are told together."""
    together = [f"{quantity.name}_STAT{_SUFFIX[quantity.unit]}" for quantity in _ERRORS]
    told = {metric.name for metric in METRICS.values() if metric.quantity in _ERRORS}
    others = [name for name in METRICS if name not in told]
    return f"{', '.join([*together, *others])}; STAT is one of {', '.join(_OF_ERRORS)}"


def of_family(family: Family) -> tuple[Metric, ...]:
    """The metrics of one family."""
    return tuple(metric for metric in METRICS.values() if metric.quantity.family is family)
