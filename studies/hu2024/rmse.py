"""Fig. 5 in tables and figures: RMSE of the identified axes, with what the paper states of it."""

from collections.abc import Mapping, Sequence

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.files.text_table import TextTable

from ..folder import StudyFigure
from ..panels import Curve, Panel, Scale, panels_figure
from ..tables import table
from .identification import REPORT_S, Method, Squared

Rmse = Mapping[str, Mapping[Method, FloatArray]]
"""(report times,) in degrees by resolution, the finest first, and method."""
_KEYS = {Method.ARC: ("fig05", "fig05_arc"), Method.PRINTED: ("fig05_printed", "fig05_printed")}
"""Of table and figure."""


def rmse_of(by_level: Mapping[str, Sequence[Squared]]) -> Rmse:
    """RMSE (45) over all runs of each level."""
    return {
        level: {
            method: np.degrees(
                np.sqrt(np.concatenate([each[method] for each in batches]).mean(axis=0))
            )
            for method in Method
        }
        for level, batches in by_level.items()
    }


def falls(rmse: Rmse, method: Method) -> bool:
    """Whether every level falls from its first report to its last."""
    return all(bool(curves[method][-1] < curves[method][0]) for curves in rmse.values())


def rises_with_noise(rmse: Rmse, method: Method) -> bool:
    """Whether at the last report more noise is a larger error."""
    return bool(np.all(np.diff([curves[method][-1] for curves in rmse.values()]) > 0.0))


def rmse_tables(rmse: Rmse, runs: int) -> list[TextTable]:
    """Of both methods."""
    paper_says = "falls within a few seconds, before the first occlusion; more noise, larger error"
    header = ("resolution", *(f"{t:g} s" for t in REPORT_S), "ours over time", "paper (Fig. 5)")
    found = []
    for method, (key, _) in _KEYS.items():
        rows = []
        for level, curves in rmse.items():
            values = curves[method]
            ours = "falls" if values[-1] < values[0] else "does not fall"
            rows.append((level, *values, ours, paper_says))
        title = f"Fig. 5: RMSE of the attitude, deg ({method})"
        found.append(table(key, title, header, rows, f"{runs} runs per level."))
    return found


def rmse_figures(rmse: Rmse, runs: int) -> list[StudyFigure]:
    """Of both methods, over the length of the arc."""
    found = []
    for method, (_, key) in _KEYS.items():
        curves = [Curve(level, by[method], style=".-") for level, by in rmse.items()]
        found.append(
            panels_figure(
                key,
                f"Fig. 5: attitude of the identified principal axes, {method}",
                f"RMSE (45) over {runs} runs per level, for arcs from the first frame on.",
                np.array(REPORT_S),
                [Panel("RMSE, deg", curves, Scale.LOG)],
                row_in=2.5,
                at_label="length of the arc, s",
                log_at=True,
            )
        )
    return found
