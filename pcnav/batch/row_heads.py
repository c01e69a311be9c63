"""How the rows of a table are named: axis by axis, or by what differs from most other rows."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from pcnav.batch.axes import AXES
from pcnav.batch.case import ESTIMATOR_AXIS, AxisValue, shown_value
from pcnav.batch.pivot import PivotTable, Values

_MAX_AXES = 4
"""More columns of axes, most of them the same from row to row, would hide what a row is about."""


@dataclass(frozen=True)
class RowHeads:
    """The first columns of a table."""

    header: tuple[str, ...]
    texts: dict[Values, tuple[str, ...]]
    """By row, in the order in which the rows are to be read."""
    note: str
    """What has to be known beside them; empty or a sentence after a blank."""


def row_heads(table: PivotTable) -> RowHeads:
    """A column for every axis; where there are many, one that names what is not as usual."""
    axes = table.layout.rows
    settings = [k for k, axis in enumerate(axes) if axis != ESTIMATOR_AXIS]
    if len(settings) <= _MAX_AXES:
        texts = {row: tuple(map(shown_value, row)) for row in table.rows}
        return RowHeads(tuple(map(axis_label, axes)), texts, "")
    usual = {k: Counter(row[k] for row in table.rows).most_common(1)[0][0] for k in settings}
    others = [k for k, axis in enumerate(axes) if axis == ESTIMATOR_AXIS]

    def strangeness(row: Values) -> list[int]:
        # The base first, then what differs in one axis, axis by axis, then in several.
        unusual = [k for k in settings if row[k] != usual[k]]
        return [len(unusual), *unusual]

    def text(row: Values) -> tuple[str, ...]:
        unusual = [axis_setting(axes[k], [row[k]]) for k in settings if row[k] != usual[k]]
        return (", ".join(unusual) or "base", *(shown_value(row[k]) for k in others))

    base = ", ".join(axis_setting(axes[k], [value]) for k, value in usual.items())
    header = ("case", *(axis_label(axes[k]) for k in others))
    note = f" What a case does not name is as in the base case: {base}."
    rows = sorted(table.rows, key=strangeness)
    return RowHeads(header, {row: text(row) for row in rows}, note)


def axis_label(name: str) -> str:
    """An axis in words, with its unit."""
    axis = AXES.get(name)
    return name if axis is None else axis.label


def axis_setting(name: str, values: Sequence[AxisValue]) -> str:
    """An axis and the values it has, with its unit: ``distance 10, 20 and 40 m``."""
    axis = AXES.get(name)
    title = name if axis is None else axis.title
    unit = "" if axis is None or axis.unit in ("", "1") else f" {axis.unit}"
    *most, last = map(shown_value, values)
    return f"{title} {', '.join(most)} and {last}{unit}" if most else f"{title} {last}{unit}"
