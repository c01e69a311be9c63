"""One run of a batch: simulate the frames, estimate from them, compare with the truth."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from pcnav.batch.axes import ESTIMATOR_AXIS, GridRun
from pcnav.batch.following import follow
from pcnav.batch.grid import GridBasis
from pcnav.batch.judging import judge
from pcnav.batch.process import peak_memory_mb, reset_peak_memory
from pcnav.batch.record import RunRecord
from pcnav.batch.scenario import run_pipeline
from pcnav.estimators.interface import EstimatorEntry, FirstPose, Given
from pcnav.estimators.peers.icp import disturbed
from pcnav.estimators.registry import ESTIMATORS
from pcnav.evaluation.bound import SceneBound
from pcnav.runs.provenance import library_versions_with_peers
from pcnav.simulation.depth import Scene
from pcnav.target.satellite import Target


@dataclass(frozen=True)
class DepthRun:
    """What is done of every run of a grid; can be sent to another process."""

    basis: GridBasis

    def __call__(self, run: GridRun) -> RunRecord:
        """The record of a run: the same for the same run, but for times and memory.

        Raises `InputError` for a scenario that cannot be simulated and for a library that is
        missing.
        """
        reset_peak_memory()
        pipeline, target = run_pipeline(self.basis, run)
        scene = Scene.of(pipeline, target.mesh)
        name = str(dict(run.case.settings)[ESTIMATOR_AXIS])
        entry = ESTIMATORS[name]
        estimator = entry.make(given_to(entry, scene, target))
        # Who is told a true pose knows more than the bound, which knows the frames alone.
        bounded = entry.first_pose is not FirstPose.EXACT
        bound = SceneBound(scene, target) if bounded else None
        with _without_track_messages():
            followed = follow(scene, name, estimator, bound)
        verdict = judge(followed, scene.truth, target)
        return RunRecord(
            run=run,
            columns=verdict.columns,
            values=verdict.values | {"peak_memory_mb": peak_memory_mb()},
            failure=None,
            versions=library_versions_with_peers(),
            command=self.basis.command(run),
        )


@contextmanager
def _without_track_messages() -> Iterator[None]:
    """Of hundreds of runs nobody wants to read when each was locked; the records have it."""
    logger = logging.getLogger("pcnav")
    before = logger.level
    logger.setLevel(logging.WARNING)
    try:
        yield
    finally:
        logger.setLevel(before)


def given_to(entry: EstimatorEntry, scene: Scene, target: Target) -> Given:
    """What an estimator is told of a scene: the truth only where it says that it needs it."""
    given = Given(scene.pipeline, scene.info, target)
    true_pose = scene.motion.truth.poses[0]
    match entry.first_pose:
        case FirstPose.NOTHING:
            return given
        case FirstPose.NEAR:
            return replace(given, T_cam_model_first=disturbed(true_pose, target.diameter_m))
        case FirstPose.EXACT:
            return replace(given, T_cam_model_first=true_pose)
