"""Whether the frames of a start could tell where the target is: what no tracker can do better."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.estimators.depth.pose_fit import fit_pose
from pcnav.estimators.depth.target_odds import CLEAR_LEAD
from pcnav.perception.modality import Evidence
from pcnav.perception.render_compare import RenderComparer
from pcnav.recordings.sequence import stated_or_default_sigma
from pcnav.runs.status import WRONG_SHIFT_FRACTION, WRONG_TURN_RAD
from pcnav.simulation.depth import Scene
from pcnav.simulation.random_truth import Satellite
from pcnav.target.rendering import DepthRenderer

_KNOWN_SD_RAD, _KNOWN_SD_FRACTION = WRONG_TURN_RAD / 3.0, WRONG_SHIFT_FRACTION / 3.0
"""Deviations, the position's over the diameter, under which an error that makes a claim wrong is
one of three of them."""
_TIGHT_SD_FRACTION, _TIGHT_SD_RAD = 1e-3, 1e-3
_RIVAL_SD_FRACTION, _RIVAL_SD_RAD = 0.05, 0.1
"""Of the truth and of a rival, before they are compared with a frame."""
_MAX_SURPRISE = 4.0
"""Log-likelihood that a return costs that is none of the target's, or one that is missing."""
_CORRELATED = 4.0
"""So many pixels that differ are one: rims of a slightly wrong pose differ together."""
_REFINED_IN = (0.0, 1.0)
"""Frames, as shares of all, that rivals are fitted to ..."""
_JUDGED_EVERY = 3
"""... and the step between those that they are judged by."""


@dataclass(frozen=True)
class Knowledge:
    """What the frames together say of the target's pose when its motion is known."""

    attitude_sd_rad: float
    position_sd_fraction: float
    """The largest deviations at the truth, over all directions; the position's over the
    diameter."""
    lead: float
    """Log-likelihood of the truth over the best of its rivals, turned and fitted to the frames;
    infinite without one."""

    @property
    def decides(self) -> bool:
        """Whether a pose could be claimed."""
        return (
            self.attitude_sd_rad < _KNOWN_SD_RAD
            and self.position_sd_fraction < _KNOWN_SD_FRACTION
            and self.lead > CLEAR_LEAD
        )


def knowledge(scene: Scene, of: Satellite) -> Knowledge:
    """What the frames of a scene say of the target, by the information of each at the truth."""
    target = of.target
    sigma_m = stated_or_default_sigma(scene.info, None)
    comparer = RenderComparer(target, scene.pipeline.camera.pinhole, sigma_m)
    frames = [frame.depth_m for frame in scene.frames()]
    poses = list(scene.truth.poses)
    sd = [_TIGHT_SD_FRACTION * target.diameter_m] * 3 + [_TIGHT_SD_RAD] * 3
    each = [
        _information(comparer, depth_m, pose, np.diag(np.square(sd)))
        for depth_m, pose in zip(frames, poses, strict=True)
    ]
    weakest = np.linalg.eigvalsh(np.sum(each, axis=0))[:, 0]
    shift_sd, turn_sd = 1.0 / np.sqrt(np.maximum(weakest, 1e-12))
    some = slice(None, None, _JUDGED_EVERY)
    renderer = DepthRenderer(target.mesh, comparer.camera)
    likelihood = _Likelihood(renderer, frames[some], poses[some], sigma_m)
    return Knowledge(
        attitude_sd_rad=float(turn_sd),
        position_sd_fraction=float(shift_sd) / target.diameter_m,
        lead=_lead(comparer, likelihood, of),
    )


def _information(
    comparer: RenderComparer, depth_m: DepthImage, pose: FloatArray, covariance: FloatArray
) -> FloatArray:
    """(2, 3, 3) of one frame about the position, in model axes, and about the attitude, each
    whatever the other is."""
    faces = comparer.compare(depth_m, pose, covariance).faces
    if not faces:
        return np.zeros((2, 3, 3))
    seen = Evidence.together((face.joint for face in faces), comparer.noise.n_shared)
    of_pose = seen.of_pose.information
    turned = np.eye(6)
    turned[:3, :3] = pose[:3, :3]
    of_pose = turned.T @ of_pose @ turned
    parts = []
    for own, other in ((slice(0, 3), slice(3, 6)), (slice(3, 6), slice(0, 3))):
        across = of_pose[own, other]
        inverse = np.linalg.pinv(of_pose[other, other], hermitian=True)
        parts.append(of_pose[own, own] - across @ inverse @ across.T)
    return np.stack(parts)


@dataclass(frozen=True)
class _Likelihood:
    """Of poses that move with the truth."""

    renderer: DepthRenderer
    frames: list[DepthImage]
    poses: list[FloatArray]
    sigma_m: float

    def of(self, motion: FloatArray) -> float:
        """Logarithm, up to a constant, where the target is turned by a motion (4, 4) of the model
        frame in all frames."""
        pairs = zip(self.frames, self.poses, strict=True)
        return sum(self._of_frame(depth_m, pose @ motion) for depth_m, pose in pairs)

    def _of_frame(self, depth_m: DepthImage, pose: FloatArray) -> float:
        predicted = self.renderer.render(pose).depth_m
        both = (depth_m > 0.0) & (predicted > 0.0) & np.isfinite(predicted)
        either = (depth_m > 0.0) | ((predicted > 0.0) & np.isfinite(predicted))
        z = (depth_m[both] - predicted[both]) / self.sigma_m
        surprise = np.minimum(0.5 * z * z, _MAX_SURPRISE).sum()
        alone = np.count_nonzero(either) - np.count_nonzero(both)
        return -float(surprise + _MAX_SURPRISE * alone) / _CORRELATED


def _lead(comparer: RenderComparer, likelihood: _Likelihood, of: Satellite) -> float:
    target = of.target
    turns = target.rival_turns
    rivals = turns[~target.leave_no_trace(turns, 0.15, 0.1)]
    truth = likelihood.of(np.eye(4))
    sd = [_RIVAL_SD_FRACTION * target.diameter_m] * 3 + [_RIVAL_SD_RAD] * 3
    prior = np.diag(np.square(sd))
    leads = [np.inf]
    for turn in rivals:
        motions = [turn]
        for at in _REFINED_IN:
            k = round(at * (len(likelihood.frames) - 1))
            fit = fit_pose(likelihood.frames[k], likelihood.poses[k] @ turn, prior, comparer)
            if fit is not None:
                motion = np.linalg.inv(likelihood.poses[k]) @ fit.T_cam_model
                # What slid back to the truth is no rival.
                if not target.leave_no_trace(motion[None], 0.15, 0.1)[0]:
                    motions.append(motion)
        leads += [truth - likelihood.of(motion) for motion in motions]
    return float(min(leads))
