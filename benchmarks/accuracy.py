"""Pose errors and times of pcnav and its peers on the same frames."""

from dataclasses import dataclass

import numpy as np

from benchmarks.peers import METHODS, Method, Poses
from benchmarks.scenes import Case
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import rotation_angle
from pcnav.recordings.sequence import stated_or_default_sigma


@dataclass(frozen=True)
class Spread:
    """How an error norm is spread over frames."""

    median: float
    """nan without any frame."""
    p95: float

    @staticmethod
    def of(errors: FloatArray) -> "Spread":
        """Of the error norms (n,)."""
        if not errors.size:
            return Spread(np.nan, np.nan)
        return Spread(float(np.median(errors)), float(np.percentile(errors, 95)))


@dataclass(frozen=True)
class FrameTime:
    """Milliseconds a frame, from the depth image in memory to the pose."""

    mean: float
    median: float
    longest: float

    @staticmethod
    def of(seconds: FloatArray) -> "FrameTime":
        """Of the times (n,) of single frames."""
        ms = 1e3 * seconds
        return FrameTime(float(np.mean(ms)), float(np.median(ms)), float(np.max(ms)))


@dataclass(frozen=True)
class Score:
    """One method on one case."""

    method: Method
    position_mm: Spread
    """Of the model frame's origin."""
    attitude_deg: Spread
    frame_ms: FrameTime
    frames: int
    """Frames of the second half with a pose."""


@dataclass(frozen=True)
class CaseScores:
    """Every method on one case, scored over the second half of its frames."""

    satellite: str
    range_sigma_m: float
    first_frame: int
    """The first one of the second half."""
    last_frame: int
    compared: int
    """Frames of the second half in which every method has a pose: those with errors."""
    scores: tuple[Score, ...]

    @property
    def title(self) -> str:
        """Satellite and noise."""
        return f"{self.satellite}, range noise {self.range_sigma_m:g} m"

    def of(self, method: Method) -> Score:
        """The score of a method. Raises ``LookupError`` when it was not measured."""
        for score in self.scores:
            if score.method.name == method.name:
                return score
        raise LookupError(f"{self.title}: no score of {method.name}")


def score_case(case: Case, methods: tuple[Method, ...] = METHODS) -> CaseScores:
    """Errors of every method over the frames of the second half in which all have a pose.

    The first half lets every method settle, and libraries load and warm up. Times are those of
    every frame of the second half, with a pose or without.
    """
    answers = [method.estimate(case) for method in methods]
    has_pose = [np.isfinite(answer.T_cam_model).all(axis=(1, 2)) for answer in answers]
    count = len(case.frames)
    second_half = np.arange(count) >= count // 2
    compared = np.logical_and.reduce([second_half, *has_pose])
    return CaseScores(
        satellite=case.scene.name,
        range_sigma_m=stated_or_default_sigma(case.info),
        first_frame=count // 2,
        last_frame=count - 1,
        compared=int(compared.sum()),
        scores=tuple(
            _score(case, method, answer, second_half, compared)
            for method, answer in zip(methods, answers, strict=True)
        ),
    )


def _score(
    case: Case, method: Method, answer: Poses, second_half: BoolArray, compared: BoolArray
) -> Score:
    shift_m, turn_rad = _errors(
        case, method, answer.T_cam_model[compared], case.T_cam_model[compared]
    )
    has_pose = np.isfinite(answer.T_cam_model[second_half]).all(axis=(1, 2))
    return Score(
        method=method,
        position_mm=Spread.of(1e3 * shift_m),
        attitude_deg=Spread.of(np.rad2deg(turn_rad)),
        frame_ms=FrameTime.of(answer.seconds[second_half]),
        frames=int(has_pose.sum()),
    )


def _errors(
    case: Case, method: Method, estimated: FloatArray, truth: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Distance (n,), m, and angle (n,), rad, to the equivalent truth that fits best.

    A symmetric target may be followed in any of its equivalent attitudes, but in one throughout; a
    method without memory may take another in every frame.
    """
    if not len(truth):
        return np.empty(0), np.empty(0)
    options = [truth @ symmetry for symmetry in case.scene.target.symmetry_transforms]
    turns = np.stack([rotation_angle(_between(estimated, option)) for option in options])
    shifts = np.stack(
        [np.linalg.norm(estimated[:, :3, 3] - option[:, :3, 3], axis=1) for option in options]
    )
    if method.remembers:
        best = int(np.argmin(np.median(turns, axis=1)))
        return shifts[best], turns[best]
    chosen = turns.argmin(axis=0)[None]
    return np.take_along_axis(shifts, chosen, 0)[0], np.take_along_axis(turns, chosen, 0)[0]


def _between(T_from: FloatArray, T_to: FloatArray) -> FloatArray:
    """(n, 3, 3) rotation between the attitudes of poses (n, 4, 4)."""
    return np.asarray(np.swapaxes(T_from[:, :3, :3], 1, 2) @ T_to[:, :3, :3])
