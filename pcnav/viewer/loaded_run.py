"""A loaded run: all that the view shows of it, whatever estimated it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import make_transform, transform_points
from pcnav.dynamics.blocks import ATTITUDE, CENTRE, POSITION, RATE, RATIOS, Block
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.trajectory import Trajectory
from pcnav.evaluation.errors import Errors, match_times
from pcnav.runs.feature_outcomes import FeatureOutcomes
from pcnav.runs.records import RectangleRecord
from pcnav.runs.run import FeatureTable, Run
from pcnav.runs.status import CLAIMED
from pcnav.target.satellite import Target
from pcnav.viewer.events import Event, events_of, merged
from pcnav.viewer.frames import FrameStore
from pcnav.viewer.future import FuturePose, future_poses
from pcnav.viewer.glyphs import SIGMAS, seen_magnification
from pcnav.viewer.render_options import Layer
from pcnav.viewer.tracks_picture import TrackedImages

Records = Mapping[float, tuple[RectangleRecord, ...]]
"""By time."""
CameraAttitude = Callable[[FloatArray], FloatArray]
"""(n, 3, 3) R_cam_world at times (n,)."""

STORED_COVARIANCES = (POSITION, CENTRE)
"""Blocks drawn as ellipsoids. The rest of a long run's covariances, 3 kB a frame, is not kept."""
_SHOWN_AT_M = 4.0
"""A target whose distance nobody knows is drawn so far in front of the camera."""


@dataclass(frozen=True)
class StateVerdict:
    """What the run's knowledge.csv says of one state, or of a combination of states."""

    unit: str
    prior_sd: float
    posterior_sd: float
    from_data: bool


