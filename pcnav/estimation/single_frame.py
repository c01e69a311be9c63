"""The pose of a target from one depth frame alone: all of its faces, no motion model.

Hypothesis, expected view, measured faces, one update of the filter engine from a prior that says
nothing, and again with the view expected from the better pose. A bare pose is a navigation state
whose mass centre is the model's origin and whose camera is the world.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from pcnav.arrays import FloatArray
from pcnav.config import PerceptionMode, PerceptionTable
from pcnav.estimation.error_state import ErrorStateFilter
from pcnav.estimation.mass_centre import RectangleMeasurement
from pcnav.perception.acquisition import explained_share, pose_hypotheses
from pcnav.perception.association import MeasuredFace, measure_by_expectation, measure_by_size
from pcnav.perception.expectation import Expecter
from pcnav.perception.perceive import PerceivedFrame, perceive
from pcnav.spatial import log_rotation
from pcnav.state import R_HILL, STATE_SIZE, THETA_BODY, NavigationState
from pcnav.target import Target

_SEED = 0
"""Of RANSAC, which takes no part where a prediction knows the planes."""
_MOST_HYPOTHESES = 4
_LARGEST_LAG = 0.3
"""Hypotheses that explain so much less than the best one are not refined."""
_CONVINCING = 0.95
"""A refined pose that explains this share of the frame ends the search."""
_LEAST_EXPLAINED = 0.5
"""A pose that explains less of the frame than this is not believed."""
_DEPTH_TOLERANCE_SIGMA = 3.0
"""A refined pose must explain depths to the noise alone."""
_PASSES = 3
"""Most times the expected view is rendered anew."""
_POSITION_SD_FRACTION = 1.0
_ATTITUDE_SD_RAD = 1.0
"""Prior about the hypothesis, the position over the diameter: so wide that it decides nothing."""
_HELD_SD = 1e-9
"""Deviation of the parts of the state that are no pose: they stay where they are."""
_GATE_PROBABILITY = 0.9999
_STILL_SHARE = 1.0
"""A pass that moves every component by less than this share of its deviation is the last."""
_POSE = np.r_[R_HILL, THETA_BODY]


@dataclass(frozen=True)
class SingleFramePose:
    """A pose and what it rests on."""

    T_cam_model: FloatArray
    """(4, 4)"""
    covariance: FloatArray
    """(6, 6) of the model origin (m, camera axes) and the attitude error (rad, model axes)."""
    explained: float
    """Share of the frame that the target rendered at the pose explains; nan where not rendered."""
    used: tuple[str, ...]
    """Names of the rectangles it was fused from."""
    rejected: tuple[str, ...]
    """Rectangles that contradict the others."""
    converged: bool
    """Whether expecting the view anew moved the pose no more."""


def single_frame_pose(
    perceived: PerceivedFrame,
    target: Target,
    expecter: Expecter,
    settings: PerceptionTable,
    range_sigma_m: float,
) -> SingleFramePose | None:
    """Pose of the target in one frame without any prediction; None when none can be believed.

    The hypotheses that explain most are each refined, and the pose that then explains most of the
    frame is taken. In area-weighted mode the frame is read again from every better pose, which
    knows the planes that RANSAC may have missed or made up; in paper mode faces are those RANSAC
    found.
    """
    best: SingleFramePose | None = None
    hypotheses = pose_hypotheses(perceived, target, expecter, range_sigma_m)
    for hypothesis in hypotheses[:_MOST_HYPOTHESES]:
        if hypothesis.explained < hypotheses[0].explained - _LARGEST_LAG:
            break
        refined = refine_pose(
            hypothesis.T_cam_model, perceived, target, expecter, settings, range_sigma_m
        )
        if refined is not None and (best is None or refined.explained > best.explained):
            best = refined
        if best is not None and best.explained > _CONVINCING:
            break
    return best if best is not None and best.explained >= _LEAST_EXPLAINED else None


def refine_pose(
    T_cam_model: FloatArray,
    perceived: PerceivedFrame,
    target: Target,
    expecter: Expecter,
    settings: PerceptionTable,
    range_sigma_m: float,
) -> SingleFramePose | None:
    """The pose that the faces measured about a hypothesis (4, 4) give; None when there are none."""
    estimate: SingleFramePose | None = None
    converged = False
    for _ in range(_PASSES):
        faces, perceived = _faces(perceived, target, expecter, settings, range_sigma_m, T_cam_model)
        if not faces:
            break
        before, estimate = estimate, fuse_faces(faces, T_cam_model, target.diameter_m)
        T_cam_model = estimate.T_cam_model
        converged = before is not None and _is_still(before, estimate)
        if converged:
            break
    if estimate is None:
        return None
    rendered = expecter.render(T_cam_model).depth_m
    tolerance = _DEPTH_TOLERANCE_SIGMA * range_sigma_m
    explained = explained_share(perceived.frame.depth_m, rendered, tolerance)
    return replace(estimate, explained=explained, converged=converged)


def fuse_faces(
    faces: Sequence[MeasuredFace], T_cam_model: FloatArray, diameter_m: float
) -> SingleFramePose:
    """The pose that fits measured faces best.

    While there are three or more, the one that contradicts the rest most, beyond the 99.99 % gate,
    is left out; of two that disagree none can be called wrong.

    Args:
        faces: at least one.
        T_cam_model: (4, 4) where to start.
        diameter_m: of the target; the scale of the prior.
    """
    used = list(faces)
    rejected: list[str] = []
    while len(used) > 2:
        excess = [_contradiction(used, k, T_cam_model, diameter_m) for k in range(len(used))]
        worst = int(np.argmax(excess))
        if excess[worst] <= 1.0:
            break
        rejected.append(used.pop(worst).rectangle.name)
    kalman = _fused(used, T_cam_model, diameter_m)
    covariance = kalman.covariance[np.ix_(_POSE, _POSE)]
    names = tuple(face.rectangle.name for face in used)
    pose = kalman.state.T_cam_model(np.eye(4), np.eye(3))
    return SingleFramePose(pose, covariance, float("nan"), names, tuple(rejected), converged=False)


def _faces(
    perceived: PerceivedFrame,
    target: Target,
    expecter: Expecter,
    settings: PerceptionTable,
    range_sigma_m: float,
    T_cam_model: FloatArray,
) -> tuple[list[MeasuredFace], PerceivedFrame]:
    """The faces measured given a pose, and the frame as read for them."""
    if settings.mode is PerceptionMode.PAPER:
        return measure_by_size(perceived, T_cam_model)[0], perceived
    expectation = expecter.expect(T_cam_model)
    perceived = perceive(
        perceived.frame,
        target.rectangles,
        settings,
        range_sigma_m,
        _SEED,
        expectation.surface,
    )
    return measure_by_expectation(perceived, expectation, settings.size_gate_sigma)[0], perceived


def _contradiction(
    faces: list[MeasuredFace], index: int, T_cam_model: FloatArray, diameter_m: float
) -> float:
    """Squared innovation of one face against the pose of all others, over its gate."""
    others = _fused([f for k, f in enumerate(faces) if k != index], T_cam_model, diameter_m)
    squared, degrees = others.innovation(_measurement(faces[index]))
    return squared / float(chi2.ppf(_GATE_PROBABILITY, degrees))


def _fused(
    faces: Sequence[MeasuredFace], T_cam_model: FloatArray, diameter_m: float
) -> ErrorStateFilter[NavigationState]:
    state = NavigationState(
        r_hill=T_cam_model[:3, 3],
        v_hill=np.zeros(3),
        com_model=np.zeros(3),
        R_world_body=T_cam_model[:3, :3],
        omega_body=np.zeros(3),
        inertia_ratios=np.array([1.0, 1.0, 0.0, 0.0, 0.0]),
    )
    sd = np.full(STATE_SIZE, _HELD_SD)
    sd[R_HILL], sd[THETA_BODY] = _POSITION_SD_FRACTION * diameter_m, _ATTITUDE_SD_RAD
    # The prior is no knowledge that a measurement could contradict: nothing is gated against it.
    kalman = ErrorStateFilter(
        state, np.diag(sd**2), gate_probability=1.0 - 1e-15, most_iterations=10
    )
    kalman.update([_measurement(face) for face in faces])
    return kalman


def _measurement(face: MeasuredFace) -> RectangleMeasurement:
    return RectangleMeasurement(
        rectangle=face.rectangle.name,
        T_model_rect=face.rectangle.T_model_rect,
        T_cam_rect=face.T_cam_rect,
        known=face.known,
        full_covariance=face.covariance,
        T_cam_hill=np.eye(4),
        R_hill_world=np.eye(3),
    )


def _is_still(before: SingleFramePose, after: SingleFramePose) -> bool:
    sd = np.sqrt(np.diag(after.covariance))
    shift = after.T_cam_model[:3, 3] - before.T_cam_model[:3, 3]
    turn = log_rotation(before.T_cam_model[:3, :3].T @ after.T_cam_model[:3, :3])
    return bool(np.all(np.abs(np.concatenate([shift, turn])) < _STILL_SHARE * sd))
