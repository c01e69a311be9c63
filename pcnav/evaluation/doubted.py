"""What the doubts of a run's frames come to, in sentences with their evidence."""

from collections.abc import Callable

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.files.text_table import number
from pcnav.runs.doubts import COLUMN, RIM_COLUMN, Doubt, doubts_in
from pcnav.runs.nis_window import NIS_WINDOW_FRAMES
from pcnav.runs.run import Run

_MIN_FRAMES, _MIN_SHARE = 3, 0.02
"""So many claimed frames, and such a share of them, are more than a moment's doubt."""


def doubted(run: Run, claimed: BoolArray) -> list[str]:
    """A sentence for each doubt that lasted over claimed frames (n,).

    Those of the mass and of the calibration are told by the estimator itself.
    """
    fields = run.words.get(COLUMN)
    if fields is None:
        return []
    raised = [doubts_in(field) for field in fields]
    sentences = []
    for doubt, told in _TELLING.items():
        on = claimed & np.array([doubt in each for each in raised], dtype=np.bool_)
        frames = np.flatnonzero(on)
        if len(frames) < max(_MIN_FRAMES, _MIN_SHARE * np.count_nonzero(claimed)):
            continue
        share = f"{len(frames) / np.count_nonzero(claimed):.0%} of the claimed frames"
        sentences.append(f"{told(run, on)}: in {share}, first in frame {frames[0]}")
    return sentences


def _of_nis(run: Run, on: BoolArray) -> str:
    worst = number(float(np.nanmax(run.window_nis[on])))
    return (
        f"the NIS of {NIS_WINDOW_FRAMES} frames reached {worst} per degree of freedom, more than "
        "noise makes by chance: something errs that is none"
    )


def _of_share(run: Run, on: BoolArray) -> str:
    ratio = run.notes.get("inlier_ratio", np.full(len(run), np.nan))
    usual = float(np.nanmedian(ratio)) if np.isfinite(ratio).any() else float("nan")
    return (
        f"less of the frames is explained than of those before, {_least(ratio[on]):.0%} at the "
        f"least where {usual:.0%} is usual: something stands before the target, or it is not as "
        "modelled"
    )


def _of_rim(run: Run, on: BoolArray) -> str:
    step = run.notes.get(RIM_COLUMN, np.full(len(run), np.nan))[on]
    last = step[np.isfinite(step)]
    px = float(last[-1]) if last.size else float("nan")
    side = "outside" if px > 0.0 else "inside"
    return (
        f"the outline is seen {number(abs(px))} px {side} of where the surfaces end, which is "
        "taken off: pixels return from less or more than half of their area, or are not all of "
        "one time"
    )


def _least(values: FloatArray) -> float:
    known = values[np.isfinite(values)]
    return float(known.min()) if known.size else float("nan")


_TELLING: dict[Doubt, Callable[[Run, BoolArray], str]] = {
    Doubt.NIS: _of_nis,
    Doubt.EXPLAINED: _of_share,
    Doubt.RIM: _of_rim,
}
