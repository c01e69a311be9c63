"""Sweeps of a batch: runs that differ in one numeric axis and are alike in all others.

A curve of an error over the range must not mix the range with what else changed from case to case:
only combinations of the other axes that were run at every point of the curve enter it.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

from pcnav.batch.case import ESTIMATOR_AXIS, AxisValue, BatchRun, shown_value
from pcnav.batch.pivot import AxisOrder, Values, values_of

FACET_AXIS = "satellite"
"""Never pooled in a figure: errors in metres follow the size of the target."""


@dataclass(frozen=True)
class Sweep:
    """One figure's worth of runs."""

    axis: str
    facet: AxisValue | None
    """The satellite; None where the batch does not tell them apart."""
    runs: tuple[BatchRun, ...]
    pooled: tuple[tuple[str, tuple[AxisValue, ...]], ...]
    """What the other axes are: one value where they are fixed, several where runs are pooled."""

    @property
    def points(self) -> int:
        """Values of the axis."""
        return len({run.case.value(self.axis) for run in self.runs})

    @property
    def key(self) -> str:
        """Name of its figure's file."""
        return self.axis if self.facet is None else f"{self.axis}_{shown_value(self.facet)}"


def sweeps(runs: Sequence[BatchRun]) -> tuple[Sweep, ...]:
    """All sweeps of a batch along axes of numbers, axis by axis."""
    order = AxisOrder.of(runs)
    facets: tuple[AxisValue | None, ...] = order.values.get(FACET_AXIS, (None,))
    found = []
    for axis in order.varying:
        if any(isinstance(value, str) for value in order.values[axis]):
            continue
        for facet in facets:
            members = [run for run in runs if facet is None or run.case.value(FACET_AXIS) == facet]
            sweep = _sweep(axis, facet, members, order)
            if sweep is not None:
                found.append(sweep)
    return tuple(found)


def _sweep(
    axis: str, facet: AxisValue | None, runs: Sequence[BatchRun], order: AxisOrder
) -> Sweep | None:
    """The runs of the curves with the most points; None where no curve has two."""
    others = tuple(name for name in order.values if name not in (axis, ESTIMATOR_AXIS))
    who = tuple(name for name in (ESTIMATOR_AXIS,) if name in order.values)
    # Which points each estimator has in each setting of the other axes.
    seen: dict[tuple[Values, Values], set[AxisValue]] = defaultdict(set)
    for run in runs:
        seen[values_of(run, others), values_of(run, who)].add(run.case.value(axis))
    points = max(seen.values(), key=len, default=set())
    if len(points) < 2:
        return None
    # The settings in which the most estimators have all these points, and these estimators.
    complete: dict[Values, set[Values]] = defaultdict(set)
    for (setting, estimator), values in seen.items():
        if values >= points:
            complete[setting].add(estimator)
    estimators = max(complete.values(), key=len)
    settings = {setting for setting, having in complete.items() if having >= estimators}
    kept = tuple(
        run
        for run in runs
        if run.case.value(axis) in points
        and values_of(run, others) in settings
        and values_of(run, who) in estimators
    )
    found = AxisOrder.of(kept).values
    pooled = tuple((name, found[name]) for name in others if name != FACET_AXIS)
    return Sweep(axis, facet, kept, pooled)
