"""Attitudes of a tumbling target as another instrument would give them."""

from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.blocks import ATTITUDE
from pcnav.recordings.attitudes import AttitudeRecording, write_attitudes
from pcnav.simulation.motion import true_motion
from pcnav.simulation.simulation import OnFrame, Simulation


def simulate_attitudes(
    pipeline: Pipeline, source: Path | str = "pipeline", target_mesh: Path | None = None
) -> Simulation[AttitudeRecording]:
    """Attitudes with the noise of [attitude_inertia].

    ``source`` is the pipeline's file, which an `InputError` names for a scenario that cannot be
    simulated. A mesh is not needed.
    """
    truth = true_motion(pipeline, source).truth
    rng, sd_deg = np.random.default_rng(pipeline.seed), pipeline.attitude_inertia.attitude_sd_deg
    errors = np.radians(sd_deg) * rng.standard_normal((len(truth), 3))
    R_seen = truth[ATTITUDE] @ exp_rotation(errors)
    recording = AttitudeRecording(Path(source).stem, truth.time_s, R_seen)

    def store(out: Path, overwrite: bool, on_frame: OnFrame | None) -> str:
        write_attitudes(out, recording, truth, overwrite)
        return f"attitudes: {out} ({len(recording)} of {sd_deg:g} deg about each axis)"

    return Simulation(recording, truth, store)
