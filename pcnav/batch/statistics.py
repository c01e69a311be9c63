"""The numbers of one cell of a table: statistics over its runs, with their confidence."""

from collections.abc import Iterable, Sequence
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
from pcnav.batch.samples import CellSamples, SampleOf, Window, collect
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.evaluation.metrics import chi_square_bounds


@dataclass(frozen=True)
class Bounds:
    """Where a mean squared normalised error per degree of freedom has to lie."""

    lower: float
    upper: float
    """95 % of what is seen if the stated covariances are right."""


@dataclass(frozen=True)
class Estimate:
    """One number over the runs of a cell."""

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


MISSING = Estimate(np.nan, np.nan, np.nan, 0, 0)


@dataclass(frozen=True)
class CellStatistics:
    """All that is known of one cell."""

    runs: int
    """Asked for, failed ones included."""
    failed: int
    estimates: dict[str, Estimate]
    """By the name of the metric."""


def cell_statistics(
    records: Iterable[RunRecord], metrics: Sequence[Metric], window: Window
) -> CellStatistics:
    """Statistics over the runs of one cell, whose records are read one after the other."""
    samples = collect(records, quantities_of(metrics), window)
    return CellStatistics(
        runs=len(samples.runs) + len(samples.failed),
        failed=len(samples.failed),
        estimates=estimates_of(samples, metrics),
    )


def quantities_of(metrics: Sequence[Metric]) -> dict[str, SampleOf]:
    """What has to be collected for some metrics."""
    return {metric.quantity.name: metric.quantity.sample_of for metric in metrics}


def estimates_of(samples: CellSamples, metrics: Sequence[Metric]) -> dict[str, Estimate]:
    """Estimates by the name of the metric; those of one quantity are taken together."""
    found: dict[str, Estimate] = {}
    counts = draws(samples.strata)
    for name in dict.fromkeys(metric.quantity.name for metric in metrics):
        same = [metric for metric in metrics if metric.quantity.name == name]
        pool = Pool.of(samples.samples[name])
        spread = Spread.of(pool, samples.strata)
        seen = replicates_of(pool, once(pool.runs), same)[0]
        drawn = replicates_of(pool, counts, same)
        for k, metric in enumerate(same):
            found[metric.name] = _estimate(metric, pool, spread, float(seen[k]), drawn[:, k])
    return {metric.name: found[metric.name] for metric in metrics}


def replicates_of(pool: Pool, counts: IntArray, metrics: Sequence[Metric]) -> FloatArray:
    """(b, m) metrics of one quantity, for draws (b, runs)."""
    found = np.full((len(counts), len(metrics)), np.nan)
    ranked = [k for k, metric in enumerate(metrics) if metric.statistic.percent is not None]
    if ranked:
        percent = [float(metrics[k].statistic.percent or 0) for k in ranked]
        found[:, ranked] = percentiles(pool, counts, percent)
    for k, metric in enumerate(metrics):
        if metric.statistic in _STATISTICS:
            found[:, k] = _STATISTICS[metric.statistic](pool, counts)
    return found


_STATISTICS = {
    Statistic.RMS: root_mean_square,
    Statistic.MEAN: mean,
    Statistic.MAX: maximum,
}


def _estimate(
    metric: Metric, pool: Pool, spread: Spread, seen: float, drawn: FloatArray
) -> Estimate:
    if not np.isfinite(seen):
        return MISSING
    low, high = (np.nan, np.nan)
    if metric.statistic is not Statistic.MAX:
        low, high = interval(seen, drawn, spread, metric.differs_by_factors)
        # Nothing here is negative, and no share is more than all.
        low, high = max(low, 0.0), min(high, 100.0 if metric.unit == "%" else np.inf)
    bounds = consistency_bounds(metric, pool, spread) if metric.is_consistency else None
    return Estimate(seen, low, high, spread.runs, len(pool.values), bounds)


def consistency_bounds(metric: Metric, pool: Pool, spread: Spread) -> Bounds:
    """95 % chi-square bounds of a mean squared normalised error per degree of freedom.

    The errors of one run's frames hang together: however many there are, a run may tell no more
    than one of them. The bounds of the NEES are those of as many independent frames as there are
    runs, which hold whatever the correlation and are wider than need be without it. Innovations of
    a consistent filter are white: each frame counts for the NIS.
    """
    if metric.degrees_per_run is None:
        degrees = float(pool.weights.sum())
    else:
        degrees = float(metric.degrees_per_run * spread.runs)
    lower, upper = chi_square_bounds(np.array(degrees))
    return Bounds(float(lower) / degrees, float(upper) / degrees)
