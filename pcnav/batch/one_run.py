"""One run of a batch: simulate the recording, estimate from it, compare with the truth."""

from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from pcnav.batch.axes import ESTIMATOR_AXIS, RANGE_AXIS, TUMBLE_AXIS, GridRun
from pcnav.batch.grid import GridBasis
from pcnav.batch.record import RunRecord
from pcnav.batch.recorded_run import follow, recorded
from pcnav.batch.run_metrics import RunMetrics, run_metrics
from pcnav.config.length_unit import LengthUnit
from pcnav.config.motion import MotionKind
from pcnav.config.pipeline_file import Pipeline
from pcnav.config.table import Vector3
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, OMEGA_BODY, THETA_BODY
from pcnav.estimators.choice import simulated_kind
from pcnav.estimators.image_motion.source import TrackedImages
from pcnav.estimators.interface import EstimatorEntry, FirstPose, Given
from pcnav.estimators.peers.icp import disturbed
from pcnav.estimators.registry import ESTIMATORS
from pcnav.evaluation.bound import SceneBound, compared, pose_jacobian
from pcnav.recordings.recording import Recording, RecordingKind
from pcnav.recordings.sequence import Frame
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
        return recorded(run, self.basis.command(run), lambda: self._measured(run))

    def _measured(self, run: GridRun) -> RunMetrics:
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
        # motion alone, and those as images.
        told = entry.first_pose is FirstPose.EXACT or pipeline.scenario.states_first_pose
        free = pipeline.motion.kind is MotionKind.FREE and not pipeline.scan.is_used
        if isinstance(recording, Scene) and target and free and not told:
            bound = LeastErrors(recording, target)
        followed = follow(recording, name, estimator, bound)
        return run_metrics(followed, simulation.truth, target)


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


def _length(vector: Vector3) -> float:
    return float(np.linalg.norm(vector))
