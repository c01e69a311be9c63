"""How good a run is frame by frame, as numbers that every kind of run may have."""

from enum import StrEnum

import numpy as np

from pcnav.core import chi_square
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import ATTITUDE, POSITION
from pcnav.viewer.loaded_run import LoadedRun

CONFIDENCE = 0.95
_JUDGED = (POSITION, ATTITUDE)


def nis_over_bound(loaded: LoadedRun) -> FloatArray:
    """(n,) NIS over what 95 % of true ones stay below; nan where there is none."""
    run = loaded.run
    used = np.isfinite(run.nis) & (run.nis_dof > 0)
    ratio = np.full(len(run), np.nan)
    if used.any():
        ratio[used] = run.nis[used] / chi_square.quantile(CONFIDENCE, run.nis_dof[used])
    return ratio


def inlier_ratio(loaded: LoadedRun) -> FloatArray | None:
    """(n,) share of what was compared with the estimate that agrees with it: of returns, or of
    features; None of a run that tells none."""
    notes = loaded.run.notes
    ratio = notes.get("inlier_ratio")
    if ratio is None and {"agreeing", "matches"} <= set(notes):
        ratio = _share(notes["agreeing"], notes["matches"])
    elif ratio is None and {"n_used", "n_rejected"} <= set(notes):
        ratio = _share(notes["n_used"], notes["n_used"] + notes["n_rejected"])
    return ratio if ratio is not None and np.isfinite(ratio).any() else None


def _share(part: FloatArray, of: FloatArray) -> FloatArray:
    """Of counts (n,); nan of none."""
    return np.asarray(np.divide(part, of, out=np.full(len(part), np.nan), where=of > 0.0))


def error_over_sigma(loaded: LoadedRun) -> FloatArray | None:
    """(n,) error over stated deviation, the larger of position's and attitude's; None without.

    Of three components the root mean square: 1 is what the run says of itself.
    """
    found = []
    for block in _JUDGED:
        error = loaded.error(block)
        if error is None or not loaded.has(block):
            continue
        sd = loaded.trajectory.sd_of(block)
        known = np.isfinite(sd) & (sd > 0.0)
        ratio = np.divide(error, sd, out=np.full(error.shape, np.nan), where=known)
        found.append(np.sqrt(np.mean(ratio**2, axis=1)))
    if not found:
        return None
    return np.asarray(np.fmax.reduce(found))


SIGMA_BOUND = float(np.sqrt(chi_square.quantile(0.9999, 3) / 3.0))
"""Of `error_over_sigma`: 9,999 of 10,000 true statements stay below."""


def worst_frame(loaded: LoadedRun) -> int | None:
    """The frame of the largest error over sigma; None where no error is known."""
    ratio = error_over_sigma(loaded)
    if ratio is None or not np.isfinite(ratio).any():
        return None
    return int(np.nanargmax(ratio))


class Opening(StrEnum):
    """Where a page opens that no frame is named to."""

    LAST = "last"
    """The last estimate that is claimed."""
    WORST = "worst"
    """The largest error over sigma."""


def opening_frame(loaded: LoadedRun, opening: Opening) -> int:
    """The frame to open at: the last claimed one, too, where no error is known."""
    worst = worst_frame(loaded) if opening is Opening.WORST else None
    return loaded.opening_frame if worst is None else worst
