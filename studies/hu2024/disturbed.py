"""The filter under 0.01, 0.1 and 1 of the printed disturbance, which it is told of.

``python -m studies.hu2024.disturbed 40`` prints the table alone, of so many runs of every share.
"""

import sys
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pcnav.batch.monte_carlo import Case, Run, runs_of
from pcnav.core.arrays import FloatArray, joined
from pcnav.core.statistics import MeanSquared, mean, mean_squared, root_mean_square
from pcnav.files.text_table import TextTable
from pcnav.report.panels import panels_figure

from ..folder import StudyFigure
from ..panels import mean_squared_panel
from ..tables import table_of
from ..work import Work
from . import paper
from .errors import ATTITUDE
from .following import Following, Judged, run_case

SHARES = (0.01, 0.1, 1.0)
"""Of the printed disturbances."""
_HALF_TURN_DEG = 90.0
"""An attitude off by more is in axes that are signed or ordered otherwise."""


def disturbed_cases() -> list[Case[Following]]:
    """One for every share."""
    return [
        Case(f"{share:g} of print", Following(paper.settings(share), disturbed=True))
        for share in SHARES
    ]


def disturbed_runs(count: int) -> list[Run[Following]]:
    """So many runs of every share, which meet the same points."""
    return runs_of(paper.NAME, disturbed_cases(), count)


@dataclass(frozen=True)
class Claimed:
    """Runs of a share where they say ``locked``."""

    name: str
    runs: Judged
    whole: MeanSquared
    """(n,) NEES of the whole state over the runs that are locked at a time."""

    @staticmethod
    def of(name: str, runs: Judged) -> "Claimed":
        """What is claimed in the runs of a case."""
        nees = np.where(runs.locked, runs.nees, np.nan)
        return Claimed(name, runs, mean_squared(nees, runs.size))

    @property
    def share_locked(self) -> float:
        """Of the judged frames."""
        return float(np.mean(self.runs.locked))

    @property
    def half_turns(self) -> int:
        """Runs in which an attitude half a turn off is called locked at any time."""
        return int(np.any(self._degrees() > _HALF_TURN_DEG, axis=1).sum())

    @property
    def share_inside(self) -> float:
        """Of the times at which some are locked, those with the mean NEES inside its bounds; nan
        where none ever is."""
        return mean(self.whole.inside[self.whole.values > 0])

    @property
    def mean_nees(self) -> float:
        """Per degree of freedom, over all frames that are locked."""
        return mean((self.runs.nees / self.runs.size)[self.runs.locked])

    @property
    def attitude_deg(self) -> float:
        """RMS error where locked."""
        return root_mean_square(self._degrees())

    @property
    def over_sd(self) -> float:
        """RMS of the components of the attitude's error over their stated deviations."""
        over = self.runs.error[..., ATTITUDE.rows] / self.runs.sd[..., ATTITUDE.rows]
        return root_mean_square(over[self.runs.locked])

    def at(self, part: float) -> MeanSquared | None:
        """NEES at the last time up to a part of the run at which some are locked; None if never."""
        end = part * float(self.runs.time_s[-1])
        known = (self.whole.values > 0) & (self.runs.time_s <= end + 1e-9)
        return self.whole[int(np.flatnonzero(known)[-1])] if known.any() else None

    def _degrees(self) -> FloatArray:
        """(runs, n) error of the attitude where locked, else nan."""
        return np.where(self.runs.locked, ATTITUDE.norms(self.runs), np.nan)


def claimed_by(by_case: Mapping[str, Judged]) -> list[Claimed]:
    """Of every share."""
    return [Claimed.of(case.name, by_case[case.name]) for case in disturbed_cases()]


def disturbed_table(found: list[Claimed]) -> TextTable:
    """What is claimed under every share."""
    return table_of(
        "disturbed",
        found,
        {
            "disturbance": lambda each: each.name,
            "runs": lambda each: len(each.runs),
            "frames locked": lambda each: f"{each.share_locked:.0%}",
            "runs that said lost": lambda each: int(each.runs.lost.sum()),
            "half turns called locked": lambda each: each.half_turns,
            "attitude, deg": lambda each: each.attitude_deg,
            "over its sd": lambda each: each.over_sd,
            "mean NEES": lambda each: each.mean_nees,
            "at a quarter": lambda each: each.at(0.25),
            "at half": lambda each: each.at(0.5),
            "at the end": lambda each: each.at(1.0),
            "times inside": lambda each: f"{each.share_inside:.0%}",
        },
    )


def disturbed_figure(found: list[Claimed]) -> StudyFigure:
    """NEES over time where locked, a panel for every share."""
    panels = [mean_squared_panel(f"NEES, {each.name}", each.whole) for each in found]
    times = found[0].runs.time_s
    return StudyFigure("nees_disturbed", panels_figure(times, panels, dark=paper.blackouts_s()))


def main(runs: int) -> TextTable:
    """The table of so many runs of every share."""
    work = Work()
    planned = work.plan(run_case, disturbed_runs(runs))
    work.run()
    by_case = {name: joined(each, alike=("time_s",)) for name, each in planned.by_case.items()}
    return disturbed_table(claimed_by(by_case))


if __name__ == "__main__":
    made = main(int(sys.argv[1]))
    for k, title in enumerate(made.header):
        sys.stdout.write(" | ".join([title, *(row[k] for row in made.rows)]) + "\n")
