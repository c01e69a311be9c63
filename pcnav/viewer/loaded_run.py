"""A loaded run: all that the view shows of it, read once from its result folder."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from pcnav.config.pipeline_file import Pipeline, read_pipeline
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import transform_points
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.state import COM_MODEL, R_HILL
from pcnav.evaluation.knowledge import FROM_DATA
from pcnav.evaluation.metrics import evaluate
from pcnav.evaluation.track_errors import TrackErrors, Truth, match_times, relabelled, truth_of
from pcnav.files.csv_table import read_csv
from pcnav.recordings.opening import open_sequence
from pcnav.recordings.sequence import Sequence
from pcnav.recordings.truth import read_truth
from pcnav.runs.results import (
    KNOWLEDGE_FILE,
    PIPELINE_FILE,
    STATES_FILE,
    RectangleRecord,
    Track,
    read_measurements,
    read_track,
)
from pcnav.runs.unfinished import is_unfinished, whole_rows
from pcnav.target.satellite import Target, load_target
from pcnav.viewer.events import Event, events_of
from pcnav.viewer.folder import refuse_what_is_no_run
from pcnav.viewer.frames import FrameStore
from pcnav.viewer.glyphs import SIGMAS, seen_magnification
from pcnav.viewer.render_options import Layer

Records = Mapping[float, tuple[RectangleRecord, ...]]
"""By time."""


@dataclass(frozen=True)
class StateVerdict:
    """What the run's knowledge.csv says of one state."""

    prior_sd: float
    from_data: bool


@dataclass(frozen=True)
class Evaluation:
    """A run against its truth, up to the target's symmetry."""

    errors: TrackErrors
    T_cam_model: FloatArray | None
    """(n, 4, 4) the true pose at each frame of the track, nan where unknown; None without any."""


