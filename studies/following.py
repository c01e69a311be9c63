"""The tracker on a simulated sequence in memory, every frame of it judged by the truth."""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import groupby

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT, RATIOS
from pcnav.dynamics.state import INERTIA_RATIOS, NavigationState
from pcnav.estimators.depth.tracker import Tracker
from pcnav.estimators.interface import AxesPolicy
from pcnav.evaluation.bound import pose_jacobian
from pcnav.evaluation.consistency import over_trace, squared_normalised_errors
from pcnav.evaluation.errors import Errors, errors
from pcnav.recordings.sequence import Frame
from pcnav.runs.collector import collected
from pcnav.runs.run import Run
from pcnav.runs.status import CLAIMED, WRONG_SHIFT_FRACTION, WRONG_TURN_RAD
from pcnav.simulation.depth import Scene
from pcnav.target.satellite import Target

from .blocks import ShownBlock


@dataclass(frozen=True)
class JudgedRun:
    """What a tracker said in every frame, and how far off it was. nan without an estimate."""

    said: Run
    errors: Errors
    """From the nearest of the target's equivalent truths, in every frame."""
    seconds: FloatArray
    """(n,) of processor time that the tracker took."""
    pose_covariance: FloatArray
    """(n, 6, 6) of `pose_error`, as the tracker states it."""
    changed_parts: tuple[str, ...] = ()
    """That the tracker found not to be as in the mesh, after the last frame."""

    def __len__(self) -> int:
        return len(self.said)

    @property
    def time_s(self) -> FloatArray:
        """(n,)"""
        return self.said.time_s

    @property
    def claims(self) -> BoolArray:
        """(n,) frames called locked or ambiguous."""
        return np.array([word in CLAIMED for word in self.said.status])

    @property
    def lock(self) -> int | None:
        """First frame called locked or ambiguous."""
        found = np.flatnonzero(self.claims)
        return int(found[0]) if found.size else None

    @property
    def pose_error(self) -> FloatArray:
        """(n, 6) of the model origin (m, camera axes), and the rotation from estimated to true
        attitude (rad, model axes)."""
        return np.hstack([self.errors.p_cam_m, self.errors.theta_model_rad])

    @property
    def pose_sd(self) -> FloatArray:
        """(n, 6) deviations of it, as the tracker states them."""
        return np.sqrt(np.diagonal(self.pose_covariance, axis1=1, axis2=2))

    @property
    def pose_nees(self) -> FloatArray:
        """(n,) squared normalised error of the pose; six degrees of freedom."""
        return squared_normalised_errors(self.pose_error, self.pose_covariance)

    @property
    def position_m(self) -> FloatArray:
        """(n,) distance between true and estimated model origin."""
        return np.asarray(np.linalg.norm(self.errors.p_cam_m, axis=1))

    @property
    def attitude_rad(self) -> FloatArray:
        """(n,) angle between true and estimated attitude."""
        return np.asarray(np.linalg.norm(self.errors.theta_model_rad, axis=1))

    def is_within(self, angle_rad: float, distance_m: float) -> BoolArray:
        """(n,) frames whose pose is off by less than both."""
        return np.asarray((self.attitude_rad < angle_rad) & (self.position_m < distance_m))

    def is_right(self, target: Target) -> BoolArray:
        """(n,) frames whose pose is none that would make a claim a wrong lock."""
        return self.is_within(WRONG_TURN_RAD, WRONG_SHIFT_FRACTION * target.diameter_m)

    @property
    def state_error(self) -> FloatArray:
        """(n, 20) in the coordinates of the stated covariance."""
        return np.hstack([self.errors[block] for block in MASS_CENTRE_LAYOUT.blocks])

    @property
    def state_sd(self) -> FloatArray:
        """(n, 20) deviations of it, as the tracker states them."""
        assert self.said.trajectory.sd is not None, "the tracker states them"
        return self.said.trajectory.sd

    def nees(self, block: ShownBlock) -> FloatArray:
        """(n,) squared normalised error of a block of the state.

        The inertia is judged as results are, over its trace and not over one of its moments: while
        it is poorly known, a covariance that is right in the one is not in the other, which is a
        curved function of it.
        """
        error, covariance = self._over_trace
        return block.squared(error, covariance)

    @cached_property
    def _over_trace(self) -> tuple[FloatArray, FloatArray]:
        trajectory = self.said.trajectory
        assert trajectory.covariance is not None, "runs in memory have them"
        error = self.state_error
        return over_trace(error, trajectory.covariance, trajectory[RATIOS], INERTIA_RATIOS)


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
        estimates.append(tracker.step(frame))
        seconds.append(time.process_time() - started)
        on_frame(frame)
        if until_lock and estimates[-1].status in CLAIMED:
            break
    said = collected("depth", tracker.output, estimates)
    judged = _judged(scene, target, said, np.array(seconds))
    return replace(judged, changed_parts=tracker.changed_parts)


def status_sequence(status: Sequence[str]) -> str:
    """Statuses in order with how long each held: ``acquiring 3, locked 37``."""
    return ", ".join(f"{word} {len(list(same))}" for word, same in groupby(status))


def status_shares(runs: Sequence[Run]) -> str:
    """Shares of the statuses over all frames, most frequent first."""
    counts = Counter(word for run in runs for word in run.status)
    total = counts.total()
    return ", ".join(f"{word} {count / total:.1%}" for word, count in counts.most_common())


def _judged(scene: Scene, target: Target, said: Run, seconds: FloatArray) -> JudgedRun:
    motion, covariance = scene.motion, said.trajectory.covariance
    assert covariance is not None, "runs in memory have them"
    pose_covariance = np.full((len(said), 6, 6), np.nan)
    for k in np.flatnonzero(said.has_estimate).tolist():
        state, P = NavigationState.of(said.trajectory, k), covariance[k]
        H = pose_jacobian(state, motion.T_cam_world[k], motion.R_hill_world[k])
        pose_covariance[k] = H @ P @ H.T
    compared = errors(
        said,
        motion.truth,
        AxesPolicy.SYMMETRY_OF_FRAME,
        symmetry_transforms=target.symmetry_transforms,
        roundness=target.roundness,
    )
    return JudgedRun(said, compared, seconds, pose_covariance)
