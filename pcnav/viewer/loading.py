"""From a result folder, or a run that begins, to what the view shows of it."""

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import EstimatorKind, Pipeline
from pcnav.core.errors import InputError
from pcnav.dynamics.blocks import RATIOS
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.estimators.registry import ESTIMATORS
from pcnav.evaluation.errors import Errors, errors
from pcnav.evaluation.information_gain import FROM_DATA
from pcnav.files.csv_table import read_csv
from pcnav.recordings.attitudes import has_camera_attitudes, read_camera_attitudes
from pcnav.recordings.opening import format_of, open_sequence
from pcnav.recordings.recording import RecordingKind, truth_folder
from pcnav.recordings.stereo_tracks import read_stereo_tracks
from pcnav.recordings.truth import read_truth, truth_of
from pcnav.runs.feature_outcomes import read_feature_outcomes
from pcnav.runs.reader import read_features, read_records, read_run
from pcnav.runs.records import RectangleRecord
from pcnav.runs.result_files import KNOWLEDGE_FILE, MEASUREMENTS_FILE, PIPELINE_FILE
from pcnav.runs.run import Run
from pcnav.target.satellite import load_target
from pcnav.viewer.frames import FrameStore
from pcnav.viewer.loaded_run import (
    STORED_COVARIANCES,
    CameraAttitude,
    LoadedRun,
    StateVerdict,
)
from pcnav.viewer.tracks_picture import tracked_images


def load_run(folder: Path, sequence: Path | None = None) -> LoadedRun:
    """Read a result folder, finished or not. Raises `InputError` when it is none.

    ``sequence`` is where its recording is, where it is not where the folder says.
    """
    run = read_run(folder, with_covariance=True)
    if sequence is not None and run.pipeline is not None:
        moved = run.pipeline.model_copy(update={"sequence": str(sequence.resolve())})
        run = replace(run, pipeline=moved)
    trajectory = run.trajectory
    blocks = {block.name: trajectory.covariance_of(block) for block in STORED_COVARIANCES}
    stored = {name: P.copy() for name, P in blocks.items() if P is not None}
    loaded = opened(replace(run, trajectory=replace(trajectory, covariance=None)))
    unfinished = f"unfinished: {len(run)} frames so far in {folder.name}"
    records: dict[float, list[RectangleRecord]] = {}
    if (folder / MEASUREMENTS_FILE).is_file():
        last_s = float(run.time_s[-1]) if len(run) else -np.inf
        for record in read_records(folder, last_s):
            records.setdefault(record.time_s, []).append(record)
    features = read_features(folder)
    points = None if features is None else features.p_body
    return replace(
        loaded,
        errors=_compared(loaded),
        records={time_s: tuple(rows) for time_s, rows in records.items()},
        verdicts=_verdicts(folder / KNOWLEDGE_FILE),
        notes=loaded.notes if run.is_finished else (unfinished, *loaded.notes),
        covariances=stored,
        features=features,
        outcomes=read_feature_outcomes(folder),
        points_body=None if points is None else points[np.isfinite(points).all(axis=1)],
    )


def opened(run: Run) -> LoadedRun:
    """A run with the target, the frames and the orbit that it was made from, as far as there are.

    Raises `InputError` for a run on depth frames that does not tell its mesh.
    """
    pipeline, entry = run.pipeline, ESTIMATORS.get(run.estimator)
    if pipeline is None or entry is None:
        return LoadedRun(run)
    loaded = LoadedRun(run, orbit=KeplerOrbit(pipeline.orbit.mean_motion_rad_s))
    if RecordingKind.DEPTH in entry.takes:
        return _with_frames(loaded, pipeline)
    path = _recording(run)
    if loaded.trajectory.T_cam_target is None:
        of_what = "rotation and inertia" if loaded.has(RATIOS) else "attitude and rate"
        where = "as seen along the z axis of the world"
        if not loaded.has(RATIOS):
            where = "at a distance that is not known"
            loaded = replace(loaded, camera=_camera_attitude(run))
        loaded = replace(loaded, notes=(f"{of_what} only: drawn {where}",))
    elif path is not None:
        loaded = replace(loaded, orbit=read_stereo_tracks(path).orbit)
    takes = {RecordingKind.STEREO_TRACKS, RecordingKind.IMAGES} & set(entry.takes)
    if path is not None and takes:
        is_rig = RecordingKind.STEREO_TRACKS in takes
        loaded = replace(loaded, tracked=tracked_images(path, run.folder, is_rig=is_rig))
    if path is None:
        gone = f"the recording is not at {pipeline.sequence}: no truth"
        loaded = replace(loaded, notes=(*loaded.notes, gone))
    return loaded


