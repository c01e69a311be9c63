"""The tracker on a simulated sequence in memory, every frame of it judged by the truth."""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.spatial import log_rotation, rotation_angle
from pcnav.dynamics.inertia_parameters import parameters_from_ratios, ratios_jacobian
from pcnav.dynamics.state import INERTIA_RATIOS, STATE_SIZE, NavigationState
from pcnav.estimators.depth.tracker import Tracker
from pcnav.evaluation.bound import pose_jacobian
from pcnav.evaluation.metrics import squared_normalised_errors
from pcnav.recordings.sequence import Frame
from pcnav.runs.results import FrameEstimate
from pcnav.runs.status import Status
from pcnav.simulation.scenario import TrueMotion
from pcnav.simulation.scene import Scene
from pcnav.target.satellite import Target

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

    @property
    def pose_nees(self) -> FloatArray:
        """(n,) squared normalised error of the pose; six degrees of freedom."""
        return squared_normalised_errors(self.pose_error, self.pose_covariance)

    def nees(self, block: slice) -> FloatArray:
        """(n,) squared normalised error of a block of the state."""
        return squared_normalised_errors(
            self.state_error[:, block], self.covariance[:, block, block]
        )

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
    rows = []
    for frame in scene.frames(blind):
        started = time.process_time()
        estimate, _ = tracker.step(frame)
        seconds = time.process_time() - started
        on_frame(frame)
        rows.append(_judged(scene.motion, target, frame, estimate, seconds))
        if until_lock and estimate.status in CLAIMS:
            break
    return _joined(rows)


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


@dataclass(frozen=True)
class _JudgedFrame:
    """One frame of a `JudgedRun`."""

    time_s: float
    seconds: float
    estimate: FrameEstimate
    pose_error: FloatArray
    pose_covariance: FloatArray
    state_error: FloatArray
    covariance: FloatArray
    filter_nees: float


def _judged(
    motion: TrueMotion, target: Target, frame: Frame, estimate: FrameEstimate, seconds: float
) -> _JudgedFrame:
    k, n = frame.index, STATE_SIZE
    if estimate.state is None or estimate.covariance is None or estimate.T_cam_model is None:
        return _JudgedFrame(
            time_s=frame.time_s,
            seconds=seconds,
            estimate=estimate,
            pose_error=np.full(6, np.nan),
            pose_covariance=np.full((6, 6), np.nan),
            state_error=np.full(n, np.nan),
            covariance=np.full((n, n), np.nan),
            filter_nees=np.nan,
        )
    H = pose_jacobian(estimate.state, motion.T_cam_world[k], motion.R_hill_world[k])
    return _JudgedFrame(
        time_s=frame.time_s,
        seconds=seconds,
        estimate=estimate,
        pose_error=errors_of_pose(
            estimate.T_cam_model, motion.T_cam_model(k), target.symmetry_transforms
        ),
        pose_covariance=H @ estimate.covariance @ H.T,
        state_error=estimate.state.ratio_error(motion.states[k]),
        covariance=estimate.covariance,
        filter_nees=_filter_nees(estimate.state, motion.states[k], estimate.covariance),
    )


def _filter_nees(state: NavigationState, truth: NavigationState, covariance: FloatArray) -> float:
    """The stated covariance is the filter's, turned by a Jacobian: turning back loses nothing."""
    back = np.eye(STATE_SIZE)
    back[INERTIA_RATIOS, INERTIA_RATIOS] = np.linalg.inv(
        ratios_jacobian(parameters_from_ratios(state.inertia_ratios))
    )
    P = back @ covariance @ back.T
    return float(squared_normalised_errors(state.local(truth)[None], P[None])[0])


def _joined(frames: Sequence[_JudgedFrame]) -> JudgedRun:
    estimates = [frame.estimate for frame in frames]
    return JudgedRun(
        time_s=np.array([frame.time_s for frame in frames]),
        status=tuple(str(estimate.status) for estimate in estimates),
        seconds=np.array([frame.seconds for frame in frames]),
        nis=np.array([estimate.nis for estimate in estimates]),
        nis_dof=np.array([estimate.nis_dof for estimate in estimates], dtype=np.intp),
        inlier_ratio=np.array([estimate.inlier_ratio for estimate in estimates]),
        pose_error=np.stack([frame.pose_error for frame in frames]),
        pose_covariance=np.stack([frame.pose_covariance for frame in frames]),
        state_error=np.stack([frame.state_error for frame in frames]),
        covariance=np.stack([frame.covariance for frame in frames]),
        filter_nees=np.array([frame.filter_nees for frame in frames]),
    )