@dataclass(frozen=True)
class LoadedRun:
    """One run. What its estimator does not say is None or empty."""

    run: Run
    target: Target | None = None
    frames: FrameStore | None = None
    """None when the frames are no longer on disk: the states alone are then shown."""
    orbit: KeplerOrbit = field(default_factory=lambda: KeplerOrbit(0.0))
    """The chaser's."""
    camera: CameraAttitude | None = None
    """Of a run that knows no place of the target; None for a camera at rest."""
    errors: Errors | None = None
    """Against the truth, as in metrics.json; None without a truth."""
    records: Records = field(default_factory=dict)
    verdicts: Mapping[str, StateVerdict] = field(default_factory=dict)
    """By column of states.csv; empty for a run that is not finished."""
    notes: tuple[str, ...] = ()
    """What a user should know before looking at it."""
    covariances: Mapping[str, FloatArray] = field(default_factory=dict)
    """(n, 3, 3) by name of those `STORED_COVARIANCES` that are known; else the deviations have to
    do."""
    points_body: FloatArray | None = None
    """(m, 3) estimated points of a target without a model, body axes, m."""

    features: FeatureTable | None = None
    """How often the points that were tracked were used."""
    outcomes: Mapping[float, FeatureOutcomes] = field(default_factory=dict)
    """By time, what became of the features seen."""
    tracked: TrackedImages | None = None
    """What a camera saw; None of runs on depth frames."""

    def __len__(self) -> int:
        return len(self.run)

    @property
    def name(self) -> str:
        """What it is called."""
        return self.run.name

    def outcomes_at(self, frame: int) -> FeatureOutcomes | None:
        """Of the features of a frame; None where it is not told."""
        return self.outcomes.get(float(self.run.time_s[frame]))

    def frame_outcome(self, frame: int) -> str:
        """What the estimator says became of a frame; empty of one that says nothing."""
        words = self.run.words.get("outcome")
        return "" if words is None else words[frame]

    @property
    def trajectory(self) -> Trajectory:
        """What was estimated."""
        return self.run.trajectory

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """What happened, in the order of time."""
        return events_of(self.run, self.records, self.outcomes)

    @cached_property
    def T_cam_model(self) -> FloatArray:
        """(n, 4, 4) where the target is drawn, nan where there is no estimate: before the camera
        where its place is not known. Without a model it is that of the body axes."""
        if self.trajectory.T_cam_target is not None:
            return self.trajectory.T_cam_target
        known = self.run.has_estimate
        R = self.trajectory[ATTITUDE][known]
        if self.camera is not None and len(R):
            R = self.camera(self.run.time_s[known]) @ R
        T = np.full((len(self), 4, 4), np.nan)
        T[known] = make_transform(R, np.broadcast_to([0.0, 0.0, _SHOWN_AT_M], (len(R), 3)))
        return T

    def pose(self, frame: int) -> FloatArray | None:
        """(4, 4) of `T_cam_model`; None without an estimate."""
        return np.asarray(self.T_cam_model[frame]) if self.run.has_estimate[frame] else None

    @cached_property
    def future(self) -> Mapping[float, FuturePose] | None:
        """By the time ahead of the last estimate; None where it cannot be told."""
        known = np.flatnonzero(self.run.has_estimate)
        if self.target is None or self.run.folder is None or not self.run.is_finished:
            return None
        return future_poses(self.run.folder, self.T_cam_model[known[-1]]) if known.size else None

    @cached_property
    def com_model(self) -> FloatArray:
        """(n, 3) mass centre; the origin of a target without a model."""
        return self.trajectory[CENTRE] if self.has(CENTRE) else np.zeros((len(self), 3))

    @cached_property
    def size_m(self) -> float:
        """How large the target is, roughly."""
        if self.target is not None:
            return self.target.diameter_m
        if self.points_body is not None and len(self.points_body):
            return float(2.0 * np.linalg.norm(self.points_body, axis=1).max())
        return 1.0

    @cached_property
    def max_rate(self) -> float:
        """The fastest the target turns, rad/s; 1 when it is not known to turn."""
        if not self.has(RATE):
            return 1.0
        rates = np.linalg.norm(self.trajectory[RATE], axis=1)
        known = rates[np.isfinite(rates)]
        return float(known.max()) if known.size and known.max() > 0.0 else 1.0

    @cached_property
    def layers(self) -> frozenset[Layer]:
        """The layers that it has anything for."""
        has_rectangles = "n_rectangles" in self.run.notes
        needs = {
            Layer.POINTS: self.frames is not None,
            Layer.SENSOR: self.frames is not None,
            Layer.ACCEPTED: has_rectangles,
            Layer.REJECTED: has_rectangles,
            Layer.NAMES: has_rectangles,
            Layer.MESH: self.target is not None,
            Layer.TRUTH: self.target is not None and self._true_poses is not None,
            Layer.COM: self.has(CENTRE),
            Layer.POSITION: self.has(POSITION),
            Layer.TRAIL: self.trajectory.T_cam_target is not None,
            Layer.ATTITUDE: self.has(ATTITUDE),
            Layer.RATE: self.has(RATE),
            Layer.PRINCIPAL: self.has(RATIOS),
            Layer.MOMENTUM: self.has(RATIOS),
        }
        return frozenset(layer for layer in Layer if needs.get(layer, True))

    @property
    def opening_frame(self) -> int:
        """The last frame that is claimed, else the first with an estimate, else the first."""
        claimed = np.flatnonzero([status in CLAIMED for status in self.run.status])
        known = np.flatnonzero(self.run.has_estimate)
        return int(claimed[-1]) if claimed.size else int(known[0]) if known.size else 0

    def has(self, block: Block) -> bool:
        """Whether a quantity is estimated."""
        return block in self.trajectory

    def sd(self, block: Block, frame: int) -> FloatArray:
        """(k,) standard deviations of a block at a frame; nan where none are known."""
        return np.asarray(self.trajectory.sd_of(block)[frame])

    def error(self, block: Block) -> FloatArray | None:
        """(n, k) true minus estimated; None where the truth does not know it."""
        if self.errors is None:
            return None
        error = self.errors.state.get(block.name)
        if block is POSITION and not self.has(POSITION):
            error = self.errors.p_cam_m
        if block is ATTITUDE:
            error = self.attitude_error_rad
        return error if error is not None and np.isfinite(error).any() else None

    @cached_property
    def attitude_error_rad(self) -> FloatArray | None:
        """(n, 3) rotation vector; None without a truth."""
        if self.errors is None:
            return None
        # A truth of poses alone knows it, too; where axes are defined there is no error.
        error, of_pose = self.errors.state.get(ATTITUDE.name), self.errors.theta_model_rad
        error = of_pose if error is None else np.where(np.isnan(error), of_pose, error)
        if self.errors.defines_axes is None:
            return error
        return np.where(self.errors.defines_axes[:, None], np.nan, error)

    def records_at(self, frame: int) -> tuple[RectangleRecord, ...]:
        """What became of the rectangles of a frame."""
        return self.records.get(float(self.run.time_s[frame]), ())

    def true_pose(self, frame: int | None) -> FloatArray | None:
        """(4, 4) T_cam_model of the truth at a frame; None where it is not known."""
        if frame is None or self._true_poses is None:
            return None
        T = np.asarray(self._true_poses[frame])
        return T if np.isfinite(T).all() else None

    @property
    def _true_poses(self) -> FloatArray | None:
        return None if self.errors is None else self.errors.truth.T_cam_target

    def nearest_frame(self, time_s: float) -> int | None:
        """The frame at a time, to within half of the usual distance of frames."""
        if not len(self):
            return None
        steps = np.diff(self.run.time_s)
        half = 0.5 * float(np.median(steps)) if steps.size else 0.5
        row = int(match_times(np.array([time_s]), self.run.time_s, half * (1.0 + 1e-9))[0])
        return None if row < 0 else row

    def magnification(self, frame: int) -> float:
        """By how much the doubts of a frame have to be magnified to be seen."""
        known = [block for block in (POSITION, CENTRE) if self.has(block)]
        radius_m = SIGMAS * max(
            (float(np.linalg.norm(self.sd(block, frame))) for block in known), default=np.nan
        )
        return seen_magnification(radius_m, self.size_m) if np.isfinite(radius_m) else 1.0

    @cached_property
    def centres(self) -> FloatArray:
        """(m, 3) the mass centre in the camera at the frames that have an estimate."""
        known = self.run.has_estimate
        p_model = self.com_model[known][:, None]
        return np.asarray(transform_points(self.T_cam_model[known], p_model)[:, 0])

    def centre(self, frame: int) -> FloatArray:
        """(3,) the mass centre in the camera at a frame, or at the nearest that has an estimate."""
        known = np.flatnonzero(self.run.has_estimate)
        if not known.size:
            return np.array([0.0, 0.0, 10.0])
        return np.asarray(self.centres[np.argmin(np.abs(known - frame))])

    def viewpoint(self, frame: int) -> tuple[FloatArray, FloatArray]:
        """A place (3,) to look at the target from, aside of the chaser, and its centre (3,)."""
        centre = self.centre(frame)
        return centre + 1.9 * self.size_m * np.array([0.75, -0.45, -0.5]), centre

    def position_spread_cam(self, frame: int) -> FloatArray:
        """(3, 3) covariance of the mass centre's position, camera axes, m^2."""
        R_cam_world = self.T_cam_model[frame, :3, :3] @ self.trajectory[ATTITUDE][frame].T
        R = R_cam_world @ self.orbit.R_hill_world(float(self.run.time_s[frame])).T
        return np.asarray(R @ self.covariance(POSITION, frame) @ R.T)

    def covariance(self, block: Block, frame: int) -> FloatArray:
        """(3, 3) of one of `STORED_COVARIANCES`, SI."""
        if block.name in self.covariances:
            return np.asarray(self.covariances[block.name][frame])
        return np.diag(self.sd(block, frame) ** 2)


@dataclass(frozen=True)
class Snapshot:
    """The runs as of now."""

    runs: tuple[LoadedRun, ...]
    number: int
    """Grows with every change."""
    is_live: bool
    """Whether more frames are to come."""


def all_events(runs: tuple[LoadedRun, ...]) -> tuple[Event, ...]:
    """The events of all runs, at the frames of the first that are nearest in time."""
    first_s = runs[0].run.time_s
    if not len(first_s):
        return ()
    middles = 0.5 * (first_s[1:] + first_s[:-1])
    at = [np.searchsorted(middles, loaded.run.time_s) for loaded in runs]
    return merged([loaded.events for loaded in runs], at)


Source = Callable[[], Snapshot]
"""Gives the newest snapshot at any time, to any thread."""


def finished(*runs: LoadedRun) -> Source:
    """Runs that do not change."""
    snapshot = Snapshot(runs, 0, is_live=False)
    return lambda: snapshot
