"""One run of a batch: simulate the recording, estimate from it, compare with the truth."""

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from pcnav.batch.axes import ESTIMATOR_AXIS, RANGE_AXIS, TUMBLE_AXIS, GridRun
from pcnav.batch.grid import GridBasis
from pcnav.batch.process import peak_memory_mb, reset_peak_memory
from pcnav.batch.record import RunRecord
from pcnav.batch.run_metrics import BOUNDED, Followed, run_metrics
from pcnav.config.length_unit import LengthUnit
from pcnav.config.motion import MotionKind
from pcnav.config.pipeline_file import Pipeline
from pcnav.config.table import Vector3
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, OMEGA_BODY, THETA_BODY
from pcnav.estimators.choice import simulated_kind
from pcnav.estimators.image_motion.source import TrackedImages
from pcnav.estimators.interface import Estimator, EstimatorEntry, FirstPose, Given
from pcnav.estimators.peers.icp import disturbed
from pcnav.estimators.registry import ESTIMATORS
from pcnav.evaluation.bound import SceneBound, compared, pose_jacobian
from pcnav.recordings.intake import Intake
from pcnav.recordings.recording import Recording, RecordingKind
from pcnav.recordings.sequence import Frame
from pcnav.runs.collector import RunCollector, collected
from pcnav.runs.provenance import library_versions_with_peers
from pcnav.simulation.depth import Scene
from pcnav.simulation.images import RenderedImages
from pcnav.simulation.random_truth import Satellite, Spread, random_truth
from pcnav.simulation.simulate import simulate
from pcnav.simulation.simulation import Simulation
from pcnav.target.satellite import Target, load_target


@dataclass(frozen=True)
class OneRun:
    """What is done of every run of a grid; can be sent to another process."""

    basis: GridBasis

    def __call__(self, run: GridRun) -> RunRecord:
        """The record of a run: the same for the same run, but for times and memory.

        Raises `InputError` for a scenario that cannot be simulated and for a library that is
        missing.
        """
        reset_peak_memory()
        pipeline, target = run_pipeline(self.basis, run)
        simulation = simulated(self.basis, pipeline, target)
        recording = simulation.recording
        if isinstance(recording, RenderedImages):
            recording = TrackedImages(recording, pipeline.feature_tracker)
        name = str(dict(run.case.settings)[ESTIMATOR_AXIS])
        entry = ESTIMATORS[name]
        estimator = entry.make(given_to(entry, recording, pipeline, target))
        bound = None
        # Who is given a true pose knows more than the bound, which knows the frames of a free
        # motion alone.
        told = entry.first_pose is FirstPose.EXACT or pipeline.scenario.states_first_pose
        free = pipeline.motion.kind is MotionKind.FREE
        if isinstance(recording, Scene) and target and free and not told:
            bound = LeastErrors(recording, target)
        with without_track_messages():
            followed = follow(recording, name, estimator, bound)
        found = run_metrics(followed, simulation.truth, target)
        return RunRecord(
            run=run,
            columns=found.columns,
            values=found.values | {"peak_memory_mb": peak_memory_mb()},
            failure=None,
            versions=library_versions_with_peers(),
            command=self.basis.command(run),
        )


@lru_cache(maxsize=8)
def loaded_target(mesh: Path, unit: LengthUnit | None = None) -> Target:
    """A target, read once in a process. Raises `InputError`."""
    return load_target(mesh, unit)