@dataclass(frozen=True)
class LoadedRun:
    """One run, whatever estimated it. What a kind of run does not have is None or empty."""

    name: str
    track: Track
    counted: str
    """What `Track.n_rectangles` counts."""
    records: Records
    frames: FrameStore | None
    """None when the frames are no longer on disk: the states alone are then shown."""
    target: Target | None
    orbit: KeplerOrbit
    """The chaser's."""
    evaluation: Evaluation | None
    verdicts: Mapping[str, StateVerdict]
    """By column of states.csv; empty for a run that is not finished."""
    notes: tuple[str, ...] = ()
    """What a user should know before looking at it."""
    position_covariance: FloatArray | None = None
    com_covariance: FloatArray | None = None
    """(n, 3, 3) m^2 where they were stored; else the diagonals in the track have to do."""
    points_body: FloatArray | None = None
    """(m, 3) estimated points of a target without a model, body axes, m."""
    has_mass_centre: bool = True
    has_position: bool = True
    has_inertia: bool = True

    @cached_property
    def events(self) -> tuple[Event, ...]:
        """What happened, in the order of time."""
        return events_of(self.track, self.records)

    @cached_property
    def size_m(self) -> float:
        """How large the target is, roughly."""
        if self.target is not None:
            return self.target.diameter_m
        if self.points_body is not None and len(self.points_body):
            return float(2.0 * np.linalg.norm(self.points_body, axis=1).max())
        return 1.0

    @cached_property
    def largest_rate(self) -> float:
        """The fastest the target turns, rad/s; 1 when it is not known to turn."""
        rates = np.linalg.norm(self.track.omega_body, axis=1)
        known = rates[np.isfinite(rates)]
        return float(known.max()) if known.size and known.max() > 0.0 else 1.0

    @property
    def first_frame(self) -> int:
        """The first frame with an estimate, else the first."""
        known = np.flatnonzero(self.track.has_estimate)
        return int(known[0]) if known.size else 0

    @cached_property
    def layers(self) -> frozenset[Layer]:
        """The layers that it has anything for."""
        absent: set[Layer] = set()
        if self.frames is None:
            absent |= {Layer.POINTS, Layer.SENSOR}
        if self.target is None:
            absent |= {Layer.ACCEPTED, Layer.REJECTED, Layer.NAMES, Layer.MESH}
        if self.target is None or self.evaluation is None or self.evaluation.T_cam_model is None:
            absent.add(Layer.TRUTH)
        if not self.has_mass_centre:
            absent.add(Layer.COM)
        if not self.has_position:
            absent |= {Layer.POSITION, Layer.TRAIL}
        if not self.has_inertia:
            absent |= {Layer.PRINCIPAL, Layer.MOMENTUM}
        return frozenset(Layer) - absent

    def true_pose(self, frame: int | None) -> FloatArray | None:
        """(4, 4) T_cam_model of the truth at a frame; None where it is not known."""
        if frame is None or self.evaluation is None or self.evaluation.T_cam_model is None:
            return None
        T = self.evaluation.T_cam_model[frame]
        return T if np.isfinite(T).all() else None

    def nearest_frame(self, time_s: float) -> int | None:
        """The frame at a time, to within half of the usual distance of frames."""
        if not len(self.track):
            return None
        steps = np.diff(self.track.time_s)
        half = 0.5 * float(np.median(steps)) if steps.size else 0.5
        row = int(match_times(np.array([time_s]), self.track.time_s, half * (1.0 + 1e-9))[0])
        return None if row < 0 else row

    def magnification(self, frame: int) -> float:
        """By how much the doubts of a frame have to be magnified to be seen."""
        sd = self.track.sd[frame]
        blocks = (R_HILL, COM_MODEL) if self.has_mass_centre else (R_HILL,)
        radius_m = SIGMAS * max(float(np.linalg.norm(sd[block])) for block in blocks)
        return seen_magnification(radius_m, self.size_m) if np.isfinite(radius_m) else 1.0

    @cached_property
    def centres(self) -> FloatArray:
        """(m, 3) the mass centre in the camera at the frames that have an estimate."""
        known = self.track.has_estimate
        T = self.track.T_cam_model[known]
        return np.asarray(transform_points(T, self.track.com_model[known][:, None])[:, 0])

    def centre(self, frame: int) -> FloatArray:
        """(3,) the mass centre in the camera at a frame, or at the nearest that has an estimate."""
        known = np.flatnonzero(self.track.has_estimate)
        if not known.size:
            return np.array([0.0, 0.0, 10.0])
        return np.asarray(self.centres[np.argmin(np.abs(known - frame))])

    def viewpoint(self, frame: int) -> tuple[FloatArray, FloatArray]:
        """A place (3,) to look at the target from, aside of the chaser, and its centre (3,)."""
        centre = self.centre(frame)
        return centre + 1.9 * self.size_m * np.array([0.75, -0.45, -0.5]), centre

    def position_spread_cam(self, frame: int) -> FloatArray:
        """(3, 3) covariance of the mass centre's position, camera axes, m^2."""
        P = _block(self.position_covariance, self.track, frame, R_HILL)
        R_cam_world = self.track.T_cam_model[frame, :3, :3] @ self.track.R_world_body[frame].T
        R = R_cam_world @ self.orbit.R_hill_world(float(self.track.time_s[frame])).T
        return np.asarray(R @ P @ R.T)

    def com_spread_model(self, frame: int) -> FloatArray:
        """(3, 3) covariance of the mass centre, model axes, m^2."""
        return _block(self.com_covariance, self.track, frame, COM_MODEL)


@dataclass(frozen=True)
class Snapshot:
    """The runs as of now."""

    runs: tuple[LoadedRun, ...]
    number: int
    """Grows with every change."""
    is_live: bool
    """Whether more frames are to come."""


class Source(Protocol):
    """Gives the newest snapshot at any time, to any thread."""

    @property
    def snapshot(self) -> Snapshot: ...


class FinishedRuns:
    """Runs that do not change."""

    def __init__(self, runs: tuple[LoadedRun, ...]) -> None:
        self._snapshot = Snapshot(runs, 0, is_live=False)

    @property
    def snapshot(self) -> Snapshot:
        """Always the same."""
        return self._snapshot


_DEPTH_MARKER = "com_x_m"
"""A column of depth runs alone."""


def load_run(folder: Path) -> LoadedRun:
    """Read a result folder of any kind, finished or not. Raises `InputError` when it is none."""
    refuse_what_is_no_run(folder)
    header = _header(folder / STATES_FILE)
    if _DEPTH_MARKER not in header:
        # The other kinds need the estimators, which take longer to import than a run to read.
        from pcnav.viewer.other_runs import OTHER_KINDS

        for kind in OTHER_KINDS:
            if kind.marker in header:
                return kind.load(folder, read_pipeline(folder / PIPELINE_FILE))
    if is_unfinished(folder):
        with whole_rows(folder) as rows:
            told = f"unfinished: {{}} frames so far in {folder.name}"
            return _depth_run(folder, rows, False, told)
    return _depth_run(folder, folder, True, None)


