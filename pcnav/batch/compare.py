"""Two batches side by side: what got worse beyond chance, for a machine that has to decide.

Every run counts once, with its own value of the metric. Where the seeds are the same the frames are
too, and most of what differs from run to run cancels in the difference of the pair.

No bootstrap here: with the five runs of a case its intervals end at the largest of five values,
and they cannot be wide enough for hundreds of numbers judged at a time. Drawing pairs again would
give the mean the deviation that it has in closed form; Student's t goes on from there.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.stats import t as student_t

from pcnav.batch.axes import ESTIMATOR_AXIS, GridRun
from pcnav.batch.metrics import SETTLED, Better, EvaluationWindow, Metric, named_metrics
from pcnav.batch.record import RunRecord
from pcnav.batch.standard_tables import position_of
from pcnav.batch.statistics import CONFIDENCE, Pool, once, replicates_of, samples_of
from pcnav.batch.store import RunStore
from pcnav.batch.tables import metric_label
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.files.text_table import TextTable, display_unit, number

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


COMPARED = (
    "attitude_sym_rms_deg",
    "rate_rms_deg_s",
    "com_rms_m",
    "locked_right_pct",
    "locked_wrong_pct",
    "never_locked_pct",
    "pose_pct",
)
"""Unless other metrics are asked for, after the RMS error of the position."""
_SAME_RUN = ["case", "index", "seed"]
"""Columns of `run_values`: runs that agree in them met the same truth and noise."""
_HEADER = ("where", "metric", "old", "new", "worse by", "interval", "runs", "verdict")


@dataclass(frozen=True)
class Comparison:
    """All that two batches say of each other."""

    overall: tuple[Change, ...]
    """By estimator and metric, the mean over the cases."""
    cases: tuple[Change, ...]
    """Case by case."""
    newly_failed: tuple[GridRun, ...]
    """Runs with a result in the old batch and none in the new one."""
    repaired: int
    """Runs that failed in the old batch and have a result in the new one."""
    only_old: int
    only_new: int
    """Cases that the other batch does not have."""
    same_grid: bool
    """Whether both batches were made from the same grid, satellites and settings included."""

    @property
    def changes(self) -> tuple[Change, ...]:
        """All."""
        return (*self.overall, *self.cases)

    @property
    def regressions(self) -> tuple[Change, ...]:
        """What got worse beyond the confidence."""
        return tuple(each for each in self.changes if each.verdict == "worse")

    @property
    def is_regression(self) -> bool:
        """Whether anything got worse; a run that fails now and did not before always counts."""
        return bool(self.regressions or self.newly_failed)


def compare(
    old: RunStore,
    new: RunStore,
    metrics: Sequence[str] | None = None,
    window: EvaluationWindow = SETTLED,
    on_progress: Callable[[int, int], None] = lambda done, total: None,
) -> Comparison:
    """Compare the cases that two batches share; one record at a time is in memory.

    Runs with the same index and seed are paired. Raises `InputError` for an unknown metric and for
    batches without a case in common.
    """
    headers = [list(store.headers()) for store in (old, new)]
    measured = {name for header in headers[0] for name in header.columns}
    standard = (f"{position_of(measured)}_rms_m", *COMPARED)
    wanted = named_metrics(standard if metrics is None else metrics)
    olds, news = (dict.fromkeys(each.run.case.name for each in found) for found in headers)
    shared = [case for case in olds if case in news]
    if not shared:
        expected = f"expected a case that {old.folder} has, too; found none"
        raise InputError(new.folder, "cases", expected)
    tables, done, total = [], 0, sum(map(len, headers))
    for store, found in zip((old, new), headers, strict=True):
        rows = []
        for header in found:
            on_progress(done, total)
            done += 1
            if header.run.case.name in shared:
                rows.append(_row_of(store.record(header.run.key), wanted, window))
        tables.append(pd.DataFrame(rows))
    pairs = tables[0].merge(tables[1], on=_SAME_RUN, suffixes=("_old", "_new"))
    failed_old, failed_new = pairs["failed_old"], pairs["failed_new"]
    changes = {case: _changes(case, wanted, *tables) for case in shared}
    overall = _overall(tables[0], changes, wanted)
    verdicts = judged([*overall, *(change for of_case in changes.values() for change in of_case)])
    return Comparison(
        overall=verdicts[: len(overall)],
        cases=verdicts[len(overall) :],
        newly_failed=tuple(pairs["run_new"][~failed_old & failed_new]),
        repaired=int((failed_old & ~failed_new).sum()),
        only_old=len(olds) - len(shared),
        only_new=len(news) - len(shared),
        same_grid=old.grid_toml == new.grid_toml,
    )


def _row_of(
    record: RunRecord, metrics: Sequence[Metric], window: EvaluationWindow
) -> dict[str, object]:
    """A run with every metric of it alone; nan where it has no number."""
    run, failed = record.run, record.failure is not None
    axes = dict(run.case.settings)
    who = f"{ESTIMATOR_AXIS}={axes[ESTIMATOR_AXIS]}" if ESTIMATOR_AXIS in axes else "all"
    row: dict[str, object] = {"case": run.case.name, "index": run.index, "seed": run.seed}
    row |= {"run": run, "failed": failed, "estimator": who}
    samples = {} if failed else samples_of(record, metrics, window)
    for metric in metrics:
        value = np.nan
        if not failed:
            pool = Pool.of([samples[metric.quantity.name]])
            value = replicates_of(pool, once(1), [metric])[0, 0]
        row[metric.name] = value
    return row


def _changes(
    case: str, metrics: Sequence[Metric], old: pd.DataFrame, new: pd.DataFrame
) -> list[Change]:
    """Of one case, as far as runs have numbers; in pairs where there are two."""
    old, new = (each[(each["case"] == case) & ~each["failed"]] for each in (old, new))
    both = old[_SAME_RUN].merge(new[_SAME_RUN])
    # One pair says nothing of its spread: all runs then say more, unpaired.
    paired = len(both) > 1
    if paired:
        old, new = both.merge(old), both.merge(new)
    found = []
    for metric in metrics:
        before, now = (each[metric.name].to_numpy(dtype=np.float64) for each in (old, new))
        found.append(case_change(case, metric, before, now, paired))
    return [change for change in found if change is not None]


def _overall(
    runs: pd.DataFrame, changes: dict[str, list[Change]], metrics: Sequence[Metric]
) -> list[Change]:
    """Means over the cases of each estimator."""
    found = []
    for estimator, of_estimator in runs.groupby("estimator", sort=False):
        cases = [change for case in of_estimator["case"].unique() for change in changes[case]]
        for metric in metrics:
            same = [change for change in cases if change.metric is metric]
            if len(same) > 1:
                found.append(mean_change(f"{estimator}: mean of {len(same)} cases", same))
    return found


def overall_table(comparison: Comparison) -> TextTable:
    """The means over the cases of each estimator, as far as they differ."""
    return _table("overall", "All cases", comparison.overall, comparison)


def case_table(comparison: Comparison, *, only_sure: bool) -> TextTable:
    """Case by case, as far as they differ; ``only_sure`` leaves out what may be chance."""
    kept = [c for c in comparison.cases if not only_sure or c.verdict in ("worse", "better")]
    title = "Cases that changed for sure" if only_sure else "Case by case"
    return _table("cases", title, kept, comparison)


def verdict_lines(comparison: Comparison) -> tuple[str, ...]:
    """What the comparison comes to, in a few lines."""
    counts = Counter(each.verdict for each in comparison.changes)
    verdicts = ", ".join(f"{counts[word]} {word}" for word in VERDICTS)
    lines = [f"{len(comparison.changes)} numbers compared: {verdicts}"]
    if not comparison.same_grid:
        lines.append("the two grids differ, in their cases or in what they stand on: grid.toml")
    if comparison.only_old or comparison.only_new:
        lines.append(
            f"not compared: {comparison.only_old} cases only in the old batch, "
            f"{comparison.only_new} only in the new one"
        )
    lines += [f"fails now and did not before: {run}" for run in comparison.newly_failed]
    if comparison.repaired:
        lines.append(f"{comparison.repaired} runs that failed before have a result now")
    return tuple(lines)


def _table(key: str, title: str, changes: Sequence[Change], comparison: Comparison) -> TextTable:
    tests = sum(each.can_err for each in comparison.changes)
    note = (
        f"Means of each run's own value, of errors geometric ones. The intervals of all {tests} "
        "numbers that differ hold together with 95 % (Student's t over runs, in pairs where the "
        "seeds are the same, Bonferroni's correction). Worse or better is what lies beyond them "
        "and, for an error, is at least 1 %."
    )
    rows = tuple(_texts(each) for each in changes if each.can_err)
    return TextTable(key, title, _HEADER, rows, note, text_columns=2)


def _texts(change: Change) -> tuple[str, ...]:
    scale, unit = display_unit(change.metric.unit, max(change.old, change.new))
    pairing = "paired" if change.paired else "not paired"
    return (
        change.place,
        metric_label(change.metric, unit),
        number(scale * change.old),
        number(scale * change.new),
        _amount(change, change.worsening),
        f"{_amount(change, change.low)} to {_amount(change, change.high)}",
        f"{change.runs} {pairing}",
        change.verdict,
    )


def _amount(change: Change, worsening: float) -> str:
    """A worsening: of a logarithm the change in per cent, else the difference."""
    if change.is_ratio:
        # Beyond this the interval says nothing but that there are too few runs.
        return f"{100.0 * np.expm1(min(worsening, 5.0)):+.1f} %"
    unit = change.metric.unit
    return f"{worsening:+.3g}" + (f" {unit}" if unit != "1" else "")
