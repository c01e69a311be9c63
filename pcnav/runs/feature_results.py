"""A run on feature tracks: its estimates over time, and the tables of its result folder.

The folder is that of a depth run with the states such an estimator has: no mass centre in a model
frame, no rectangles. Numbers are stored with all their digits; an empty field means "no value".
"""

import csv
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.spatial import make_transform, xyzw_from_rotation
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.state import COM_MODEL, STATE_SIZE
from pcnav.recordings.tracks import TrackFrame
from pcnav.recordings.truth import STATE_COLUMNS
from pcnav.runs.feature_estimate import FeatureEstimate, FeaturePoint, MotionEstimate
from pcnav.runs.results import COVARIANCES_FILE, NIS_WINDOW_FRAMES, POSES_FILE, STATES_FILE, Track

FEATURES_FILE = "features.csv"

ERROR_SIZE = 17
R_HILL, V_HILL = slice(0, 3), slice(3, 6)
THETA_BODY, OMEGA_BODY, INERTIA_RATIOS = slice(6, 9), slice(9, 12), slice(12, 17)
"""Slices of `MotionEstimate.covariance`."""

MOTION_COLUMNS = (*STATE_COLUMNS[:14], *STATE_COLUMNS[17:])
"""The columns of a state without those of the mass centre."""
_ERROR_NAMES = (
    *MOTION_COLUMNS[1:7],
    *("theta_x_rad", "theta_y_rad", "theta_z_rad"),
    *MOTION_COLUMNS[11:],
)
STATES_COLUMNS = (
    *MOTION_COLUMNS,
    *(f"sd_{name}" for name in _ERROR_NAMES),
    *("status", "nis", "nis_dof", "n_features", "n_used", "n_rejected"),
)
"""The estimator's own notes follow them."""
FEATURE_COLUMNS = (
    *("feature", "x_m", "y_m", "z_m", "sd_x_m", "sd_y_m", "sd_z_m"),
    *("frames_seen", "frames_rejected"),
)


