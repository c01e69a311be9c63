"""Tables and figures of the errors: percentiles of the plain filter, the bank and the coupling."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.files.text_table import TextTable
from pcnav.report.panels import Panel, Scale, panels_figure

from ..folder import StudyFigure
from ..panels import percentiles_of
from ..tables import cell, table
from .runs import QUANTITIES, Found

PLAIN, BANK = (50, 70, 90), (45, 50, 70, 90, 95)
"""Percentiles of Figs. 2, 3, 5, 6 and of Fig. 4."""
ATTITUDE = 2
_DRAWN: IntArray = np.arange(5)
_NAMES = ("relative position", "translational velocity", "relative attitude", "angular velocity")


@dataclass(frozen=True)
class Filter:
    """What one of the filters of every run did."""

    errors: FloatArray
    """(frames, runs, 5) of `QUANTITIES`."""
    nees: FloatArray
    """(frames, runs) of the motion, 12 components."""

    @staticmethod
    def of(found: Found, hypothesis: int, runs: int) -> "Filter":
        """The one that believes in a hypothesis, in the first runs."""
        return Filter(found.errors[:, :runs, hypothesis], found.nees[:, :runs, hypothesis])


def plain_table(known: Filter, times_s: FloatArray) -> TextTable:
    """The filter that knows the true inertia at some times."""
    last = len(times_s) - 1
    some = {0, min(1, last), *(round(part * last) for part in (0.1, 0.25, 0.5, 0.75, 1.0))}
    rows = []
    for k in sorted(some):
        percentiles = np.percentile(known.errors[k], PLAIN, axis=0).T.ravel()
        rows.append((f"{times_s[k]:g}", *percentiles, known.nees[k].mean()))
    columns = [f"{name}: {p} %" for name in QUANTITIES for p in PLAIN]
    return table("plain", ("time, s", *columns, "mean NEES"), rows)


def plain_figures(known: Filter, times_s: FloatArray) -> list[StudyFigure]:
    """Figs. 2 and 3."""
    names = (f"({letter}) {name}" for letter, name in zip("abcd", _NAMES, strict=True))
    motion = [_panel(name, known.errors, q, PLAIN) for q, name in enumerate(names)]
    points = [_panel("feature points", known.errors, 4, PLAIN)]
    return [_figure("figure2", times_s, motion, 2), _figure("figure3", times_s, points)]


def estimates_of(found: Found) -> dict[str, FloatArray]:
    """(frames, runs, 5) errors of what can be made of five drawn hypotheses.

    Of the weighted mean, the last frame alone.
    """
    return {
        "random inertia": found.errors[:, :, 0],
        "bank, most probable": found.errors_of(found.picked(_DRAWN)),
        "bank, most probable by (12)": found.errors_of(found.picked(_DRAWN, printed=True)),
        "bank, weighted mean": found.blended,
    }


def bank_table(key: str, found: Found) -> TextTable:
    """Fig. 4: five hypotheses against one of them chosen at random, at the end."""
    header = ("estimate", "quantity", *(f"{p} %" for p in BANK))
    return table(key, header, _at_end(estimates_of(found), BANK), text_columns=2)


def bank_figure(key: str, found: Found, times_s: FloatArray) -> StudyFigure:
    """Fig. 4 over time."""
    estimates = estimates_of(found)
    panels = [
        _panel("(a) random inertia", estimates["random inertia"], ATTITUDE, BANK),
        _panel("(b) bank", estimates["bank, most probable"], ATTITUDE, BANK),
    ]
    return _figure(key, times_s, panels, 2)


def coupling_table(filters: Mapping[str, Filter]) -> TextTable:
    """Figs. 5 and 6: what the kinematic coupling does, at the end."""
    rows: list[tuple[str, ...]] = []
    for name, each in filters.items():
        rows += [tuple(map(cell, row)) for row in _at_end({name: each.errors}, PLAIN)]
        rows.append((name, "mean NEES (12 expected)", cell(each.nees[-1].mean()), "", ""))
    header = ("filter", "quantity", *(f"{p} %" for p in PLAIN))
    return TextTable("coupling", "", header, tuple(rows), text_columns=2)


def coupling_figures(filters: Mapping[str, Filter], times_s: FloatArray) -> list[StudyFigure]:
    """Figs. 5 and 6 over time."""
    found = []
    for q, number in enumerate(("5a", "5b", "5c", "5d", "6")):
        panels = [_panel(name, each.errors, q, PLAIN) for name, each in filters.items()]
        found.append(_figure(f"figure{number}", times_s, panels, len(panels)))
    return found


def _at_end(
    errors: Mapping[str, FloatArray], percentiles: Sequence[int]
) -> Iterable[tuple[object, ...]]:
    """A row of percentiles at the last frame for every name and quantity."""
    return [
        (name, quantity, *np.percentile(each[-1, :, q], percentiles))
        for name, each in errors.items()
        for q, quantity in enumerate(QUANTITIES)
    ]


def _panel(title: str, errors: FloatArray, quantity: int, percentiles: Sequence[int]) -> Panel:
    curves = percentiles_of(errors[..., quantity], percentiles)
    return Panel(QUANTITIES[quantity], curves, Scale.FROM_ZERO, title)


def _figure(
    key: str, times_s: FloatArray, panels: Sequence[Panel], columns: int = 1
) -> StudyFigure:
    return StudyFigure(key, panels_figure(times_s, panels, columns=columns, row_in=2.1))
