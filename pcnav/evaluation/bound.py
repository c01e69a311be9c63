"""Posterior Cramer-Rao bounds: the covariance no tracker can beat on a given motion.

Tichavsky, Muravchik and Nehorai 1998, with the information of each frame taken at the true state:
that of the rays and of the outline, or as much of it as pcnav's own comparison takes up. The latter
bounds estimates from these comparisons only; other estimators may do better.
The error of a pose is (6,): translation of the model origin (m, camera axes), then rotation (rad,
model axes), ``p = p_hat + d``, ``R = R_hat exp(theta)``.
"""

from collections.abc import Callable
from functools import partial
from typing import Protocol

import numpy as np

from pcnav.config.depth import ModalityName
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import skew
from pcnav.dynamics.mass_prior import MassBelief
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    V_HILL,
    NavigationState,
    ratio_covariance,
)
from pcnav.estimators.depth.mass import prior_belief
from pcnav.estimators.depth.mass_centre import MassCentreModel
from pcnav.evaluation.ray_information import ray_information
from pcnav.filtering.error_state import MotionModel
from pcnav.perception.modality import Evidence
from pcnav.perception.render_compare import Comparison, RenderComparer
from pcnav.recordings.sequence import Frame, stated_or_default_sigma
from pcnav.simulation.depth import Scene
from pcnav.simulation.motion import TrueMotion
from pcnav.target.satellite import Target

PoseInformation = Callable[[int, FloatArray], FloatArray]
"""From a frame's index and the (6, 6) covariance with which its pose could be predicted to the
(6, 6) information (inverse covariance) that the frame carries about the error of its pose."""

_LOOSE_SD = ((R_HILL, 10.0), (V_HILL, 1.0), (THETA_BODY, 2.0), (OMEGA_BODY, 1.0))
"""What the bound knows of the motion before the first frame: nothing next to a frame, SI."""
_LOOKED_AGAIN_PX = 0.5
"""How far off the view is, at the rim of the target, that a frame is last compared with."""


def pose_jacobian(
    state: NavigationState, T_cam_world: FloatArray, R_hill_world: FloatArray
) -> FloatArray:
    """(6, 20) derivative of the error of the pose by the error of the state.

    The model origin is at ``R_cam_hill r - R_cam_body c``, c the mass centre; a turn theta of the
    body moves it by ``R_cam_body [c]x theta``.
    """
    R_cam_world = T_cam_world[:3, :3]
    R_cam_body = R_cam_world @ state.R_world_body
    jacobian = np.zeros((6, STATE_SIZE))
    jacobian[:3, R_HILL] = R_cam_world @ R_hill_world.T
    jacobian[:3, COM_MODEL] = -R_cam_body
    jacobian[:3, THETA_BODY] = R_cam_body @ skew(state.com_model)
    jacobian[3:, THETA_BODY] = np.eye(3)
    return jacobian


class PosteriorBound:
    """The bound carried along a true motion, frame by frame."""

    def __init__(
        self,
        model: MotionModel[NavigationState],
        motion: TrueMotion,
        prior_covariance: FloatArray,
    ) -> None:
        """The bound before the first frame.

        Args:
            model: whose transition, taken at the true states, carries the bound on, and whose
                process noise loosens it.
            motion: the truth.
            prior_covariance: (20, 20) before the first frame, in the model's error coordinates.
        """
        self._model, self._motion, self._P = model, motion, prior_covariance
        self._next = 0

    def step(self, information: Callable[[FloatArray], FloatArray]) -> FloatArray:
        """(20, 20) bound on the covariance of the state's error after the next frame.

        ``information`` is a `PoseInformation` of that frame.
        """
        k, motion = self._next, self._motion
        if k > 0:
            before = float(motion.truth.time_s[k - 1])
            step_s = float(motion.truth.time_s[k]) - before
            _, transition, noise = self._model.propagate(motion.state(k - 1), before, step_s)
            self._P = predicted(self._P, transition, noise)
        H = pose_jacobian(motion.state(k), motion.T_cam_world[k], motion.R_hill_world[k])
        self._P = informed(self._P, H, information(H @ self._P @ H.T))
        self._next += 1
        return self._P


class FrameInformation(Protocol):
    """From a frame, its true pose (4, 4) and the (6, 6) covariance with which that could be
    predicted to the (6, 6) information that the frame carries about the error of its pose."""

    def __call__(
        self, frame: Frame, T_true: FloatArray, pose_covariance: FloatArray, /
    ) -> FloatArray: ...


