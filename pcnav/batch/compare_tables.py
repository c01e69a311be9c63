"""The tables of a comparison: what is printed, and the whole of it for a file."""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from pcnav.batch.changes import VERDICTS, JudgedChange
from pcnav.batch.compare import Comparison
from pcnav.batch.formats import metric_label
from pcnav.files.text_table import TextTable, display_unit, number

_HEADER = ("where", "metric", "old", "new", "worse by", "interval", "runs", "verdict")


def overall_table(comparison: Comparison) -> TextTable:
    """The means over the cases of each estimator, as far as they differ."""
    rows = _rows(comparison.overall)
    return TextTable("overall", "All cases", _HEADER, rows, _note(comparison), text_columns=2)


def case_table(comparison: Comparison, *, only_sure: bool) -> TextTable:
    """Case by case, as far as they differ; ``only_sure`` leaves out what may be chance."""
    kept = [c for c in comparison.cases if not only_sure or c.verdict in ("worse", "better")]
    title = "Cases that changed for sure" if only_sure else "Case by case"
    return TextTable("cases", title, _HEADER, _rows(kept), _note(comparison), text_columns=2)


def verdict_lines(comparison: Comparison) -> tuple[str, ...]:
    """What the comparison comes to, in a few lines."""
    sure = (*comparison.overall, *comparison.cases)
    counts = Counter(each.verdict for each in sure)
    verdicts = ", ".join(f"{counts[word]} {word}" for word in VERDICTS)
    lines = [f"{len(sure)} numbers compared: {verdicts}"]
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


def _rows(changes: Sequence[JudgedChange]) -> tuple[tuple[str, ...], ...]:
    return tuple(_row(each) for each in changes if each.change.can_err)


def _row(each: JudgedChange) -> tuple[str, ...]:
    change = each.change
    scale, unit = display_unit(change.metric.unit, max(change.old, change.new))
    pairing = "paired" if change.paired else "not paired"
    return (
        change.place,
        metric_label(change.metric, unit),
        number(scale * change.old),
        number(scale * change.new),
        _amount(each, change.worsening),
        f"{_amount(each, each.low)} to {_amount(each, each.high)}",
        f"{change.runs} {pairing}",
        each.verdict,
    )


def _amount(each: JudgedChange, worsening: float) -> str:
    """A worsening: of a logarithm the change in per cent, else the difference."""
    if each.change.is_ratio:
        # Beyond this the interval says nothing but that there are too few runs.
        return f"{100.0 * np.expm1(min(worsening, 5.0)):+.1f} %"
    unit = each.change.metric.unit
    return f"{worsening:+.3g}" + (f" {unit}" if unit != "1" else "")


def _note(comparison: Comparison) -> str:
    tests = sum(c.change.can_err for c in (*comparison.overall, *comparison.cases))
    return (
        f"Means of each run's own value, of errors geometric ones. The intervals of all {tests} "
        "numbers that differ hold together with 95 % (Student's t over runs, in pairs where the "
        "seeds are the same, Bonferroni's correction). Worse or better is what lies beyond them "
        "and, for an error, is at least 1 %."
    )
