"""What changed from one batch to another in one number, and how sure that is.

Every run counts once, with its own value of the metric. Where the seeds are the same the frames are
too, and most of what differs from run to run cancels in the difference of the pair.

No bootstrap here: with the five runs of a case its intervals end at the largest of five values,
and they cannot be wide enough for hundreds of numbers judged at a time. Drawing pairs again would
give the mean the deviation that it has in closed form; Student's t goes on from there.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import t as student_t

from pcnav.batch.metrics import Better, Metric
from pcnav.batch.resampling import CONFIDENCE
from pcnav.core.arrays import FloatArray

_MIN_ERROR = 1e-12
"""Errors below this, in their unit, are as good as none: their ratio means nothing."""
_MIN_RATIO = 0.01
"""A change of an error by less is no regression and no progress, however sure it is."""
_ROUNDING = 1e-12

VERDICTS = ("worse", "better", "not sure", "same")


@dataclass(frozen=True)
class Change:
    """How one metric changed; the judgement depends on how many there are."""

    place: str
    """The case, or of which cases this is the mean."""
    metric: Metric
    old: float
    new: float
    """Mean over the runs compared of each run's own value, the geometric one of what `is_ratio`; of
    several cases the mean of theirs."""
    runs: int
    """Compared."""
    paired: bool
    worsening: float
    """By how much it got worse, negative where it got better: of an error the logarithm of the
    ratio, of a ratio that should be 1 the change of the size of its logarithm, else the
    difference in the metric's unit."""
    deviation: float
    """Standard deviation of `worsening`."""
    degrees: float
    """Of freedom that the deviation has."""
    low: float = np.nan
    high: float = np.nan
    """Interval of `worsening` once it is `judged`: those of all changes hold together at 95 %."""

    @property
    def is_ratio(self) -> bool:
        """Whether `worsening` is a logarithm."""
        return self.metric.differs_by_factors

    @property
    def can_err(self) -> bool:
        """Whether chance has a part in it: a number that no run changed cannot raise an alarm."""
        return self.worsening != 0.0 or self.deviation > 0.0

    @property
    def verdict(self) -> str:
        """``worse``, ``better``, ``same`` where nothing changed, or ``not sure``."""
        if not self.can_err:
            return "same"
        smallest = np.log1p(_MIN_RATIO) if self.is_ratio else 0.0
        if self.low > 0.0 and self.worsening >= smallest:
            return "worse"
        if self.high < 0.0 and -self.worsening >= smallest:
            return "better"
        return "not sure"


def judged(changes: Sequence[Change]) -> tuple[Change, ...]:
    """With intervals that all hold together with 95 % (Bonferroni): each at 5 % over their number.

    Where nothing at all differs between the batches no chance is involved: these do not count.
    """
    number = max(1, sum(change.can_err for change in changes))
    tail = 0.5 * (1.0 - CONFIDENCE) / number
    found = []
    for change in changes:
        width, middle = 0.0, change.worsening
        if change.deviation > 0.0:
            width = change.deviation * float(student_t.ppf(1.0 - tail, change.degrees))
        found.append(replace(change, low=middle - width, high=middle + width))
    return tuple(found)


def case_change(
    place: str, metric: Metric, old: FloatArray, new: FloatArray, paired: bool
) -> Change | None:
    """The change of one metric in one case; None where too few runs have a number.

    Args:
        place: the case.
        metric: what is compared.
        old: (n,) the metric of every run by itself; nan where it has no number.
        new: (m,) likewise, m = n and run by run the same truth and noise where ``paired``.
        paired: takes the mean and the deviation of what changed from one to the other, as in a
            paired t-test; else those of two samples, with Welch's degrees of freedom.
    """
    known = [np.isfinite(each) for each in (old, new)]
    if paired:
        known = [known[0] & known[1]] * 2
    values = [old[known[0]], new[known[1]]]
    if min(map(len, values)) < 2:
        return None
    sizes = [_badness(metric, each) for each in values]
    parts = [sizes[1] - sizes[0]] if paired else sizes
    variances = np.array([np.var(part, ddof=1) / len(part) for part in parts])
    degrees = np.array([len(part) - 1.0 for part in parts])
    deviation = float(np.sqrt(variances.sum()))
    worsening = float(np.mean(sizes[1]) - np.mean(sizes[0]))
    return Change(
        place,
        metric,
        old=_typical(metric, values[0]),
        new=_typical(metric, values[1]),
        runs=min(map(len, values)),
        paired=paired,
        worsening=worsening if abs(worsening) > _ROUNDING else 0.0,
        deviation=deviation if deviation > _ROUNDING else 0.0,
        degrees=_satterthwaite(variances, degrees),
    )


def mean_change(place: str, changes: Sequence[Change]) -> Change:
    """The mean of one metric's changes in several cases, each of which weighs the same.

    Runs of different cases are independent, so the variances add; their degrees of freedom by
    Satterthwaite's formula.
    """
    variances = np.array([change.deviation**2 for change in changes])
    degrees = np.array([change.degrees for change in changes])
    metric = changes[0].metric
    return Change(
        place,
        metric,
        old=_typical(metric, np.array([change.old for change in changes])),
        new=_typical(metric, np.array([change.new for change in changes])),
        runs=sum(change.runs for change in changes),
        paired=all(change.paired for change in changes),
        worsening=float(np.mean([change.worsening for change in changes])),
        deviation=float(np.sqrt(variances.sum())) / len(changes),
        degrees=_satterthwaite(variances, degrees),
    )


def _badness(metric: Metric, values: FloatArray) -> FloatArray:
    """How bad values (n,) are, on the scale on which they are compared."""
    if not metric.differs_by_factors:
        return -values if metric.quantity.better is Better.HIGHER else values
    logarithms = np.log(np.maximum(values, _MIN_ERROR))
    near_one = metric.quantity.better is Better.NEAR_ONE
    return np.asarray(np.abs(logarithms) if near_one else logarithms)


def _typical(metric: Metric, values: FloatArray) -> float:
    """Mean of values (n,): of what is compared by its ratio the geometric one."""
    if not metric.differs_by_factors:
        return float(np.mean(values))
    return float(np.exp(np.mean(np.log(np.maximum(values, _MIN_ERROR)))))


def _satterthwaite(variances: FloatArray, degrees: FloatArray) -> float:
    """Degrees of freedom of a sum of variances."""
    spread = float(np.sum(variances**2 / degrees))
    return float(variances.sum()) ** 2 / spread if spread > 0.0 else float(degrees.sum())
