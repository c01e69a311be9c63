"""Every number that a table may show: its name on the command line, title, unit and meaning.

A metric is a statistic of a quantity: the quantity says which numbers of a run it is about, the
statistic what is made of those of many runs.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from pcnav.batch.record import RunRecord
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.errors import InputError
from pcnav.evaluation.metrics import QUANTITIES, UNIT_SUFFIX
from pcnav.runs.status import Status


@dataclass(frozen=True)
class EvaluationWindow:
    """Which frames of a run the errors are taken over.

    A filter's beginning is another question than what it settles at: unless asked otherwise the
    first half of a run is left out.
    """

    from_s: float | None = None
    """From so long after the first frame on; None for the second half of each run."""

    def frames(self, time_s: FloatArray) -> BoolArray:
        """(n,) which frames belong to it."""
        if not len(time_s):
            return np.zeros(0, dtype=np.bool_)
        elapsed = time_s - time_s[0]
        return np.asarray(elapsed >= (0.5 * elapsed[-1] if self.from_s is None else self.from_s))

    @property
    def text(self) -> str:
        """In words, for a table's note."""
        if self.from_s is None:
            return "the second half of each run"
        if not self.from_s:
            return "whole runs"
        return f"the frames from {self.from_s:g} s after the first on"


SETTLED = EvaluationWindow()
"""The second half of each run."""


@dataclass(frozen=True)
class Sample:
    """Numbers of one run; without those that do not exist."""

    values: FloatArray
    """(k,)"""
    weights: FloatArray
    """(k,) in a mean."""

    @classmethod
    def known(cls, values: FloatArray, weights: FloatArray | None = None) -> "Sample":
        """Of values (n,), those that are not finite left out."""
        weights = np.ones(len(values)) if weights is None else weights
        finite = np.isfinite(values) & np.isfinite(weights)
        return cls(values[finite], weights[finite])


SampleOf = Callable[[RunRecord, EvaluationWindow], Sample]
"""Takes a quantity's numbers from a record; only these are kept of it."""


def column(name: str) -> SampleOf:
    """Values frame by frame within the window."""
    return lambda record, window: Sample.known(within(record, window, name))


def columns_ratio(name: str, other: str) -> SampleOf:
    """One column over another, frame by frame within the window."""

    def sample(record: RunRecord, window: EvaluationWindow) -> Sample:
        above, below = within(record, window, name), within(record, window, other)
        positive = below > 0.0
        return Sample.known(above[positive] / below[positive])

    return sample


def per_degree(name: str) -> SampleOf:
    """A squared normalised error over its degrees of freedom: those of the column ``name_dof``, or
    of all frames the value of that name.

    In a mean each frame weighs as many times as it has degrees of freedom.
    """
    degrees = f"{name}_dof"

    def sample(record: RunRecord, window: EvaluationWindow) -> Sample:
        squared = within(record, window, name)
        if degrees in record.columns:
            of_frame = within(record, window, degrees)
        else:
            of_frame = np.full(len(squared), record.values.get(degrees, np.nan))
        used = of_frame > 0.0
        return Sample.known(squared[used] / of_frame[used], of_frame[used])

    return sample


def per_cent(name: str) -> SampleOf:
    """A share frame by frame within the window, as per cent."""
    return lambda record, window: Sample.known(100.0 * within(record, window, name))


def per_cent_known(name: str) -> SampleOf:
    """100 for each frame within the window that has a value in the column, 0 for the others."""
    return lambda record, window: Sample.known(100.0 * np.isfinite(within(record, window, name)))


def value(name: str, scale: float = 1.0) -> SampleOf:
    """The one value that the whole run has."""
    return lambda record, _: Sample.known(np.array([scale * record.values.get(name, np.nan)]))


def per_cent_without(name: str) -> SampleOf:
    """100 for a run that has no such value, 0 for one that has."""
    return lambda record, _: Sample.known(
        np.array([0.0 if np.isfinite(record.values.get(name, np.nan)) else 100.0])
    )


def within(record: RunRecord, window: EvaluationWindow, name: str) -> FloatArray:
    """(k,) a column of a record in the frames of a window; nan where it has none of that name."""
    inside = window.frames(record.numbers("time_s"))
    return record.numbers(name)[inside]


