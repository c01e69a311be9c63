"""Which features are in a filter's state and how they fare: one book for every stereo estimator."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from pcnav.core.arrays import IntArray
from pcnav.core.errors import InputError
from pcnav.recordings.tracks import TrackFrame

V = TypeVar("V")


@dataclass(frozen=True)
class FeatureBook:
    """The features of the state; replaced, never changed."""

    features: tuple[int, ...] = ()
    """In the order of the state."""
    last_seen_s: dict[int, float] = field(default_factory=dict)
    last_used_s: dict[int, float] = field(default_factory=dict)
    rejections: dict[int, int] = field(default_factory=dict)
    """In a row."""
    frames_refused: int = 0
    """Frames in a row in which features were seen and none was used. A frame without any says
    nothing either way."""

    def slots(self, features: IntArray) -> IntArray:
        """(n,) places in the state of features; -1 for those not in it."""
        place = {name: slot for slot, name in enumerate(self.features)}
        return np.array([place.get(name, -1) for name in features.tolist()], dtype=np.intp)

    def noted(self, time_s: float, used: Sequence[int], rejected: Sequence[int]) -> "FeatureBook":
        """How the features fared in a frame."""
        return replace(
            self,
            last_seen_s=self.last_seen_s | dict.fromkeys((*used, *rejected), time_s),
            last_used_s=self.last_used_s | dict.fromkeys(used, time_s),
            rejections=self.rejections
            | dict.fromkeys(used, 0)
            | {name: self.rejections.get(name, 0) + 1 for name in rejected},
            frames_refused=0 if used else self.frames_refused + bool(rejected),
        )

    def rejected(self, frames: int) -> list[int]:
        """Features that were rejected in so many frames in a row, or more."""
        return [name for name in self.features if self.rejections.get(name, 0) >= frames]

    def without(self, names: Collection[int]) -> "FeatureBook":
        """Some of them forgotten."""
        return replace(
            self,
            features=tuple(name for name in self.features if name not in names),
            last_seen_s=_without(self.last_seen_s, names),
            last_used_s=_without(self.last_used_s, names),
            rejections=_without(self.rejections, names),
        )

    def added(self, time_s: float, names: Sequence[int]) -> "FeatureBook":
        """With new ones behind the others."""
        return replace(
            self,
            features=(*self.features, *names),
            last_seen_s=self.last_seen_s | dict.fromkeys(names, time_s),
            last_used_s=self.last_used_s | dict.fromkeys(names, time_s),
        )


def _without(values: dict[int, V], names: Collection[int]) -> dict[int, V]:
    return {name: value for name, value in values.items() if name not in names}


def check_frame(frame: TrackFrame, last_s: float | None) -> None:
    """Raises `InputError` unless a frame is later than the last and shows every feature once."""
    where = f"frame at {frame.time_s:g} s"
    if last_s is not None and not frame.time_s > last_s:
        expected = f"expected times in order, more than {last_s:g}"
        raise InputError(where, "time_s", expected)
    if len(np.unique(frame.features)) != len(frame.features):
        raise InputError(where, "feature", "expected every feature once")