@dataclass(frozen=True)
class FeatureTrack:
    """A run's estimates, one row per frame; nan in frames without an estimate."""

    time_s: FloatArray
    """(n,)"""
    r_hill: FloatArray
    """(n, 3) m"""
    v_hill: FloatArray
    """(n, 3) m/s"""
    R_world_body: FloatArray
    """(n, 3, 3) the estimator's own body axes."""
    omega_body: FloatArray
    """(n, 3) rad/s"""
    inertia_ratios: FloatArray
    """(n, 5)"""
    covariance: FloatArray
    """(n, 17, 17), order of `MotionEstimate.covariance`."""
    T_rig_body: FloatArray
    """(n, 4, 4) pose of the body axes, at the mass centre, in the rig."""
    points: tuple[Mapping[int, FloatArray], ...]
    """Per frame, (3,) estimated points by feature, body axes, m."""
    status: tuple[str, ...]
    nis: FloatArray
    """(n,) nan in frames without a used feature."""
    nis_dof: IntArray
    n_features: IntArray
    """(n,) features seen."""
    n_used: IntArray
    n_rejected: IntArray
    notes: Mapping[str, FloatArray]
    """(n,) the estimator's own numbers by column name; nan where it says nothing."""
    last_points: Mapping[int, FeaturePoint]
    """Of the last frame with an estimate."""
    frames_seen: Mapping[int, int]
    frames_rejected: Mapping[int, int]
    """Per feature, in how many frames it was seen, and rejected."""

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def has_estimate(self) -> BoolArray:
        """(n,) whether the frame has an estimate."""
        return np.asarray(np.isfinite(self.r_hill[:, 0]))

    @property
    def sd(self) -> FloatArray:
        """(n, 17) standard deviations; rounding may leave a variance slightly below zero."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2), 0.0))

    def as_track(self) -> Track:
        """As the track of a depth run, for what judges and draws these; its mass centre is 0."""
        n = len(self)
        return Track(
            time_s=self.time_s,
            r_hill=self.r_hill,
            v_hill=self.v_hill,
            com_model=np.zeros((n, 3)),
            R_world_body=self.R_world_body,
            omega_body=self.omega_body,
            inertia_ratios=self.inertia_ratios,
            sd=with_known_mass_centre(self.sd),
            T_cam_model=self.T_rig_body,
            status=self.status,
            nis=self.nis,
            nis_dof=self.nis_dof,
            window_nis=_window_nis(self.nis, self.nis_dof, self.has_estimate),
            inlier_ratio=np.full(n, np.nan),
            n_rectangles=self.n_used,
        )


def with_known_mass_centre(sd: FloatArray) -> FloatArray:
    """(..., 20) standard deviations as of a depth run, of (..., 17) without a mass centre."""
    full = np.zeros((*sd.shape[:-1], STATE_SIZE))
    full[..., np.delete(np.arange(STATE_SIZE), COM_MODEL)] = sd
    return full


def pose_in_rig(frame: TrackFrame, orbit: KeplerOrbit, motion: MotionEstimate) -> FloatArray:
    """(4, 4) T_rig_body of an estimate at the time of a frame."""
    p_world = orbit.R_hill_world(frame.time_s).T @ motion.r_hill
    return make_transform(frame.R_cam_world @ motion.R_world_body, frame.R_cam_world @ p_world)


class FeatureCollector:
    """Takes in a run frame by frame and keeps about 4 kB of each."""

    def __init__(self, orbit: KeplerOrbit) -> None:
        self._orbit = orbit
        self._numbers: list[tuple[float, float, int, int, int, int]] = []
        self._status: list[str] = []
        self._motions: list[FloatArray] = []
        self._covariances: list[FloatArray] = []
        self._poses: list[FloatArray] = []
        self._points: list[dict[int, FloatArray]] = []
        self._notes: list[dict[str, float]] = []
        self._last: Mapping[int, FeaturePoint] = {}
        self._seen: Counter[int] = Counter()
        self._rejected: Counter[int] = Counter()

    def add(self, frame: TrackFrame, estimate: FeatureEstimate) -> None:
        """Append a frame and what was estimated at it."""
        used, rejected = len(estimate.used), len(estimate.rejected)
        counts = (estimate.nis_dof, len(frame.features), used, rejected)
        self._numbers.append((frame.time_s, estimate.nis, *counts))
        self._status.append(str(estimate.status))
        self._notes.append(dict(estimate.notes))
        self._seen.update(frame.features.tolist())
        self._rejected.update(estimate.rejected)
        motion = estimate.motion
        if motion is None:
            self._motions.append(np.full(len(MOTION_COLUMNS) + 4, np.nan))
            self._covariances.append(np.full((ERROR_SIZE, ERROR_SIZE), np.nan))
            self._poses.append(np.full((4, 4), np.nan))
            self._points.append({})
            return
        R, P = motion.R_world_body, np.asarray(motion.covariance, dtype=np.float64)
        if P.shape != (ERROR_SIZE, ERROR_SIZE):
            raise ValueError(f"covariance of shape {P.shape} at {frame.time_s} s")
        parts = (motion.r_hill, motion.v_hill, R.ravel(), motion.omega_body, motion.inertia_ratios)
        self._motions.append(np.concatenate(parts))
        self._covariances.append(P)
        self._poses.append(pose_in_rig(frame, self._orbit, motion))
        self._points.append({i: point.p_body for i, point in motion.features.items()})
        self._last = dict(motion.features)

    def track(self) -> FeatureTrack:
        """All frames so far; at least one."""
        motion, numbers = np.stack(self._motions), np.array(self._numbers)
        counts = numbers[:, 2:].astype(np.intp)
        names = list(dict.fromkeys(name for notes in self._notes for name in notes))
        return FeatureTrack(
            time_s=numbers[:, 0],
            r_hill=motion[:, 0:3],
            v_hill=motion[:, 3:6],
            R_world_body=motion[:, 6:15].reshape(-1, 3, 3),
            omega_body=motion[:, 15:18],
            inertia_ratios=motion[:, 18:23],
            covariance=np.stack(self._covariances),
            T_rig_body=np.stack(self._poses),
            points=tuple(self._points),
            status=tuple(self._status),
            nis=numbers[:, 1],
            nis_dof=counts[:, 0],
            n_features=counts[:, 1],
            n_used=counts[:, 2],
            n_rejected=counts[:, 3],
            notes={
                name: np.array([notes.get(name, np.nan) for notes in self._notes]) for name in names
            },
            last_points=self._last,
            frames_seen=self._seen,
            frames_rejected=self._rejected,
        )


def write_tables(folder: Path, track: FeatureTrack) -> None:
    """Write states.csv, features.csv, poses.tum and covariances.npz of a track."""
    _write_csv(folder / STATES_FILE, (*STATES_COLUMNS, *track.notes), _state_rows(track))
    _write_csv(folder / FEATURES_FILE, FEATURE_COLUMNS, _feature_rows(track))
    known = np.flatnonzero(track.has_estimate)
    np.savez(folder / COVARIANCES_FILE, P=track.covariance[known], time_s=track.time_s[known])
    lines = []
    for k in known:
        T = track.T_rig_body[k]
        pose = (track.time_s[k], *T[:3, 3], *xyzw_from_rotation(T[:3, :3]))
        lines.append(" ".join(repr(float(value)) for value in pose) + "\n")
    (folder / POSES_FILE).write_text("".join(lines), encoding="utf-8")


def _write_csv(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(rows)


def _state_rows(track: FeatureTrack) -> Iterator[list[object]]:
    has_estimate, sd = track.has_estimate, track.sd
    for k, time_s in enumerate(track.time_s.tolist()):
        values: list[object] = [""] * (len(MOTION_COLUMNS) - 1 + ERROR_SIZE)
        if has_estimate[k]:
            quaternion = xyzw_from_rotation(track.R_world_body[k])
            parts = (track.r_hill[k], track.v_hill[k], quaternion, track.omega_body[k])
            values = np.concatenate([*parts, track.inertia_ratios[k], sd[k]]).tolist()
        counts = (track.n_features[k], track.n_used[k], track.n_rejected[k])
        yield [
            *(time_s, *values, track.status[k], _field(track.nis[k]), int(track.nis_dof[k])),
            *(int(count) for count in counts),
            *(_field(column[k]) for column in track.notes.values()),
        ]


def _feature_rows(track: FeatureTrack) -> Iterator[list[object]]:
    for feature in sorted(track.frames_seen.keys() | track.last_points.keys()):
        values: list[object] = [""] * 6
        point = track.last_points.get(feature)
        if point is not None:
            sd = np.sqrt(np.maximum(np.diagonal(point.covariance), 0.0))
            values = [*point.p_body.tolist(), *sd.tolist()]
        seen, rejected = (
            counts.get(feature, 0) for counts in (track.frames_seen, track.frames_rejected)
        )
        yield [feature, *values, seen, rejected]


def _field(value: float) -> float | str:
    """A number, or the empty field of "no value"."""
    return float(value) if np.isfinite(value) else ""


def _window_nis(nis: FloatArray, dof: IntArray, has_estimate: BoolArray) -> FloatArray:
    """(n,) NIS over its degrees of freedom over the last frames of a track that used a feature."""
    window: deque[tuple[float, int]] = deque(maxlen=NIS_WINDOW_FRAMES)
    values = np.full(len(nis), np.nan)
    for k in range(len(nis)):
        if not has_estimate[k]:
            window.clear()
            continue
        if dof[k] > 0 and np.isfinite(nis[k]):
            window.append((float(nis[k]), int(dof[k])))
        if window:
            values[k] = sum(squared for squared, _ in window) / sum(size for _, size in window)
    return values
