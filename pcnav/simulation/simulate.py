"""Any pipeline's scenario as a recording in memory, with the truth behind it."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Protocol

from pcnav.config.pipeline_file import EstimatorKind, Pipeline
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.recording import Recording, RecordingKind
from pcnav.simulation.attitudes import simulate_attitudes
from pcnav.simulation.depth import OnFrame, simulate_depth
from pcnav.simulation.images import simulate_images
from pcnav.simulation.stereo import simulate_stereo


class Simulation(Protocol):
    """A recording in memory and the truth behind it."""

    @property
    def recording(self) -> Recording:
        """Its frames one by one."""

    @property
    def truth(self) -> Trajectory:
        """All blocks at every frame."""

    def write(self, out: Path, overwrite: bool = False, on_frame: OnFrame | None = None) -> str:
        """Write both into a folder; what it was, in a line.

        Raises `InputError` for a folder that must not be replaced; nothing is then left behind.
        """


Simulator = Callable[[Pipeline, Path | str, Path | None], Simulation]
"""From a pipeline, its file, which an `InputError` names, and the mesh of its target."""

SIMULATORS: Mapping[RecordingKind, Simulator] = {
    RecordingKind.DEPTH: simulate_depth,
    RecordingKind.STEREO_TRACKS: simulate_stereo,
    RecordingKind.IMAGES: simulate_images,
    RecordingKind.ATTITUDES: simulate_attitudes,
}
_SEEN_BY: Mapping[str, RecordingKind] = {
    EstimatorKind.PRINCIPAL_AXES: RecordingKind.STEREO_TRACKS,
    EstimatorKind.INERTIA_BANK: RecordingKind.STEREO_TRACKS,
    EstimatorKind.IMAGE_MOTION: RecordingKind.IMAGES,
    EstimatorKind.ATTITUDE_INERTIA: RecordingKind.ATTITUDES,
}


def simulate(
    pipeline: Pipeline,
    source: Path | str = "pipeline",
    target_mesh: Path | None = None,
    kind: RecordingKind | None = None,
) -> Simulation:
    """What the sensor of a pipeline sees of its scenario; the same pipeline, the same numbers.

    Args:
        pipeline: the scenario, the sensor and the seed of its noise.
        source: the pipeline's file, which an `InputError` names.
        target_mesh: of the satellite, where depth frames or images show one.
        kind: of the recording; without it, what [scenario] says, else what the estimator of the
            pipeline lives on.

    Raises `InputError` for a scenario that cannot be simulated.
    """
    kind = kind or pipeline.scenario.recording
    kind = kind or _SEEN_BY.get(pipeline.estimator.kind, RecordingKind.DEPTH)
    return SIMULATORS[kind](pipeline, source, target_mesh)
