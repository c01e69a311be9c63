"""The tracker on a simulated sequence in memory, every frame of it judged by the truth."""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.spatial import log_rotation, rotation_angle
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT
from pcnav.dynamics.inertia_parameters import parameters_from_ratios, ratios_jacobian
from pcnav.dynamics.state import INERTIA_RATIOS, STATE_SIZE, NavigationState
from pcnav.estimators.depth.tracker import Tracker
from pcnav.evaluation.bound import pose_jacobian
from pcnav.evaluation.metrics import squared_normalised_errors
from pcnav.recordings.sequence import Frame
from pcnav.runs.collector import collected
from pcnav.runs.estimate import Estimate
from pcnav.runs.status import Status
from pcnav.simulation.depth import Scene
from pcnav.simulation.motion import TrueMotion
from pcnav.target.satellite import Target

from .blocks import ShownBlock

CLAIMS = frozenset({str(Status.LOCKED), str(Status.AMBIGUOUS)})
"""The statuses with which a tracker says that its pose can be relied on."""


@dataclass(frozen=True)
class JudgedRun:
    """What a tracker said in every frame, and how far off it was. nan without an estimate."""

    time_s: FloatArray
    """(n,)"""
    status: tuple[str, ...]
    seconds: FloatArray
    """(n,) of processor time that the tracker took."""
    nis: FloatArray
    """(n,)"""
    nis_dof: IntArray
    """(n,)"""
    inlier_ratio: FloatArray
    """(n,) share of the frame that the tracker says its pose explains."""
    rectangles: IntArray
    """(n,) accepted ones."""
    pose_error: FloatArray
    """(n, 6) true minus estimated model origin (m, camera axes) and the rotation from estimated to
    true attitude (rad, model axes), for the nearest of the target's equivalent attitudes."""
    pose_covariance: FloatArray
    """(n, 6, 6) of it, as the tracker states it."""
    state_error: FloatArray
    """(n, 20) true minus estimated state as `NavigationState.ratio_error`; of a symmetric target in
    whichever of its equivalent attitudes it was locked."""
    covariance: FloatArray
    """(n, 20, 20) of it, as the tracker states it."""
    filter_nees: FloatArray
    """(n,) squared normalised error of the whole state in the coordinates that the filter works in:
    those of `NavigationState.local`, which the ratios are a curved function of."""

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def claims(self) -> BoolArray:
        """(n,) frames called locked or ambiguous."""
        return np.array([word in CLAIMS for word in self.status])

    @property
    def position_m(self) -> FloatArray:
        """(n,) distance between true and estimated model origin."""
        return np.asarray(np.linalg.norm(self.pose_error[:, :3], axis=1))

    @property
    def attitude_rad(self) -> FloatArray:
        """(n,) angle between true and estimated attitude."""
        return np.asarray(np.linalg.norm(self.pose_error[:, 3:], axis=1))

    def is_within(self, angle_rad: float, distance_m: float) -> BoolArray:
        """(n,) frames whose pose is off by less than both."""
        return np.asarray((self.attitude_rad < angle_rad) & (self.position_m < distance_m))

    @property
    def pose_sd(self) -> FloatArray:
        """(n, 6) deviations of the pose."""
        return np.sqrt(np.diagonal(self.pose_covariance, axis1=1, axis2=2))

    @property
    def state_sd(self) -> FloatArray:
        """(n, 20) deviations of the state."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    @property
    def pose_nees(self) -> FloatArray:
        """(n,) squared normalised error of the pose; six degrees of freedom."""
        return squared_normalised_errors(self.pose_error, self.pose_covariance)

    def nees(self, block: ShownBlock) -> FloatArray:
        """(n,) squared normalised error of a block of the state."""
        return block.squared(self.state_error, self.covariance)

    @property
    def lock(self) -> int | None:
        """First frame called locked or ambiguous."""
        found = np.flatnonzero(self.claims)
        return int(found[0]) if found.size else None


def follow(
    scene: Scene,
    target: Target,
    *,
    blind: range = range(0),
    until_lock: bool = False,
    on_frame: Callable[[Frame], None] = lambda frame: None,
) -> JudgedRun:
    """Track a scene with the target as modelled.

    ``until_lock`` ends the run with the first frame called locked or ambiguous; ``on_frame`` is
    shown every frame that the tracker has taken in.
    """
    pipeline = scene.pipeline
    tracker = Tracker(target, scene.info, pipeline.perception, pipeline.filter, pipeline.seed)
    estimates, seconds = [], []
    for frame in scene.frames(blind):
        started = time.process_time()
        estimate = tracker.step(frame)
        seconds.append(time.process_time() - started)
        estimates.append(estimate)
        on_frame(frame)
        if until_lock and estimate.status in CLAIMS:
            break
    return _judged(scene.motion, target, estimates, seconds)


def errors_of_pose(
    T_cam_model: FloatArray, T_cam_model_true: FloatArray, symmetry_motions: FloatArray
) -> FloatArray:
    """(6,) error of a pose as in `JudgedRun.pose_error`; symmetry motions (n, 4, 4)."""
    equivalent = T_cam_model_true @ symmetry_motions
    turns = T_cam_model[:3, :3].T @ equivalent[:, :3, :3]
    nearest = int(np.argmin(rotation_angle(turns)))
    shift = equivalent[nearest, :3, 3] - T_cam_model[:3, 3]
    return np.concatenate([shift, log_rotation(turns[nearest])])


def status_sequence(status: Sequence[str]) -> str:
    """Statuses in order with how long each held: ``acquiring 3, locked 37``."""
    return ", ".join(f"{word} {len(list(same))}" for word, same in groupby(status))


def status_shares(runs: Sequence[JudgedRun]) -> str:
    """Shares of the statuses over all frames, most frequent first."""
    counts = Counter(word for run in runs for word in run.status)
    total = counts.total()
    return ", ".join(f"{word} {count / total:.1%}" for word, count in counts.most_common())


def _judged(
    motion: TrueMotion,
    target: Target,
    estimates: Sequence[Estimate],
    seconds: Sequence[float],
) -> JudgedRun:
    n, size = len(estimates), STATE_SIZE
    found = collected("depth", Tracker.output, estimates)
    run = JudgedRun(
        time_s=motion.truth.time_s[:n],
        status=found.status,
        seconds=np.array(seconds),
        nis=found.nis,
        nis_dof=found.nis_dof,
        inlier_ratio=found.notes["inlier_ratio"],
        rectangles=found.notes["n_rectangles"].astype(np.intp),
        pose_error=np.full((n, 6), np.nan),
        pose_covariance=np.full((n, 6, 6), np.nan),
        state_error=np.full((n, size), np.nan),
        covariance=np.full((n, size, size), np.nan),
        filter_nees=np.full(n, np.nan),
    )
    for k, estimate in enumerate(estimates):
        P, T_cam_model = estimate.covariance, estimate.T_cam_target
        if P is None or T_cam_model is None:
            continue
        state = NavigationState(*(estimate[block] for block in MASS_CENTRE_LAYOUT.blocks))
        truth, symmetries = motion.state(k), target.symmetry_transforms
        H = pose_jacobian(state, motion.T_cam_world[k], motion.R_hill_world[k])
        run.pose_error[k] = errors_of_pose(T_cam_model, motion.truth.poses[k], symmetries)
        run.pose_covariance[k] = H @ P @ H.T
        run.state_error[k] = state.ratio_error(truth)
        run.covariance[k] = P
        run.filter_nees[k] = _filter_nees(state, truth, P)
    return run


def _filter_nees(state: NavigationState, truth: NavigationState, covariance: FloatArray) -> float:
    """The stated covariance is the filter's, turned by a Jacobian: turning back loses nothing."""
    back = np.eye(STATE_SIZE)
    back[INERTIA_RATIOS, INERTIA_RATIOS] = np.linalg.inv(
        ratios_jacobian(parameters_from_ratios(state.inertia_ratios))
    )
    P = back @ covariance @ back.T
    return float(squared_normalised_errors(state.local(truth)[None], P[None])[0])
