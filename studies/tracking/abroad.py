"""Abroad: frames as real sensors make them, with and without a first pose."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.statistics import mean, percentile
from pcnav.files.text_table import TextTable
from pcnav.simulation.depth import Scene

from ..following import JudgedRun, follow, status_shares
from ..tables import Claim, marked_frames, table_of
from .cases_abroad import CASES as SCENES

NAME = "abroad"
FRAMES = 60
MIN_SHARE, MAX_RATIO = 0.95, 1.3
NEES = (0.8, 1.3)
"""Bars: share of frames with a pose, error over that without the fault, NEES over dof."""
_WITH_FIRST_POSE = ", first pose"
_QUICK = ("clean", "wall", "laboratory", "held")

CASES = {
    name + (_WITH_FIRST_POSE if first else ""): (name, first)
    for name in SCENES
    for first in (False, True)
}
QUICK_CASES = {name: (name, False) for name in _QUICK}
"""Some of them, for a look at the machinery."""


@dataclass(frozen=True)
class AbroadRun:
    """A run on the frames of a case."""

    case: str
    first_pose: bool
    seed: int
    run: JudgedRun

    @property
    def name(self) -> str:
        """Of its row."""
        return self.case + (_WITH_FIRST_POSE if self.first_pose else "")

    @property
    def beside(self) -> str | None:
        """The row of the same frames without the fault."""
        name = SCENES[self.case].beside
        return name and name + (_WITH_FIRST_POSE if self.first_pose else "")

    @property
    def wrong(self) -> BoolArray:
        """(n,) frames called locked or ambiguous that are not right, up to symmetry."""
        return self.run.claims & ~self.run.is_right(SCENES[self.case].base.found.target)

    @property
    def right(self) -> BoolArray:
        """(n,) frames so called that are."""
        return self.run.claims & ~self.wrong


AbroadRuns = Mapping[str, Sequence[AbroadRun]]
"""By row: case, with or without a first pose."""


def run_abroad(case: str, first_pose: bool, seed: int, frames: int = FRAMES) -> AbroadRun:
    """One run of a case: truth, scene and noise are the seed's."""
    scene_of = SCENES[case]
    pipeline, target = scene_of.pipeline(seed, frames), scene_of.base.found.target
    scenario = pipeline.scenario.model_copy(update={"states_first_pose": first_pose})
    scene = Scene.of(pipeline.model_copy(update={"scenario": scenario}), target.mesh)
    return AbroadRun(case, first_pose, seed, follow(scene, target))


def tables(found: AbroadRuns) -> list[TextTable]:
    """All cases, and the runs with wrong frames."""
    wrong = [run for own in found.values() for run in own if run.wrong.any()]
    return [_table(found), _wrong_table(wrong)]


def claims(found: AbroadRuns) -> list[Claim]:
    """One of every row: enough poses, none wrong, honest, and as exact as without the fault."""
    return [_claim(found, own) for own in found.values()]


def wrong_frames(found: AbroadRuns) -> int:
    """Frames called locked or ambiguous that are wrong."""
    return sum(int(np.count_nonzero(run.wrong)) for own in found.values() for run in own)


def _claim(found: AbroadRuns, own: Sequence[AbroadRun]) -> Claim:
    share, nees = _pose_share(own), _nees(own)
    wrong = sum(int(np.count_nonzero(run.wrong)) for run in own)
    expected = [f">= {MIN_SHARE:g}", "0", f"{NEES[0]:g} to {NEES[1]:g}"]
    ours: list[object] = [share, wrong, nees]
    met = share >= MIN_SHARE and wrong == 0 and NEES[0] <= nees <= NEES[1]
    ratios = _ratios(found, own)
    if ratios is not None and not SCENES[own[0].case].loses_information:
        expected.append(f"<= {MAX_RATIO:g}")
        ours.append(ratios)
        # A ratio of no frames does not meet it.
        met = met and all(ratio <= MAX_RATIO for ratio in ratios)
    quantity = f"{own[0].name}: poses / wrong / NEES / error ratio"
    return Claim(NAME, quantity, expected, ours, bool(met))


def _table(found: AbroadRuns) -> TextTable:
    def errors(own: Sequence[AbroadRun], of: int) -> float:
        return percentile(np.concatenate([_errors(run)[of][run.right] for run in own]), 50)

    return table_of(
        "abroad",
        found.values(),
        {
            "case": lambda own: own[0].name,
            "status": lambda own: status_shares([each.run.said for each in own]),
            "runs": len,
            "share with a pose": _pose_share,
            "share wrong": lambda own: mean(np.concatenate([each.wrong for each in own])),
            "position, mm": lambda own: errors(own, 0),
            "attitude, deg": lambda own: errors(own, 1),
            "over those without": lambda own: _ratios(found, own),
            "pose NEES": _nees,
        },
        text_columns=2,
    )


def _wrong_table(runs: Sequence[AbroadRun]) -> TextTable:
    return table_of(
        "abroad_wrong",
        runs,
        {
            "case": lambda each: each.name,
            "seed": lambda each: each.seed,
            **marked_frames(lambda each: each.wrong),
        },
    )


def _pose_share(own: Sequence[AbroadRun]) -> float:
    """Of all frames, from the first on."""
    return mean(np.concatenate([each.run.claims for each in own]))


def _nees(own: Sequence[AbroadRun]) -> float:
    """Mean over the frames that are right, over the degrees of freedom."""
    return mean(np.concatenate([each.run.pose_nees[each.right] for each in own])) / 6.0


def _errors(run: AbroadRun) -> FloatArray:
    """(2, n) position error, mm, and attitude error, deg."""
    return np.stack([1e3 * run.run.position_m, np.rad2deg(run.run.attitude_rad)])


def _ratios(found: AbroadRuns, own: Sequence[AbroadRun]) -> list[float] | None:
    """Median errors of position and attitude over those without the fault, in the frames of the
    same seeds that are right in both; None of a case that has no such frames."""
    clean = {run.seed: run for run in found.get(own[0].beside or "", ())}
    pairs = [(run, clean[run.seed]) for run in own if run.seed in clean]
    if not pairs:
        return None
    both = [run.right & other.right for run, other in pairs]
    of, without = (
        np.concatenate([_errors(pair[k])[:, use] for pair, use in zip(pairs, both, strict=True)], 1)
        for k in (0, 1)
    )
    medians = [[percentile(errors, 50) for errors in each] for each in (of, without)]
    return [a / b if b > 0.0 else np.nan for a, b in zip(*medians, strict=True)]
