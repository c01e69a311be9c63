"""Cells of a table: the runs of a batch grouped by some of its axes, and the numbers of each group.

Cases that differ only in axes a table does not show are pooled in one cell.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from pcnav.batch.case import ESTIMATOR_AXIS, AxisValue, BatchRun
from pcnav.batch.metrics import Metric
from pcnav.batch.record import RunRecord
from pcnav.batch.samples import Window
from pcnav.batch.statistics import CellStatistics, cell_statistics
from pcnav.core.errors import InputError

Values = tuple[AxisValue, ...]
"""What a row or a column of a table stands for, axis by axis."""
ReadRun = Callable[[BatchRun], RunRecord]
"""Reads the record of a run."""


@dataclass(frozen=True)
class Layout:
    """What a table shows, and where."""

    key: str
    """Name of its files, without a suffix."""
    title: str
    rows: tuple[str, ...]
    """Axes; each combination of their values that was run is a row."""
    columns: tuple[str, ...]
    """Axes, likewise. Without any, the metrics stand side by side in one table; with some, each
    metric has a table of its own."""
    metrics: tuple[Metric, ...]
    shared: bool = False
    """Whether only cases enter that the estimators have in common, see `shared_runs`: rows that
    pool other cases cannot be compared."""


@dataclass(frozen=True)
class PivotTable:
    """A layout filled with numbers."""

    layout: Layout
    rows: tuple[Values, ...]
    columns: tuple[Values, ...]
    """One empty combination where the layout has no columns."""
    cells: dict[tuple[Values, Values], CellStatistics]
    """Those that were run."""

    def of(self, row: Values, column: Values) -> CellStatistics | None:
        """A cell; None for a combination that was not run."""
        return self.cells.get((row, column))

    def __iter__(self) -> Iterator[tuple[Values, Values, CellStatistics]]:
        """The cells that were run, row by row."""
        for row in self.rows:
            for column in self.columns:
                cell = self.of(row, column)
                if cell is not None:
                    yield row, column, cell


def pivot(layout: Layout, runs: Sequence[BatchRun], read: ReadRun, window: Window) -> PivotTable:
    """Fill a layout; the records of one cell are read one after the other, and then forgotten."""
    groups: dict[tuple[Values, Values], list[BatchRun]] = {}
    for run in shared_runs(runs) if layout.shared else runs:
        place = (values_of(run, layout.rows), values_of(run, layout.columns))
        groups.setdefault(place, []).append(run)
    cells = {
        place: cell_statistics(map(read, members), layout.metrics, window)
        for place, members in groups.items()
    }
    order = AxisOrder.of(runs)
    return PivotTable(
        layout=layout,
        rows=order.sorted(layout.rows, [row for row, _ in cells]),
        columns=order.sorted(layout.columns, [column for _, column in cells]),
        cells=cells,
    )


def shared_runs(runs: Sequence[BatchRun]) -> list[BatchRun]:
    """The runs of the estimators that met at least half of all scenarios, of those scenarios that
    all of these estimators met."""
    met: dict[str, set[str]] = {}
    for run in runs:
        met.setdefault(_estimator(run), set()).add(run.case.scenario)
    every = set().union(*met.values())
    usual = {name for name, scenarios in met.items() if 2 * len(scenarios) >= len(every)}
    common = every.intersection(*(met[name] for name in usual))
    if not common:
        return list(runs)
    return [run for run in runs if _estimator(run) in usual and run.case.scenario in common]


def without_empty_rows(table: PivotTable) -> PivotTable:
    """A table without the rows that have no number at all: what they estimate is not asked here."""
    having = {
        row
        for row, _, cell in table
        if any(estimate.exists for estimate in cell.estimates.values())
    }
    rows = tuple(row for row in table.rows if row in having)
    cells = {place: cell for place, cell in table.cells.items() if place[0] in having}
    return PivotTable(table.layout, rows, table.columns, cells)


@dataclass(frozen=True)
class AxisOrder:
    """In which order the values of each axis are shown."""

    values: dict[str, tuple[AxisValue, ...]]
    """By axis: numbers rising, words as they come in the batch."""

    @classmethod
    def of(cls, runs: Sequence[BatchRun]) -> "AxisOrder":
        """As the runs of a batch have them."""
        found: dict[str, dict[AxisValue, None]] = {}
        for run in runs:
            for axis, value in run.case.axes:
                found.setdefault(axis, {})[value] = None
        return cls({axis: _ordered(values) for axis, values in found.items()})

    @property
    def varying(self) -> tuple[str, ...]:
        """The axes on which cases differ."""
        return tuple(axis for axis, values in self.values.items() if len(values) > 1)

    def sorted(self, axes: Sequence[str], combinations: Sequence[Values]) -> tuple[Values, ...]:
        """Combinations of values of some axes, each once, in order."""
        places = [{value: k for k, value in enumerate(self.values[axis])} for axis in axes]

        def place(combination: Values) -> tuple[int, ...]:
            return tuple(of[value] for of, value in zip(places, combination, strict=True))

        return tuple(sorted(dict.fromkeys(combinations), key=place))

    def check(self, option: str, axes: Sequence[str]) -> None:
        """Raises `InputError`, which lists the axes, for one that the batch does not have."""
        for axis in axes:
            if axis not in self.values:
                raise InputError(option, axis, f"expected some of: {', '.join(self.values)}")
        if len(set(axes)) < len(axes):
            raise InputError(option, ",".join(axes), "expected each axis once")


def values_of(run: BatchRun, axes: Sequence[str]) -> Values:
    """What a run's case has on some axes."""
    return tuple(run.case.value(axis) for axis in axes)


def _estimator(run: BatchRun) -> str:
    return str(dict(run.case.axes).get(ESTIMATOR_AXIS, ""))


def _ordered(values: dict[AxisValue, None]) -> tuple[AxisValue, ...]:
    numbers = sorted(value for value in values if not isinstance(value, str))
    return (*numbers, *(value for value in values if isinstance(value, str)))