class Family(StrEnum):
    """What a metric is about: one default table each."""

    ERRORS = "errors"
    CONSISTENCY = "consistency"
    BOUND = "bound"
    LOCKING = "locking"
    FOUND = "found"
    RECALL = "recall"
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
    def percent(self) -> float | None:
        """The percentile that it is, if it is one."""
        if self is Statistic.MEDIAN:
            return 50.0
        return float(self[1:]) if self.startswith("p") else None

    @property
    def words(self) -> str:
        """As in a title; empty for a plain mean, which needs none."""
        words = {Statistic.RMS: "RMS", Statistic.MEAN: "", Statistic.MAX: "maximum"}
        return words.get(self, f"{self[1:]} %" if self.startswith("p") else str(self))


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
    is_correlated: bool = False
    """Of a mean squared normalised error: whether the frames of one run are correlated; else each
    frame stands for itself."""

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
        return self.quantity.family not in (Family.LOCKING, Family.FOUND, Family.RECALL)


_SUFFIX = {**UNIT_SUFFIX, "s": "_s", "ms": "_ms", "MB": "_mb", "%": "_pct", "px": "_px"}
_OF_ERRORS = tuple(statistic for statistic in Statistic if statistic is not Statistic.MEAN)


def _error_quantities() -> Iterator[Quantity]:
    """Those of `QUANTITIES`, of the pose in two ways, and the distances of the model's points."""
    of_pose = [each for each in QUANTITIES if each.of_pose]
    for ending, title in (("", ""), ("_sym", " up to symmetry")):
        for each in of_pose:
            yield _error(f"{each.name}{ending}", each.short + title, each.unit)
    yield Quantity("add", "ADD", "m", Family.ERRORS, column("add_m"))
    yield Quantity("add_s", "ADD-S", "m", Family.ERRORS, column("add_s_m"))
    yield Quantity("mssd", "MSSD", "m", Family.ERRORS, column("mssd_m"))
    yield Quantity("mspd", "MSPD", "px", Family.ERRORS, column("mspd_px"))
    for each in QUANTITIES:
        if each.name and not each.of_pose:
            yield _error(each.name, each.short, each.unit)


def _error(name: str, title: str, unit: str) -> Quantity:
    return Quantity(name, title, unit, Family.ERRORS, column(f"{name}_error{_SUFFIX[unit]}"))


_ERRORS = tuple(_error_quantities())
_TRAJECTORY = (
    ("ate_rmse_m", "absolute trajectory error", "m"),
    ("rpe_translation_rmse_m", "relative translation error", "m"),
    ("rpe_rotation_rmse_deg", "relative rotation error", "deg"),
)
_BLOCK_TITLES = {
    "r_hill": "position",
    "v_hill": "velocity",
    "com_model": "mass centre",
    "theta_body": "attitude",
    "omega_body": "rate",
    "inertia_ratios": "inertia ratios",
    "all": "all states",
}
_BOUNDED = (
    ("position", "position", "position_sym_error_m", "crb_position_m"),
    ("attitude", "attitude", "attitude_sym_error_deg", "crb_attitude_deg"),
    ("rate", "rate", "rate_error_deg_s", "crb_rate_deg_s"),
    ("com", "mass centre", "com_error_m", "crb_com_m"),
    ("inertia_ratio", "inertia ratios", "inertia_ratio_error", "crb_inertia_ratio"),
)
_LOCKING = (
    ("never_locked", "runs never locked", "%", per_cent_without("time_to_lock_s"), Better.LOWER),
    ("locked_right", "frames locked right", "%", value("share_locked_right", 100), Better.HIGHER),
    ("locked_wrong", "frames locked wrong", "%", value("share_locked_wrong", 100), Better.LOWER),
    ("unlocked", "frames not locked", "%", value("share_unlocked", 100), Better.LOWER),
    ("frames_lost", "frames lost after the lock, a run", "1", value("frames_lost"), Better.LOWER),
    ("pose", "frames with a pose", "%", per_cent_known("attitude_error_deg"), Better.HIGHER),
)


