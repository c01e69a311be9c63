"""The evidence for and against a track."""

from collections import deque

import numpy as np

from pcnav.core import chi_square
from pcnav.filtering.error_state import UpdateResult
from pcnav.runs.nis_window import NisWindow

_LOW_INLIER_RATIO = 0.9
"""A track whose mean over the window is lower is doubtful."""
_WINDOW_FRAMES = 5
_MAX_DROP = 0.02
"""So is one whose ratio falls by so much: by more than noise moves it."""
_MEMORY_FRAMES = 20
"""Over about so many frames a track's usual ratio is taken."""
_PREDICTED_SHARE = 0.08
"""What a filter leads to explains at most so much less of a frame than poses fitted to each of the
frames that it was begun with; a filter that is led astray at once explains less."""
_STRAINED = 0.5
"""Share of a frame's measured components that is accepted."""
_NIS_PROBABILITY = 1e-6
"""So improbable must the innovations of the window be for the track to be doubtful."""


class Evidence:
    """What the last frames say for and against a track."""

    def __init__(self, start_inlier_ratio: float = float("nan")) -> None:
        """``start_inlier_ratio``: of the frames that the track was begun with, if they tell what
        share of the next ones is explained."""
        self._inlier_ratios: deque[float] = deque(maxlen=_WINDOW_FRAMES)
        self._innovations = NisWindow()
        self._least_at_first = start_inlier_ratio - _PREDICTED_SHARE
        self._usual = float("nan")
        self._usual_accepted = 0.0
        self._fell = False

    def add(self, inlier_ratio: float, result: UpdateResult) -> None:
        """Take in an update: inlier ratio of the frame, and innovations."""
        self._inlier_ratios.append(inlier_ratio)
        # Of the first frames nothing is usual yet but what the start explained.
        least = self._usual - _MAX_DROP
        if len(self._inlier_ratios) < _WINDOW_FRAMES:
            least = float(np.fmax(least, self._least_at_first))
        self._fell = bool(inlier_ratio < least)
        if np.isnan(self._usual):
            self._usual = inlier_ratio
        self._usual += (inlier_ratio - self._usual) / _MEMORY_FRAMES
        self._usual_accepted += (_accepted(result) - self._usual_accepted) / _MEMORY_FRAMES
        self._innovations.add(result.joint_nis, result.joint_dof)

    @property
    def usual_inlier_ratio(self) -> float:
        """Of the track's frames; nan without any."""
        return self._usual

    def is_strained(self, result: UpdateResult) -> bool:
        """Whether a frame was refused for the most part, which most of the track's are not."""
        return _accepted(result) < _STRAINED < self._usual_accepted

    @property
    def window_nis(self) -> float:
        """NIS over its degrees of freedom, over the last frames; nan without any."""
        return self._innovations.per_degree

    @property
    def explains_little(self) -> bool:
        """Whether the last frame is explained less than was usual, or little of the last ones."""
        if self._fell:
            return True
        little = float(np.mean(self._inlier_ratios or (1.0,))) < _LOW_INLIER_RATIO
        return self._is_whole and little

    @property
    def errs(self) -> bool:
        """Whether the innovations of the last frames are larger than they could be by chance."""
        nis, dof = self._innovations.nis, self._innovations.dof
        if not self._is_whole or not dof:
            return False
        return bool(nis > chi_square.upper_quantile(_NIS_PROBABILITY, dof))

    @property
    def is_doubtful(self) -> bool:
        """Whether the track is to be checked: its inlier ratio is too low, or its innovations too
        large."""
        return self.explains_little or self.errs

    @property
    def _is_whole(self) -> bool:
        return len(self._inlier_ratios) >= _WINDOW_FRAMES


def _accepted(result: UpdateResult) -> float:
    """Share of the measured components that passed the gate."""
    used = sum(dof for dof, ok in zip(result.dof, result.accepted, strict=True) if ok)
    return used / max(sum(result.dof), 1)
