"""The numbers of one cell of a table: statistics over its runs, with their confidence."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.batch.metrics import Metric, Statistic
from pcnav.batch.record import RunRecord
from pcnav.batch.resampling import (
    Pool,
    Spread,
    draws,
    interval,
    maximum,
    mean,
    once,
    percentiles,
    root_mean_square,
)
from pcnav.batch.samples import EvaluationWindow, Sample
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.statistics import chi_square_bounds


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
    runs: int
    """That have numbers."""
    numbers: int
    """Of frames, or of runs where a run has one."""
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
        strata.append(record.run.case.name)
        for name, sample in samples_of(record, metrics, window).items():
            samples[name].append(sample)
    return Cell(len(strata) + failed, failed, values_of(samples, strata, metrics))


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
        return MetricValue(np.nan, np.nan, np.nan, 0, 0)
    low, high = (np.nan, np.nan)
    if metric.statistic is not Statistic.MAX:
        low, high = interval(seen, drawn, spread, metric.differs_by_factors)
        # Nothing here is negative, and no share is more than all.
        low, high = max(low, 0.0), min(high, 100.0 if metric.unit == "%" else np.inf)
    bounds = consistency_bounds(metric, pool) if metric.is_consistency else None
    return MetricValue(seen, low, high, spread.runs, len(pool.values), bounds)


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
