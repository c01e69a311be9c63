"""The numbers of one cell of a table: statistics over its runs, with their confidence.

Frames of one run are not independent; runs are. So whole runs are drawn with replacement, within
their case where a cell holds several cases (a stratified cluster bootstrap), and the pooled
statistic is taken again. A draw is a number of times that each run counts: every statistic here
takes all draws at once, as an array of counts.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student_t

from pcnav.batch.axes import ESTIMATOR_AXIS, RECORDING_AXIS, GridCase
from pcnav.batch.metrics import EvaluationWindow, Metric, Sample, Statistic
from pcnav.batch.record import RunRecord
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.statistics import chi_square_bounds

DRAWS = 2000
CONFIDENCE = 0.95
_ENTRIES_AT_ONCE = 4_000_000
"""Bounds the memory of one block of draws to some 100 MB."""

_ROUNDING = 1e-9
"""Ends of an interval that differ by less than this share of them do not differ."""
_MAX_LOGARITHM = 100.0
"""Two runs say so little of their spread that the factor may be beyond any number."""


@dataclass(frozen=True)
class Pool:
    """The numbers of several runs, sorted, each with the run it is of."""

    values: FloatArray
    """(n,) rising."""
    weights: FloatArray
    """(n,)"""
    run: IntArray
    """(n,)"""
    runs: int

    @classmethod
    def of(cls, samples: Sequence[Sample]) -> "Pool":
        """Put the samples of runs together."""
        values = np.concatenate([sample.values for sample in samples] or [np.empty(0)])
        weights = np.concatenate([sample.weights for sample in samples] or [np.empty(0)])
        run = np.repeat(np.arange(len(samples)), [len(sample.values) for sample in samples])
        order = np.argsort(values, kind="stable")
        return cls(values[order], weights[order], run[order], len(samples))

    def sums(self, values: FloatArray) -> FloatArray:
        """(runs,) sum of values (n,) by run."""
        return np.bincount(self.run, values, self.runs).astype(np.float64)


def root_mean_square(pool: Pool, counts: IntArray) -> FloatArray:
    """(b,) of draws (b, runs); nan for a draw without numbers."""
    squares = counts @ pool.sums(pool.weights * pool.values**2)
    return np.sqrt(_over(squares, counts @ pool.sums(pool.weights)))


def mean(pool: Pool, counts: IntArray) -> FloatArray:
    """(b,) weighted mean of draws (b, runs); nan for a draw without numbers."""
    total = counts @ pool.sums(pool.weights * pool.values)
    return _over(total, counts @ pool.sums(pool.weights))


def maximum(pool: Pool, counts: IntArray) -> FloatArray:
    """(b,) largest number of draws (b, runs); nan for a draw without numbers."""
    largest = np.full(pool.runs, -np.inf)
    np.maximum.at(largest, pool.run, pool.values)
    found = np.where(counts > 0, largest, -np.inf).max(axis=1, initial=-np.inf)
    return np.where(np.isfinite(found), found, np.nan)


def percentiles(pool: Pool, counts: IntArray, percent: Sequence[float]) -> FloatArray:
    """(b, p) percentiles of draws (b, runs), by linear interpolation as in ``np.percentile``.

    nan for a draw without numbers.
    """
    found = np.full((len(counts), len(percent)), np.nan)
    if not len(pool.values):
        return found
    size = max(1, _ENTRIES_AT_ONCE // len(pool.values))
    for start in range(0, len(counts), size):
        block = slice(start, start + size)
        found[block] = _percentiles(pool, counts[block], np.asarray(percent))
    return found


def _percentiles(pool: Pool, counts: IntArray, percent: FloatArray) -> FloatArray:
    # Of each draw, up to which rank every value reaches when it is repeated as often as its run.
    reached = np.cumsum(counts[:, pool.run], axis=1)
    total = reached[:, -1]
    position = (total[:, None] - 1) * percent / 100.0
    below = np.floor(position)
    ranks = np.stack([below, np.minimum(below + 1.0, total[:, None] - 1.0)])
    # One search for all draws: each gets a range of ranks of its own.
    offset = (total.max() + 1) * np.arange(len(counts))[:, None]
    index = np.searchsorted((reached + offset).ravel(), ranks + offset, side="right")
    index -= len(pool.values) * np.arange(len(counts))[:, None]
    low, high = pool.values[np.clip(index, 0, len(pool.values) - 1)]
    return np.where(total[:, None] > 0, low + (position - below) * (high - low), np.nan)


def once(runs: int) -> IntArray:
    """(1, runs) the draw that is the sample itself."""
    return np.ones((1, runs), dtype=np.intp)


def draws(strata: Sequence[str], number: int = DRAWS, seed: int = 0) -> IntArray:
    """(number, runs) how often each run counts when as many are drawn of every stratum anew.

    The same for the same strata, whatever else is drawn before.
    """
    generator = np.random.default_rng(seed)
    counts = np.zeros((number, len(strata)), dtype=np.intp)
    labels = np.asarray(strata)
    # In the order in which they appear: a set has none.
    for stratum in dict.fromkeys(strata):
        members = np.flatnonzero(labels == stratum)
        share = np.full(len(members), 1.0 / len(members))
        counts[:, members] = generator.multinomial(len(members), share, number)
    return counts


@dataclass(frozen=True)
class Spread:
    """How many runs a statistic stands on, for the width of what is said about it."""

    runs: int
    strata: int

    @classmethod
    def of(cls, pool: Pool, strata: Sequence[str]) -> "Spread":
        """Counts the runs that have numbers, and their strata."""
        having = np.unique(pool.run)
        return cls(len(having), len({strata[run] for run in having}))

    @property
    def degrees(self) -> int:
        """Degrees of freedom of the variance between runs."""
        return self.runs - self.strata

    @property
    def inflation(self) -> float:
        """By which a deviation that was resampled is too small: the bootstrap divides by n."""
        return float(np.sqrt(self.runs / self.degrees))


def interval(
    seen: float,
    replicates: FloatArray,
    spread: Spread,
    by_factors: bool,
    confidence: float = CONFIDENCE,
) -> tuple[float, float]:
    """Interval of a statistic from its replicates (b,): Student's t with their deviation.

    ``by_factors``: of the logarithm, for what differs from run to run by factors, as errors do;
    else of the statistic itself. Percentiles of the replicates would end at the largest run: of
    five runs they cover the truth in four cases of five. In simulations of 3 to 30 runs these
    cover it in 90 to 96 % (tests/batch/test_statistics.py).

    nan with fewer than two runs, and where all runs agree: that five of five runs never failed
    does not show the share to be zero.
    """
    kept = replicates[np.isfinite(replicates)]
    if spread.degrees < 1 or not len(kept):
        return np.nan, np.nan
    width = float(student_t.ppf(0.5 * (1.0 + confidence), spread.degrees)) * spread.inflation
    if by_factors and seen > 0.0 and kept.min() > 0.0:
        ratio = float(np.exp(min(width * float(np.std(np.log(kept))), _MAX_LOGARITHM)))
        low, high = seen / ratio, seen * ratio
    else:
        shift = width * float(np.std(kept))
        low, high = seen - shift, seen + shift
    agree = high - low <= _ROUNDING * abs(seen)
    return (np.nan, np.nan) if agree else (low, high)


def _over(total: FloatArray, weight: FloatArray) -> FloatArray:
    found = np.full(len(total), np.nan)
    np.divide(total, weight, out=found, where=weight > 0.0)
    return found


@dataclass(frozen=True)
class Bounds:
    """Where a mean squared normalised error per degree of freedom has to lie."""

    lower: float
    upper: float
    """95 % of what is seen if the stated covariances are right."""


@dataclass(frozen=True)
class MetricValue:
    """One metric over the runs of a cell."""

    value: float
    """nan where no run has any."""
    low: float
    high: float
    """95 % confidence interval by resampling runs; nan with fewer than two, where all agree, and
    for a maximum, which no draw can exceed."""
    bounds: Bounds | None = None
    """Of a measure of consistency."""

    @property
    def exists(self) -> bool:
        """Whether there is a number."""
        return bool(np.isfinite(self.value))

    @property
    def verdict(self) -> str:
        """``pass``, ``fail: above`` (stated covariances too small) or ``fail: below``; empty."""
        if self.bounds is None or not self.exists:
            return ""
        if self.value > self.bounds.upper:
            return "fail: above"
        return "fail: below" if self.value < self.bounds.lower else "pass"


@dataclass(frozen=True)
class Cell:
    """All that is known of one cell."""

    runs: int
    """Asked for, failed ones included."""
    failed: int
    values: dict[str, MetricValue]
    """By the name of the metric."""


def cell_of(
    records: Iterable[RunRecord], metrics: Sequence[Metric], window: EvaluationWindow
) -> Cell:
    """Statistics over the runs of one cell, whose records are read one after the other."""
    samples: dict[str, list[Sample]] = {metric.quantity.name: [] for metric in metrics}
    strata, failed = [], 0
    for record in records:
        if record.failure is not None:
            failed += 1
            continue
        strata.append(_stratum(record.run.case))
        for name, sample in samples_of(record, metrics, window).items():
            samples[name].append(sample)
    return Cell(len(strata) + failed, failed, values_of(samples, strata, metrics))


def _stratum(case: GridCase) -> str:
    """What runs have in common that are drawn again together: recordings are drawn themselves."""
    axes = dict(case.settings)
    if RECORDING_AXIS not in axes:
        return case.name
    return str(axes.get(ESTIMATOR_AXIS, ""))


def samples_of(
    record: RunRecord, metrics: Sequence[Metric], window: EvaluationWindow
) -> dict[str, Sample]:
    """The numbers of a run that metrics are taken of, by quantity."""
    quantities = {metric.quantity.name: metric.quantity for metric in metrics}
    return {name: each.sample_of(record, window) for name, each in quantities.items()}


def values_of(
    samples: Mapping[str, Sequence[Sample]], strata: Sequence[str], metrics: Sequence[Metric]
) -> dict[str, MetricValue]:
    """Values by the name of the metric; those of one quantity are taken together.

    Args:
        samples: one a run by quantity.
        strata: the case of each run: runs are drawn again within their case.
        metrics: of these quantities.
    """
    found: dict[str, MetricValue] = {}
    counts = draws(strata)
    for name, of_runs in samples.items():
        same = [metric for metric in metrics if metric.quantity.name == name]
        pool = Pool.of(of_runs)
        spread = Spread.of(pool, strata)
        seen = replicates_of(pool, once(pool.runs), same)[0]
        drawn = replicates_of(pool, counts, same)
        for k, metric in enumerate(same):
            found[metric.name] = _value(metric, pool, spread, float(seen[k]), drawn[:, k])
    return {metric.name: found[metric.name] for metric in metrics}


def replicates_of(pool: Pool, counts: IntArray, metrics: Sequence[Metric]) -> FloatArray:
    """(b, m) metrics of one quantity, for draws (b, runs)."""
    percent = np.array([metric.statistic.percent or np.nan for metric in metrics])
    ranked = np.flatnonzero(np.isfinite(percent))
    found = np.full((len(counts), len(metrics)), np.nan)
    found[:, ranked] = percentiles(pool, counts, percent[ranked].tolist())
    for k, metric in enumerate(metrics):
        if metric.statistic in _STATISTICS:
            found[:, k] = _STATISTICS[metric.statistic](pool, counts)
    return found


_STATISTICS = {
    Statistic.RMS: root_mean_square,
    Statistic.MEAN: mean,
    Statistic.MAX: maximum,
}


def _value(
    metric: Metric, pool: Pool, spread: Spread, seen: float, drawn: FloatArray
) -> MetricValue:
    if not np.isfinite(seen):
        return MetricValue(np.nan, np.nan, np.nan)
    low, high = (np.nan, np.nan)
    if metric.statistic is not Statistic.MAX:
        low, high = interval(seen, drawn, spread, metric.differs_by_factors)
        # Nothing here is negative, and no share is more than all.
        low, high = max(low, 0.0), min(high, 100.0 if metric.unit == "%" else np.inf)
    bounds = consistency_bounds(metric, pool) if metric.is_consistency else None
    return MetricValue(seen, low, high, bounds)


def consistency_bounds(metric: Metric, pool: Pool) -> Bounds:
    """95 % chi-square bounds of a mean squared normalised error per degree of freedom.

    The errors of one run's frames are correlated: however many there are, a run may tell no more
    than one of them. The bounds of the NEES are those of as many independent frames as there are
    runs, which hold whatever the correlation and are wider than need be without it. Innovations of
    a consistent filter are white: each frame counts for the NIS.
    """
    degrees = float(pool.weights.sum())
    if metric.is_correlated:
        # Those of one frame of each run.
        frames = np.bincount(pool.run)
        per_frame = pool.sums(pool.weights)[: len(frames)] / np.maximum(frames, 1)
        degrees = float(per_frame.sum())
    lower, upper = chi_square_bounds(degrees)
    return Bounds(float(lower) / degrees, float(upper) / degrees)