def run_pipeline(basis: GridBasis, run: GridRun) -> tuple[Pipeline, Target | None]:
    """Everything that fixes the frames of a run, and the target that depth frames show.

    Of depth frames the seed draws initial attitude, spin axis, place in the image, direction of the
    relative velocity and, from the prior that the target states, mass centre and inertia ratios;
    distance and tumble rate are the case's, where it has none, those of the pipeline. Of all other
    recordings the motion is the pipeline's, and the seed draws points, disturbances and noise.
    `pcnav simulate` of this pipeline writes the same frames. Raises `InputError`.
    """
    pipeline = basis.pipeline_of(run.case)
    frame_rate_hz = pipeline.scenario.frame_rate_hz
    frames = basis.frames_at(frame_rate_hz)
    if basis.kind_of(run.case) is not RecordingKind.DEPTH:
        scenario = pipeline.scenario.model_copy(update={"frames": frames})
        return pipeline.model_copy(update={"seed": run.seed, "scenario": scenario}), None
    target = loaded_target(Path(str(pipeline.target_mesh)), pipeline.mesh_unit)
    axes = dict(run.case.settings)
    orbit, body = pipeline.orbit, pipeline.body
    range_m = float(axes.get(RANGE_AXIS, _length(orbit.r_hill_m)))
    tumble_deg_s = float(axes.get(TUMBLE_AXIS, _length(body.omega_body_deg_s)))
    truth = random_truth(
        Satellite(target, pipeline),
        Spread((range_m, range_m), (tumble_deg_s, tumble_deg_s), _length(orbit.v_hill_m_s)),
        run.seed,
        frames=frames,
        frame_rate_hz=frame_rate_hz,
    )
    return truth, target


def simulated(basis: GridBasis, pipeline: Pipeline, target: Target | None) -> Simulation[Any]:
    """The recording of a run, in memory, with its truth. Raises `InputError`."""
    if target is not None:
        return Scene.showing(target, pipeline, basis.source).simulation
    mesh = None if pipeline.target_mesh is None else Path(pipeline.target_mesh)
    return simulate(pipeline, basis.source, mesh, simulated_kind(pipeline, basis.source))


class LeastErrors:
    """The least RMS errors of a scene that its frames allow, compared as pcnav compares them."""

    def __init__(self, scene: Scene, target: Target) -> None:
        self._motion = scene.motion
        self._bound = SceneBound(scene, target, compared(scene, target))

    def step(self, frame: Frame) -> FloatArray:
        """(5,) roots of the traces of the bound's blocks after the next frame, as in `BOUNDED`."""
        P, k, motion = self._bound.step(frame), frame.index, self._motion
        H = pose_jacobian(motion.state(k), motion.T_cam_world[k], motion.R_hill_world[k])[:3]
        variance = np.diag(P)
        blocks = (THETA_BODY, OMEGA_BODY, COM_MODEL, INERTIA_RATIOS)
        traces = [np.trace(H @ P @ H.T), *(variance[block].sum() for block in blocks)]
        return np.asarray(np.sqrt(traces))


def follow(
    recording: Recording | Intake, name: str, estimator: Estimator, bound: LeastErrors | None = None
) -> Followed:
    """Put an estimator of a name to all frames of a recording; one frame at a time is in memory.

    What is kept of a frame is some 4 kB, most of it the covariance. Time is spent on the bound and
    on the frames themselves, too, but none of it counts.
    """
    collector, seconds, least = RunCollector(estimator.output, name), list[float](), []
    for frame in recording:
        started = time.process_time()
        estimate = estimator.step(frame)
        seconds.append(time.process_time() - started)
        collector.add(estimate)
        if bound is not None:
            least.append(bound.step(frame))
    revised = estimator.finish()
    run = collector.run() if revised is None else collected(name, estimator.output, revised)
    bounds = dict(zip(BOUNDED, np.array(least).T, strict=True)) if least else {}
    return Followed(run, np.array(seconds), bounds)


def given_to(
    entry: EstimatorEntry, recording: Recording, pipeline: Pipeline, target: Target | None
) -> Given:
    """What an estimator is given of a recording: the truth only where it says that it needs it."""
    if not isinstance(recording, Scene) or target is None:
        return Given(pipeline, recording)
    given, true_pose = Given(pipeline, recording.info, target), recording.truth.poses[0]
    match entry.first_pose:
        case FirstPose.NOTHING:
            return given
        case FirstPose.NEAR:
            return replace(given, T_cam_model_first=disturbed(true_pose, target.diameter_m))
        case FirstPose.EXACT:
            return replace(given, T_cam_model_first=true_pose)


@contextmanager
def without_track_messages() -> Iterator[None]:
    """Of hundreds of runs nobody wants to read when each was locked; the records have it."""
    logger = logging.getLogger("pcnav")
    before = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(before)


def _length(vector: Vector3) -> float:
    return float(np.linalg.norm(vector))