def _all_metrics() -> Iterator[Metric]:
    for quantity in _ERRORS:
        for statistic in _OF_ERRORS:
            yield Metric(
                f"{quantity.name}_{statistic}{_SUFFIX[quantity.unit]}", quantity, statistic
            )
    for name, title, unit in _TRAJECTORY:
        yield Metric(name, Quantity(name, title, unit, Family.ERRORS, value(name)), Statistic.RMS)
    for block, title in _BLOCK_TITLES.items():
        yield _consistency(f"nees_{block}", f"NEES of {title}", is_correlated=True)
    yield _consistency("nis", "NIS", is_correlated=False)
    for name, title, source, bound in _BOUNDED:
        quantity = Quantity(
            f"{name}_over_crb",
            f"{title} over bound",
            "1",
            Family.BOUND,
            columns_ratio(source, bound),
            Better.NEAR_ONE,
        )
        yield Metric(quantity.name, quantity, Statistic.RMS)
    to_lock = Quantity("time_to_lock", "time to lock", "s", Family.LOCKING, value("time_to_lock_s"))
    yield Metric("time_to_lock_s", to_lock, Statistic.MEDIAN)
    for name, title, unit, sample_of, better in _LOCKING:
        quantity = Quantity(name, title, unit, Family.LOCKING, sample_of, better)
        yield Metric(name + _SUFFIX[unit], quantity, Statistic.MEAN)
    yield from _found()
    yield from _cost()


def _found() -> Iterator[Metric]:
    """What is said without any truth, and the recalls of BOP."""

    def mean_of(name: str, title: str, sample_of: SampleOf, family: Family) -> Metric:
        quantity = Quantity(name, title, "%", family, sample_of, Better.HIGHER)
        return Metric(f"{name}_pct", quantity, Statistic.MEAN)

    with_pose = per_cent("has_pose")
    yield mean_of("with_pose", "frames with a pose", with_pose, Family.FOUND)
    for word in map(str, Status):
        share = value(f"share_{word}", 100.0)
        yield mean_of(f"status_{word}", f"frames {word}", share, Family.FOUND)
    explained = Quantity(
        "explained", "explained share", "%", Family.FOUND, per_cent("inlier_ratio"), Better.HIGHER
    )
    for statistic in (Statistic.MEDIAN, Statistic.MEAN):
        yield Metric(f"explained_{statistic}_pct", explained, statistic)
    for name, title in (("mssd", "MSSD"), ("mspd", "MSPD")):
        sample_of = per_cent(f"recall_{name}")
        yield mean_of(f"recall_{name}", f"average recall of {title}", sample_of, Family.RECALL)


def _consistency(name: str, title: str, is_correlated: bool) -> Metric:
    quantity = Quantity(name, title, "1", Family.CONSISTENCY, per_degree(name), Better.NEAR_ONE)
    return Metric(name, quantity, Statistic.MEAN, is_correlated)


def _cost() -> Iterator[Metric]:
    mean_ms, peak_mb = value("ms_per_frame"), value("peak_memory_mb")
    per_run = Quantity("ms_per_frame", "mean time of a frame", "ms", Family.COST, mean_ms)
    yield Metric("ms_per_frame", per_run, Statistic.MEAN)
    per_frame = Quantity("frame", "time of a frame", "ms", Family.COST, column("frame_ms"))
    for statistic in (Statistic.MEDIAN, Statistic.P95, Statistic.P99, Statistic.MAX):
        yield Metric(f"frame_{statistic}_ms", per_frame, statistic)
    memory = Quantity("peak_memory", "peak memory", "MB", Family.COST, peak_mb)
    yield Metric("peak_memory_mb", memory, Statistic.MAX)


METRICS = {metric.name: metric for metric in _all_metrics()}
"""Every metric by its name."""


def named_metrics(names: Sequence[str]) -> tuple[Metric, ...]:
    """The metrics of these names. Raises `InputError`, which lists all, for an unknown one."""
    for name in names:
        if name not in METRICS:
            raise InputError("--metrics", name, f"expected some of: {_all_names()}")
    if not names or len(set(names)) < len(names):
        raise InputError("--metrics", ",".join(names), "expected one or more, each once")
    return tuple(METRICS[name] for name in names)


def _all_names() -> str:
    """Every name; those that differ in their statistic alone stand together."""
    together = [f"{quantity.name}_STAT{_SUFFIX[quantity.unit]}" for quantity in _ERRORS]
    others = [name for name, metric in METRICS.items() if metric.quantity not in _ERRORS]
    return f"{', '.join([*together, *others])}; STAT is one of {', '.join(_OF_ERRORS)}"


def of_family(family: Family) -> tuple[Metric, ...]:
    """The metrics of one family."""
    return tuple(metric for metric in METRICS.values() if metric.quantity.family is family)