class SceneBound:
    """A bound of a simulated scene, with information of its own frames."""

    def __init__(self, scene: Scene, target: Target, information: FrameInformation) -> None:
        """``target`` as pcnav knows it; the tracker's prior of the mass is the bound's, too."""
        pipeline, self._motion = scene.pipeline, scene.motion
        self._information = information
        model = MassCentreModel(
            pipeline.orbit.mean_motion_rad_s,
            pipeline.filter.acceleration_psd_m2_s3,
            pipeline.filter.angular_acceleration_psd_rad2_s3,
        )
        belief = prior_belief(target, scene.info.initial, pipeline.filter)
        self._bound = PosteriorBound(model, self._motion, prior_covariance(belief))

    def step(self, frame: Frame) -> FloatArray:
        """(20, 20) after the next frame, of the error that `NavigationState.ratio_error` gives."""
        T_true = self._motion.truth.poses[frame.index]
        P = self._bound.step(partial(self._information, frame, T_true))
        return ratio_covariance(self._motion.state(frame.index), P)


def compared(scene: Scene, target: Target) -> FrameInformation:
    """What the tracker's comparison of a frame with its view takes up at the true pose."""
    compare = _at_truth(scene, target)

    def information(frame: Frame, T_true: FloatArray, pose_covariance: FloatArray) -> FloatArray:
        faces = compare(frame, T_true, pose_covariance).faces
        return np.asarray(sum((face.information for face in faces), np.zeros((6, 6))))

    return information


def of_rays(scene: Scene, target: Target) -> FrameInformation:
    """The ranges along all rays that meet the target (`ray_information`), and all of its outline.

    The outline is noiseless but for the pixel grid: the errors of its edges are those that the
    grid alone makes (`pcnav.perception.contour`).
    """
    compare, sigma_m = _at_truth(scene, target), stated_or_default_sigma(scene.info)
    has_outline = ModalityName.OUTLINE in scene.pipeline.perception.modalities

    def information(frame: Frame, T_true: FloatArray, pose_covariance: FloatArray) -> FloatArray:
        seen = compare(frame, T_true, pose_covariance).seen
        total = ray_information(seen.rendered, T_true, frame.depth_m > 0.0, sigma_m)
        if has_outline:
            runs = seen.contour
            total = total + Evidence.of(runs.value, runs.variance, runs.jacobian).information
        return total

    return information


def _at_truth(
    scene: Scene, target: Target
) -> Callable[[Frame, FloatArray, FloatArray], Comparison]:
    """Compares a frame with its true pose (4, 4), which is known to (6, 6)."""
    pipeline = scene.pipeline
    sigma_m, modalities = stated_or_default_sigma(scene.info), pipeline.perception.modalities
    comparer = RenderComparer(target, pipeline.camera.pinhole, sigma_m, modalities=modalities)

    def compare(frame: Frame, T_true: FloatArray, pose_covariance: FloatArray) -> Comparison:
        # A tracker looks again from the pose it found, so what it compares the frame with in the
        # end is within a pixel, however vague its prediction was.
        doubt_px = comparer.doubt_px(T_true, pose_covariance)
        share = min(1.0, _LOOKED_AGAIN_PX / doubt_px) ** 2
        return comparer.compare(frame.depth_m, T_true, share * pose_covariance)

    return compare


def prior_covariance(belief: MassBelief) -> FloatArray:
    """(20, 20) of the state's error before the first frame, in the filter's own parameters."""
    sd = np.zeros(STATE_SIZE)
    for block, value in _LOOSE_SD:
        sd[block] = value
    covariance = np.diag(sd**2)
    covariance[COM_MODEL, COM_MODEL] = belief.com_covariance_m2
    covariance[INERTIA_RATIOS, INERTIA_RATIOS] = belief.parameter_covariance
    return covariance


def predicted(covariance: FloatArray, transition: FloatArray, noise: FloatArray) -> FloatArray:
    """(n, n) bound one step later."""
    P = transition @ covariance @ transition.T + noise
    return np.asarray(0.5 * (P + P.T))


def informed(covariance: FloatArray, H: FloatArray, information: FloatArray) -> FloatArray:
    """(n, n) ``(P^-1 + H^T I H)^-1`` for an information I (m, m) that may be singular.

    I is written as ``L L^T``, that is as m measurements ``L^T H`` with unit noise; their update in
    Joseph's form needs no inverse of P and stays positive.
    """
    values, axes = np.linalg.eigh(0.5 * (information + information.T))
    whitened = (axes * np.sqrt(np.maximum(values, 0.0))).T @ H
    S = whitened @ covariance @ whitened.T + np.eye(len(whitened))
    gain = np.linalg.solve(S, whitened @ covariance).T
    kept = np.eye(len(covariance)) - gain @ whitened
    P = kept @ covariance @ kept.T + gain @ gain.T
    return np.asarray(0.5 * (P + P.T))
