"""Simulating attitudes of a tumbling target as another instrument would give them, and truth."""

from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.spatial import exp_rotation
from pcnav.files.new_folder import new_folder
from pcnav.recordings.attitudes import ATTITUDES_FILE, write_attitudes
from pcnav.simulation.images import write_true_states
from pcnav.simulation.scenario import true_motion


def simulate_attitudes(
    pipeline: Pipeline, out: Path, overwrite: bool = False, source: Path | str = "pipeline"
) -> str:
    """Write attitudes with the noise of [attitude_inertia], and the truth; what it was, in a line.

    ``source`` is the pipeline's file, which an `InputError` names: for a scenario that cannot be
    simulated, and for a folder that must not be replaced. Nothing is then left behind.
    """
    truth = true_motion(pipeline, source)
    rng, sd_deg = np.random.default_rng(pipeline.seed), pipeline.attitude_inertia.attitude_sd_deg
    count = len(truth.times_s)
    R = np.stack([state.R_world_body for state in truth.states])
    seen = R @ exp_rotation(np.radians(sd_deg) * rng.standard_normal((count, 3)))
    with new_folder(out, overwrite, ATTITUDES_FILE) as folder:
        write_attitudes(folder, truth.times_s, seen)
        write_true_states(folder, truth.times_s, truth.states)
    return f"attitudes: {out} ({count} of {sd_deg:g} deg about each axis)"
