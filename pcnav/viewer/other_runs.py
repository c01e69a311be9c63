"""Runs on feature tracks, on images of one camera and on attitudes, told as a loaded.

Each is compared with its truth by the evaluation of its own pipeline: the axes of its body are not
those of the truth.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import EstimatorKind, Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import make_transform, rotation_from_xyzw
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, OMEGA_BODY, STATE_SIZE, THETA_BODY
from pcnav.estimators.image_motion.source import is_seen_by_one_camera
from pcnav.evaluation.attitude_metrics import attitude_errors
from pcnav.evaluation.feature_metrics import evaluate_features
from pcnav.evaluation.image_metrics import evaluate_images
from pcnav.evaluation.track_errors import TrackErrors, Truth, truth_of
from pcnav.files.csv_table import CsvTable, read_csv
from pcnav.recordings.attitude_file import ATTITUDE_FILE
from pcnav.recordings.monocular import read_camera_attitudes
from pcnav.recordings.track_files import read_tracks
from pcnav.recordings.truth import read_truth
from pcnav.runs.attitude_results import ATTITUDE_STATES_COLUMNS, AttitudeTrack
from pcnav.runs.feature_results import (
    FEATURE_COLUMNS,
    FEATURES_FILE,
    STATES_COLUMNS,
    FeatureTrack,
    with_known_mass_centre,
)
from pcnav.runs.image_results import IMAGE_STATES_COLUMNS, ImageTrack
from pcnav.runs.results import POSES_FILE, STATES_FILE, Track, read_poses
from pcnav.viewer.loaded_run import Evaluation, LoadedRun, RunKind

_QUATERNION = ("q_x", "q_y", "q_z", "q_w")
_SHOWN_AT_M = 4.0
"""A target whose distance nobody knows is drawn so far in front of the camera."""


def _feature_run(folder: Path, pipeline: Pipeline) -> LoadedRun:
    """Stereo feature tracks: no mesh and no rectangles, but points that were estimated."""
    table = read_csv(folder / STATES_FILE, STATES_COLUMNS, ("status",))
    numbers = table.numbers(STATES_COLUMNS[1 : STATES_COLUMNS.index("status")])
    n = len(numbers)
    time_s, r_hill = table.times(), numbers[:, 0:3]
    track = Track(
        time_s=time_s,
        r_hill=r_hill,
        v_hill=numbers[:, 3:6],
        com_model=np.zeros((n, 3)),
        R_world_body=_rotations(numbers[:, 6:10]),
        omega_body=numbers[:, 10:13],
        inertia_ratios=numbers[:, 13:18],
        sd=with_known_mass_centre(numbers[:, 18:35]),
        T_cam_model=read_poses(folder / POSES_FILE, time_s, np.isfinite(r_hill[:, 0])),
        status=table.words("status"),
        nis=_column(table, "nis"),
        nis_dof=table.counts("nis_dof"),
        window_nis=np.full(n, np.nan),
        inlier_ratio=np.full(n, np.nan),
        n_rectangles=table.counts("n_used"),
    )
    recording, truth, notes = _truth_of(pipeline)
    orbit = KeplerOrbit(pipeline.orbit.mean_motion_rad_s)
    if recording is not None:
        orbit = read_tracks(recording).orbit
    principal = pipeline.estimator.kind is EstimatorKind.PRINCIPAL_AXES
    of_run = FeatureTrack(
        time_s=time_s,
        r_hill=r_hill,
        v_hill=track.v_hill,
        R_world_body=track.R_world_body,
        omega_body=track.omega_body,
        inertia_ratios=track.inertia_ratios,
        covariance=_diagonal(numbers[:, 18:35]),
        T_rig_body=track.T_cam_model,
        points=({},) * n,
        status=track.status,
        nis=track.nis,
        nis_dof=track.nis_dof,
        n_features=table.counts("n_features"),
        n_used=track.n_rectangles,
        n_rejected=table.counts("n_rejected"),
        notes={},
        last_points={},
        frames_seen={},
        frames_rejected={},
    )

    def errors(known: Truth) -> FloatArray | None:
        found = evaluate_features(of_run, known, None, principal)[1]
        if found is None:
            return None
        return np.insert(found.state, [COM_MODEL.start] * 3, np.nan, axis=1)

    points = read_csv(folder / FEATURES_FILE, FEATURE_COLUMNS).numbers(("x_m", "y_m", "z_m"))
    return replace(
        feature_run(folder.name, track, orbit),
        evaluation=_evaluation(errors, truth),
        notes=notes,
        points_body=points[np.isfinite(points).all(axis=1)],
    )


def _image_run(folder: Path, pipeline: Pipeline) -> LoadedRun:
    """Images of one camera: attitude and rate, at a distance that nobody knows."""
    table = read_csv(folder / STATES_FILE, IMAGE_STATES_COLUMNS, ("status", "outcome"))
    R = _rotations(table.numbers(_QUATERNION))
    sd = np.full((len(R), STATE_SIZE), np.nan)
    sd[:, THETA_BODY] = table.numbers(("sd_theta_x_rad", "sd_theta_y_rad", "sd_theta_z_rad"))
    track = replace(
        _turning(table, R, sd, _camera_attitudes(folder, pipeline, table.times())),
        omega_body=table.numbers(("w_x_rad_s", "w_y_rad_s", "w_z_rad_s")),
        n_rectangles=table.counts("agreeing"),
    )
    _, truth, notes = _truth_of(pipeline)
    none = np.zeros(len(R), dtype=np.intp)
    of_run = ImageTrack(
        time_s=track.time_s,
        R_world_body=R,
        omega_body=track.omega_body,
        covariance=_diagonal(sd[:, THETA_BODY]),
        status=track.status,
        outcome=table.words("outcome"),
        is_first=np.zeros(len(R), dtype=np.bool_),
        segment=table.counts("segment"),
        reference=(None,) * len(R),
        n_features=none,
        n_matches=none,
        n_agreeing=none,
    )

    def errors(known: Truth) -> FloatArray | None:
        found = evaluate_images(of_run, known)[1]
        if found is None:
            return None
        state = np.full((len(R), STATE_SIZE), np.nan)
        # Where the axes are defined there is no error by construction.
        state[:, THETA_BODY] = np.where(found.defines_axes[:, None], np.nan, found.theta_body)
        state[:, OMEGA_BODY] = found.omega_body
        return state

    loaded = image_run(folder.name, track)
    return replace(loaded, evaluation=_evaluation(errors, truth), notes=(*loaded.notes, *notes))


def _attitude_run(folder: Path, pipeline: Pipeline) -> LoadedRun:
    """Attitudes, recorded or of images: rotation and inertia, at a distance that nobody knows."""
    table = read_csv(folder / STATES_FILE, ATTITUDE_STATES_COLUMNS, ("status",))
    names = ATTITUDE_STATES_COLUMNS[1 : ATTITUDE_STATES_COLUMNS.index("status")]
    numbers = table.numbers(names)
    R = _rotations(numbers[:, 0:4])
    sd = np.full((len(R), STATE_SIZE), np.nan)
    sd[:, THETA_BODY], sd[:, OMEGA_BODY] = numbers[:, 12:15], numbers[:, 15:18]
    sd[:, INERTIA_RATIOS] = numbers[:, 18:23]
    track = replace(
        _turning(table, R, sd, np.eye(3)),
        omega_body=numbers[:, 4:7],
        inertia_ratios=numbers[:, 7:12],
        nis=_column(table, "nis"),
        nis_dof=table.counts("nis_dof"),
        n_rectangles=np.isfinite(_column(table, "sd_measured_rad")).astype(np.intp),
    )
    loaded = attitude_run(folder.name, track)
    if is_seen_by_one_camera(Path(pipeline.sequence or "")):
        # Its body axes are the camera's at a frame that the result folder does not tell.
        return loaded
    _, truth, notes = _truth_of(pipeline)
    of_run = AttitudeTrack(
        time_s=track.time_s,
        R_world_body=R,
        omega_body=track.omega_body,
        inertia_ratios=track.inertia_ratios,
        covariance=_diagonal(numbers[:, 12:23]),
        status=track.status,
        nis=track.nis,
        measured_sd=_column(table, "sd_measured_rad"),
    )

    def errors(known: Truth) -> FloatArray | None:
        state, found = np.full((len(R), STATE_SIZE), np.nan), attitude_errors(of_run, known)
        state[:, THETA_BODY], state[:, OMEGA_BODY] = found[:, 0:3], found[:, 3:6]
        state[:, INERTIA_RATIOS] = found[:, 6:11]
        return state

    return replace(loaded, evaluation=_evaluation(errors, truth), notes=(*loaded.notes, *notes))


def _truth_of(pipeline: Pipeline) -> tuple[Path | None, Truth | None, tuple[str, ...]]:
    """The folder of a recording and its truth, or a note that it is gone."""
    recording = Path(pipeline.sequence or "")
    folder = recording.parent if recording.is_file() else recording
    if pipeline.sequence is None or not folder.is_dir():
        return None, None, (f"the recording is not at {pipeline.sequence}: no truth",)
    return folder, truth_of(read_truth(folder)), ()


def _evaluation(
    errors: Callable[[Truth], FloatArray | None], truth: Truth | None
) -> Evaluation | None:
    """A run against its truth; None where there is none, or nothing to compare it with."""
    if truth is None:
        return None
    try:
        state = errors(truth)
    except InputError:
        return None
    if state is None:
        return None
    no_pose = np.full((len(state), 3), np.nan)
    return Evaluation(TrackErrors(no_pose, no_pose, state), None)


def _diagonal(sd: FloatArray) -> FloatArray:
    """(n, k, k) covariances of standard deviations (n, k): only the errors are asked for."""
    return sd[:, :, None] ** 2 * np.eye(sd.shape[1])


def feature_run(name: str, track: Track, orbit: KeplerOrbit) -> LoadedRun:
    """Of a run on stereo tracks, without its truth and points."""
    return replace(_run(name, track, "features"), orbit=orbit)


def image_run(name: str, track: Track) -> LoadedRun:
    """Of a run on images of one camera."""
    note = "attitude and rate only: drawn at a distance that is not known"
    loaded = _run(name, track, "matches")
    return replace(loaded, notes=(note,), has_position=False, has_inertia=False)


def attitude_run(name: str, track: Track) -> LoadedRun:
    """Of a run on attitudes."""
    note = "rotation and inertia only: drawn as seen along the z axis of the world"
    return replace(_run(name, track, "attitudes"), notes=(note,), has_position=False)


def _run(name: str, track: Track, counted: str) -> LoadedRun:
    return LoadedRun(
        name=name,
        track=track,
        counted=counted,
        records={},
        frames=None,
        target=None,
        orbit=KeplerOrbit(0.0),
        evaluation=None,
        verdicts={},
        has_mass_centre=False,
    )


def _camera_attitudes(folder: Path, pipeline: Pipeline, times_s: FloatArray) -> FloatArray:
    """(n, 3, 3) R_cam_world of a run on images: of its own tracks, else of its recording.

    A camera at rest where neither tells of it.
    """
    recording = None if pipeline.sequence is None else Path(pipeline.sequence)
    places = [folder] if recording is None else [folder, recording, recording.parent]
    for place in places:
        if (place / ATTITUDE_FILE).is_file():
            return read_camera_attitudes(place, times_s)
    return np.broadcast_to(np.eye(3), (len(times_s), 3, 3))


def _turning(table: CsvTable, R: FloatArray, sd: FloatArray, R_cam_world: FloatArray) -> Track:
    """A track of attitudes (n, 3, 3), nan where unknown; of the rest nothing is known."""
    n, known = len(R), np.isfinite(R[:, 0, 0])
    # An estimate is told by its position: zero stands for it.
    place = np.where(known[:, None], 0.0, np.full((n, 3), np.nan))
    T = np.full((n, 4, 4), np.nan)
    T[known] = shown_pose((R_cam_world @ R)[known])
    return Track(
        time_s=table.times(),
        r_hill=place,
        v_hill=place,
        com_model=np.zeros((n, 3)),
        R_world_body=R,
        omega_body=np.full((n, 3), np.nan),
        inertia_ratios=np.tile([1.0, 1.0, 0.0, 0.0, 0.0], (n, 1)),
        sd=sd,
        T_cam_model=T,
        status=table.words("status"),
        nis=np.full(n, np.nan),
        nis_dof=np.zeros(n, dtype=np.intp),
        window_nis=np.full(n, np.nan),
        inlier_ratio=np.full(n, np.nan),
        n_rectangles=np.zeros(n, dtype=np.intp),
    )


def shown_pose(R_cam_body: FloatArray) -> FloatArray:
    """(..., 4, 4) where a target is drawn of whose place nothing is known."""
    shown_at = np.broadcast_to(np.array([0.0, 0.0, _SHOWN_AT_M]), R_cam_body.shape[:-1])
    return make_transform(R_cam_body, shown_at)


def _rotations(xyzw: FloatArray) -> FloatArray:
    """(n, 3, 3) of quaternions (n, 4), nan where they are."""
    R = np.full((len(xyzw), 3, 3), np.nan)
    known = np.isfinite(xyzw).all(axis=1)
    if known.any():
        R[known] = rotation_from_xyzw(xyzw[known])
    return R


def _column(table: CsvTable, name: str) -> FloatArray:
    return table.numbers((name,))[:, 0]


OTHER_KINDS = (
    RunKind("n_features", _feature_run),
    RunKind("reference", _image_run),
    RunKind("sd_measured_rad", _attitude_run),
)
