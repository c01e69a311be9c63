"""Whether what is seen is the target at all: the one judge of every pose that is to be claimed.

That a pose explains more of its frames than others do says where the target is if it is there. It
need not be: walls, cushions and other boxes hold poses, too, fitted as well as they allow. So a
claim takes odds for the target at a pose against something else of about its size and place: where
frame and view agree, or contradict each other in whole patches, both explain that, by chances of
their own. Of one view of one thing all frames say the same; only new sides of it are new evidence.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import rotation_angle
from pcnav.perception.agreement import Agreement

CLEAR_LEAD = 9.0
"""Lead in log-likelihood that decides: 8,000 to one."""
NATS_PER_CONFLICT = 0.25
"""Log-likelihood that a pixel against a pose costs it. A stray return costs about 4, the log of
outliers' density over the noise's; neighbours err together, so a patch of 4 x 4 counts as one."""
_PATCH_PIXELS = 16
_MAX_PATCHES = 64.0
"""However many pixels a target covers, its shape has no more parts that differ: 8 x 8 of them."""
_CHANCE, _CHANCE_OF_PART = 0.75, 0.6
"""Share of a view that something else agrees with, once the pose has been fitted to that; where the
target is alone in the frame, that another pose of it does: one that fits a turned part of several
fits that part, and as little else as this."""
_CONTRADICTED, _CONTRADICTED_BY_PART = 0.05, 0.12
"""Share of the target's own view that may be contradicted: a mesh is not quite the target, and of
one of several bodies that is alone a whole body may be turned or missing."""
_AGAIN = 0.25
"""What a frame that shows the same view as the one before counts, over a first one ..."""
_NEW_VIEW_RAD = 0.15
"""... and the turn of the target in the camera that makes it count as much more."""
SEARCHED = float(np.log(150.0))
"""Logarithm of the odds to begin with against the best of the poses that are tried where a frame
holds other things, too: some ten in each of some fifteen parts."""


def frame_odds(agreement: Agreement) -> float:
    """Logarithm of the odds for the target that one frame gives, 0 where it is silent."""
    pixels = agreement.agree + agreement.against
    if pixels <= 0:
        return 0.0
    share = agreement.agree / pixels
    patches = min(pixels / _PATCH_PIXELS, _MAX_PATCHES)
    chance, contradicted = _CHANCE, _CONTRADICTED
    if agreement.may_lack_a_part:
        chance, contradicted = _CHANCE_OF_PART, _CONTRADICTED_BY_PART
    favour = float(np.log((1.0 - contradicted) / chance))
    against = float(np.log((1.0 - chance) / contradicted))
    return patches * (share * favour - (1.0 - share) * against)


def novelty(before: Sequence[FloatArray], T_cam_model: FloatArray) -> float:
    """What a frame counts, 0 to 1, after those that showed the target at poses (4, 4 each)."""
    if not before:
        return 1.0
    # A pose that comes back to where it was shows nothing new.
    seen = np.stack([T[:3, :3] for T in before])
    turn = float(np.min(rotation_angle(np.swapaxes(seen, 1, 2) @ T_cam_model[:3, :3])))
    return min(_AGAIN + turn / _NEW_VIEW_RAD, 1.0)


def odds_over(frames: Iterable[tuple[FloatArray, Agreement]]) -> float:
    """The same of frames in order of time, each with its pose (4, 4)."""
    total = 0.0
    before: list[FloatArray] = []
    for T_cam_model, agreement in frames:
        total += novelty(before, T_cam_model) * frame_odds(agreement)
        before.append(T_cam_model)
    return total


def lead(a: Agreement, others: Sequence[Agreement]) -> float:
    """Log-likelihood of a pose over the best other pose in one frame; inf where there is none."""
    return NATS_PER_CONFLICT * (a.support - max((o.support for o in others), default=-np.inf))


class TrackOdds:
    """The odds for the target along a track."""

    def __init__(self, odds: float) -> None:
        """``odds`` with which it begins."""
        self._odds, self._last = _bounded(odds), 0.0
        self._before: tuple[FloatArray, ...] = ()

    def add(self, T_cam_model: FloatArray, agreement: Agreement) -> None:
        """Take in a frame that was explained so at a pose (4, 4)."""
        self._last = frame_odds(agreement)
        self._odds = _bounded(self._odds + novelty(self._before, T_cam_model) * self._last)
        self._before = (T_cam_model,)

    @property
    def is_clear(self) -> bool:
        """Whether it is the target beyond doubt, and the last frame alone does not refute that."""
        return self._odds > CLEAR_LEAD and self._last >= -CLEAR_LEAD

    @property
    def is_refuted(self) -> bool:
        """Whether it is something else beyond doubt."""
        return self._odds < -CLEAR_LEAD


def _bounded(odds: float) -> float:
    # What was sure once may turn out wrong, and be found again.
    return float(np.clip(odds, -2.0 * CLEAR_LEAD, 2.0 * CLEAR_LEAD))
