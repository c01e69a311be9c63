"""The pose that fits one frame: compared with its rendered view, moved, compared again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TypeVar

import numpy as np

from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.estimators.depth.pose_measurement import moved_pose, pose_error, square_root
from pcnav.filtering.error_state import innovation_gate
from pcnav.perception.agreement import Agreement
from pcnav.perception.face_evidence import FaceEvidence
from pcnav.perception.modality import POSE_SIZE, Evidence
from pcnav.perception.render_compare import Comparison, RenderComparer, never
from pcnav.target.row_motion import Readout

_MAX_PASSES = 8
_STEP_ERROR = 0.1
"""A step is right to this share of itself: the comparison is linear, the view is not."""
_STILL_SHARE = 0.5
"""A step of less than this many standard deviations is the last."""
GATE_PROBABILITY = 0.9999
"""Of a face against the others of its frame."""

F = TypeVar("F")


@dataclass(frozen=True)
class SingleFramePose:
    """A pose fitted to one frame, and what it rests on."""

    T_cam_model: FloatArray
    """(4, 4)"""
    covariance: FloatArray
    """(6, 6) of its error, as `pose_error`."""
    agreement: Agreement
    """Of the frame with the target rendered at the pose, or at most a small step away."""
    used: tuple[str, ...]
    rejected: tuple[str, ...]
    """Names of the faces that agree, and of those that contradict the others."""
    converged: bool
    """Whether a view predicted from it would move it no more."""
    comparison: Comparison | None = None
    """The last one, where the pose was fitted by comparison."""
    motion: Readout | None = None
    """How the target moves in the frame, where that shows in it."""

    @property
    def inlier_ratio(self) -> float:
        """Of the frame; nan where not rendered."""
        return self.agreement.inlier_ratio


def fit_pose(
    depth_m: DepthImage,
    T_cam_model: FloatArray,
    covariance: FloatArray,
    comparer: RenderComparer,
    *,
    spread: FloatArray | None = None,
    goes_on: Callable[[FloatArray], bool] = lambda _: True,
    is_beaten: Callable[[Agreement], bool] = never,
) -> SingleFramePose | None:
    """Fit a pose to a frame, starting from a guess; None when nothing of the guess is seen.

    Args:
        depth_m: (height, width) the frame.
        T_cam_model: (4, 4) the guess, also the mean of a prior.
        covariance: (6, 6) of the guess; wide where it should not decide.
        comparer: of the target and the camera.
        spread: (6, 6) how far the guess may really be off, where that is less than its prior.
        goes_on: whether a pose (4, 4) that a pass came to is worth another pass.
        is_beaten: whether a pose that explains a frame so, after a first pass, is given up.
    """
    prior = np.asarray(np.linalg.inv(covariance))
    guess, pose = T_cam_model, T_cam_model
    spread = covariance if spread is None else spread
    fit: SingleFramePose | None = None
    before: Agreement | None = None
    for _ in range(_MAX_PASSES):
        # The first is of a guess: how much a pass gains is known after it.
        hopeless = never if before is None else partial(_is_hopeless, is_beaten, before)
        comparison = comparer.compare(depth_m, pose, spread, hopeless)
        before = comparison.agreement
        if not comparison.faces:
            return None if fit is None else replace(fit, agreement=comparison.agreement)
        faces = agreeing(comparison.faces, spread, comparer.lever_m)
        seen = Evidence.together((face.joint for face in faces), comparer.noise.n_shared).of_pose
        information = prior + seen.information
        vector = prior @ pose_error(pose, guess) + seen.vector
        posterior = np.asarray(np.linalg.inv(information))
        step = posterior @ vector
        pose = moved_pose(pose, step)
        converged = bool(step @ information @ step < _STILL_SHARE**2 * len(step))
        kept = {id(face) for face in faces}
        fit = SingleFramePose(
            pose,
            posterior,
            comparison.agreement,
            tuple(face.name for face in faces),
            tuple(face.name for face in comparison.faces if id(face) not in kept),
            converged,
            comparison,
        )
        if converged or not goes_on(pose):
            break
        spread = posterior + step_doubt(step)
    return fit


def _is_hopeless(is_beaten: Callable[[Agreement], bool], before: Agreement, now: Agreement) -> bool:
    """Whether a pose would be beaten even if it gained as much again as in its last pass: one that
    is still on its way explains less than it will."""
    gained = max(now.support - before.support, 0)
    return is_beaten(replace(now, agree=now.agree + gained))


def _unweighed(face: FaceEvidence) -> FloatArray:
    """(6, 6) covariance of what errors that a face is not weighed by add to its vector."""
    if face.by_unweighed is None:
        return np.zeros((POSE_SIZE, POSE_SIZE))
    by_error = face.by_unweighed[:, :POSE_SIZE]
    return np.asarray(by_error.T @ by_error)


def step_doubt(step: FloatArray) -> FloatArray:
    """(6, 6) covariance of what is still wrong with a pose after a step (6,) from a bad one."""
    shift, turn = np.linalg.norm(step[:3]), np.linalg.norm(step[3:])
    return np.diag((_STEP_ERROR * np.repeat([shift, turn], 3)) ** 2)


def consistent(faces: Sequence[F], excess: Callable[[list[F]], list[float]]) -> list[F]:
    """The faces that agree on a pose.

    While there are three or more, the one that contradicts the rest most is left out; of two that
    disagree none can be called wrong. ``excess`` gives the squared innovation of each face against
    the pose of all others, over its gate.
    """
    used = list(faces)
    while len(used) > 2:
        beyond = excess(used)
        worst = int(np.argmax(beyond))
        if beyond[worst] <= 1.0:
            break
        used.pop(worst)
    return used


def agreeing(
    faces: Sequence[FaceEvidence], spread: FloatArray, lever_m: float
) -> list[FaceEvidence]:
    """The faces compared with a view that agree on a pose, which may be off by ``spread``."""
    prior = np.asarray(np.linalg.inv(spread))

    def excess(used: list[FaceEvidence]) -> list[float]:
        information = prior + sum(face.information for face in used)
        vector = np.asarray(sum(face.vector for face in used))
        unweighed = sum(_unweighed(face) for face in used)
        return [_contradiction(face, information, vector, unweighed, lever_m) for face in used]

    return consistent(faces, excess)


def _contradiction(
    face: FaceEvidence,
    information: FloatArray,
    vector: FloatArray,
    unweighed: FloatArray | float,
    lever_m: float,
) -> float:
    others = np.asarray(np.linalg.inv(information - face.information))
    rows, value = square_root(face.information, face.vector, lever_m)
    innovation = value - rows @ (others @ (vector - face.vector))
    of_others = others + others @ (unweighed - _unweighed(face)) @ others
    covariance = np.eye(len(value)) + rows @ of_others @ rows.T
    if face.by_unweighed is not None:
        by_error = face.by_unweighed[:, :POSE_SIZE].T
        considered = square_root(face.information, by_error, lever_m)[1]
        covariance = covariance + considered @ considered.T
    squared = float(innovation @ np.linalg.solve(covariance, innovation))
    return squared / innovation_gate(GATE_PROBABILITY, len(value))
