"""Attitudes of a tumbling target as another instrument would give them."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.blocks import ATTITUDE
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.attitudes import AttitudeRecording, write_attitudes
from pcnav.simulation.depth import OnFrame
from pcnav.simulation.motion import true_motion


class AttitudeSimulation(NamedTuple):
    """Attitudes in memory, and the truth behind them."""

    recording: AttitudeRecording
    truth: Trajectory
    sd_deg: float
    """Of their errors, about each axis."""

    def write(self, out: Path, overwrite: bool = False, on_frame: OnFrame | None = None) -> str:
        """Write both; what it was, in a line. Raises `InputError` for a folder that must not be
        replaced."""
        write_attitudes(out, self.recording, self.truth, overwrite)
        return f"attitudes: {out} ({len(self.recording)} of {self.sd_deg:g} deg about each axis)"


def simulate_attitudes(
    pipeline: Pipeline, source: Path | str = "pipeline", target_mesh: Path | None = None
) -> AttitudeSimulation:
    """Attitudes with the noise of [attitude_inertia].

    ``source`` is the pipeline's file, which an `InputError` names for a scenario that cannot be
    simulated. A mesh is not needed.
    """
    truth = true_motion(pipeline, source).truth
    rng, sd_deg = np.random.default_rng(pipeline.seed), pipeline.attitude_inertia.attitude_sd_deg
    errors = np.radians(sd_deg) * rng.standard_normal((len(truth), 3))
    R_seen = truth[ATTITUDE] @ exp_rotation(errors)
    recording = AttitudeRecording(Path(source).stem, truth.time_s, R_seen)
    return AttitudeSimulation(recording, truth, sd_deg)