def depth_inputs(pipeline: Pipeline, path: Path) -> tuple[Target, Sequence | None]:
    """Target and sequence that a pipeline as run names; the sequence where it is still there."""
    if pipeline.target_mesh is None:
        raise InputError(path, "target_mesh", "expected the mesh of the run")
    target = load_target(Path(pipeline.target_mesh))
    try:
        sequence = None if pipeline.sequence is None else open_sequence(Path(pipeline.sequence))
    except InputError:
        sequence = None
    return target, sequence


def judged(track: Track, truth: Truth | None, symmetries: FloatArray) -> Evaluation | None:
    """A track against a truth; None where there is none, or nothing to compare it with."""
    if truth is None or not track.has_estimate.any():
        return None
    try:
        metrics = evaluate(track, truth, symmetries)
    except InputError:
        return None
    if metrics.errors is None:
        return None
    told = relabelled(truth, symmetries[metrics.symmetry]).T_cam_model
    true = None
    if told is not None:
        rows = match_times(track.time_s, truth.time_s, 1e-6)
        true = np.where((rows >= 0)[:, None, None], told[rows], np.nan)
    return Evaluation(metrics.errors, true)


def records_by_time(records: tuple[RectangleRecord, ...]) -> Records:
    """The records of each frame."""
    grouped: dict[float, list[RectangleRecord]] = {}
    for record in records:
        grouped.setdefault(record.time_s, []).append(record)
    return {time_s: tuple(rows) for time_s, rows in grouped.items()}


def _depth_run(folder: Path, tables: Path, finished: bool, told: str | None) -> LoadedRun:
    pipeline = read_pipeline(folder / PIPELINE_FILE)
    track = read_track(tables, with_covariance=finished)
    target, sequence = depth_inputs(pipeline, folder / PIPELINE_FILE)
    notes = [] if told is None else [told.format(len(track))]
    frames, truth, motion = None, None, pipeline.orbit.mean_motion_rad_s
    if sequence is None:
        notes.append(f"the depth frames are not at {pipeline.sequence}: states only")
    else:
        frames = FrameStore(sequence, target, pipeline.perception, pipeline.seed)
        motion = sequence.info.mean_motion_rad_s
        truth = truth_of(read_truth(sequence.path))
    blocks: list[FloatArray | None] = [None, None]
    if track.covariance is not None:
        # The rest of a long run's covariances, 3 kB a frame, is not kept.
        blocks = [track.covariance[:, block, block].copy() for block in (R_HILL, COM_MODEL)]
    return LoadedRun(
        name=folder.name,
        track=without_covariance(track),
        counted="rectangles",
        records=records_by_time(read_measurements(tables)),
        frames=frames,
        target=target,
        orbit=KeplerOrbit(motion),
        evaluation=judged(without_covariance(track), truth, target.symmetry_transforms),
        verdicts=_verdicts(folder / KNOWLEDGE_FILE),
        notes=tuple(notes),
        position_covariance=blocks[0],
        com_covariance=blocks[1],
    )


def without_covariance(track: Track) -> Track:
    """The same track without the full covariances."""
    return replace(track, covariance=None)


def _verdicts(path: Path) -> Mapping[str, StateVerdict]:
    if not path.is_file():
        return {}
    table = read_csv(path, ("state", "prior_sd", "verdict"), ("state", "verdict"))
    rows = zip(
        table.words("state"),
        table.numbers(("prior_sd",))[:, 0],
        table.words("verdict"),
        strict=True,
    )
    return {name: StateVerdict(float(sd), verdict == FROM_DATA) for name, sd, verdict in rows}


def _block(stored: FloatArray | None, track: Track, frame: int, states: slice) -> FloatArray:
    if stored is not None:
        return np.asarray(stored[frame])
    return np.diag(track.sd[frame, states] ** 2)


def _header(path: Path) -> frozenset[str]:
    try:
        with path.open(encoding="utf-8") as file:
            return frozenset(file.readline().strip().split(","))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, "file", f"expected a readable text file ({error})") from error


_Loader = Callable[[Path, Pipeline], LoadedRun]


@dataclass(frozen=True)
class RunKind:
    """A kind of run beside that on depth frames, told by a column of its states.csv."""

    marker: str
    load: _Loader