def _with_frames(loaded: LoadedRun, pipeline: Pipeline) -> LoadedRun:
    """Of a run on depth frames. Target and frames are opened anew: readers and ray caster of a
    run that goes on are not shared with threads that draw."""
    if pipeline.target_mesh is None:
        path = (loaded.run.folder or Path(loaded.name)) / PIPELINE_FILE
        raise InputError(path, "target_mesh", "expected the mesh of the run")
    loaded = replace(loaded, target=load_target(Path(pipeline.target_mesh), pipeline.mesh_unit))
    assert loaded.target is not None
    if pipeline.sequence is None:
        return replace(loaded, notes=(*loaded.notes, "its depth frames were not kept: states only"))
    try:
        mesh, path = Path(pipeline.target_mesh), Path(pipeline.sequence)
        sequence = open_sequence(path, mesh, pipeline.skip_bad_frames, pipeline.recording)
    except InputError:
        gone = f"the depth frames are not at {pipeline.sequence}: states only"
        return replace(loaded, notes=(*loaded.notes, gone))
    return replace(
        loaded,
        frames=FrameStore(sequence, loaded.target, pipeline.perception, pipeline.seed),
        orbit=KeplerOrbit(sequence.info.mean_motion_rad_s),
    )


def _recording(run: Run) -> Path | None:
    """What a run was made from; None where it is no longer there."""
    if run.pipeline is None or run.pipeline.sequence is None:
        return None
    path = Path(run.pipeline.sequence)
    return path if path.exists() else None


def _camera_attitude(run: Run) -> CameraAttitude | None:
    """Of a run on images: of its own tracks, else of its recording."""
    recording = _recording(run)
    places = [] if recording is None else [truth_folder(recording)]
    for place in places if run.folder is None else [run.folder, *places]:
        if has_camera_attitudes(place):
            return partial(read_camera_attitudes, place)
    return None


def _compared(loaded: LoadedRun) -> Errors | None:
    """A run against the truth of its recording; None where there is none to compare it with."""
    run, path = loaded.run, _recording(loaded.run)
    if path is None or not run.has_estimate.any():
        return None
    if run.estimator == EstimatorKind.ATTITUDE_INERTIA and not run.segments and _is_images(path):
        # Up to release 0.1 the folder did not tell the frame whose camera's axes are those of the
        # body.
        return None
    frames = loaded.frames
    truth = read_truth(truth_folder(path)) if frames is None else truth_of(frames.recording)
    if truth is None:
        return None
    symmetries = None if loaded.target is None else loaded.target.symmetry_transforms
    roundness = None if loaded.target is None else loaded.target.roundness
    try:
        # The points of every frame, which belong to a folder, are not compared.
        return errors(
            replace(run, folder=None), truth, symmetry_transforms=symmetries, roundness=roundness
        )
    except InputError:
        return None


def _is_images(path: Path) -> bool:
    found = format_of(path)
    return found is not None and found.kind is RecordingKind.IMAGES


def _verdicts(path: Path) -> Mapping[str, StateVerdict]:
    if not path.is_file():
        return {}
    names = ("state", "unit", "prior_sd", "posterior_sd", "verdict")
    table = read_csv(path, names, ("state", "unit", "verdict"))
    deviations = table.numbers(("prior_sd", "posterior_sd")).tolist()
    words = map(table.words, ("state", "unit", "verdict"))
    return {
        name: StateVerdict(unit, prior_sd, posterior_sd, verdict == FROM_DATA)
        for name, unit, verdict, (prior_sd, posterior_sd) in zip(*words, deviations, strict=True)
    }
