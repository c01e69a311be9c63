"""Any pipeline's scenario as a recording in memory, with the truth behind it."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pcnav.config.pipeline_file import EstimatorKind, Pipeline
from pcnav.recordings.recording import RecordingKind
from pcnav.simulation.attitudes import simulate_attitudes
from pcnav.simulation.depth import simulate_depth
from pcnav.simulation.images import simulate_images
from pcnav.simulation.nominal_body import with_nominal_body
from pcnav.simulation.simulation import Simulation
from pcnav.simulation.stereo import simulate_stereo

Simulator = Callable[[Pipeline, Path | str, Path | None], Simulation[Any]]
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
) -> Simulation[Any]:
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
    if kind in (RecordingKind.DEPTH, RecordingKind.IMAGES):
        pipeline = with_nominal_body(pipeline, target_mesh)
    return SIMULATORS[kind](pipeline, source, target_mesh)
