"""Simulating the feature tracks of a whole pipeline file into a recording folder."""

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.dynamics.rigid_body import ratios_from_inertia
from pcnav.dynamics.state import NavigationState
from pcnav.recordings.track_files import write_tracks
from pcnav.simulation.feature_motion import FeatureTruth
from pcnav.simulation.features import feature_scenario, simulate_features

_LOG = logging.getLogger("pcnav")


@dataclass(frozen=True)
class TracksSummary:
    """What `simulate_tracks` wrote."""

    path: Path
    frames: int
    empty_frames: int
    """Frames without a single feature."""
    features: int
    median_seen: float
    """Median number of features seen in a frame."""

    @property
    def text(self) -> str:
        """In a line."""
        return (
            f"tracks: {self.path} ({self.frames} frames, {self.empty_frames} of them empty; "
            f"median of {self.median_seen:g} of {self.features} features each)"
        )


def simulate_tracks(
    pipeline: Pipeline, out: Path, overwrite: bool = False, source: Path | str = "pipeline"
) -> TracksSummary:
    """Write tracks, rig, attitude and truth of a scenario; the same pipeline, the same numbers.

    ``source`` is the pipeline's file, which an `InputError` names: for a scenario that cannot be
    simulated, and for a folder that must not be replaced. Nothing is then left behind.
    """
    scenario = feature_scenario(pipeline, source)
    tracks, truth = simulate_features(scenario, np.random.default_rng(pipeline.seed))
    write_tracks(out, tracks, true_states(truth), truth.points, overwrite)
    seen = np.array([len(frame.features) for frame in tracks.frames])
    if not seen.any():
        _LOG.warning("%s: no feature is seen in any of the %d frames", out, len(seen))
    return TracksSummary(
        path=out,
        frames=len(seen),
        empty_frames=int((seen == 0).sum()),
        features=len(truth.points),
        median_seen=float(np.median(seen)),
    )


def true_states(truth: FeatureTruth) -> list[NavigationState]:
    """The truth of every frame as the rows of truth.csv have it."""
    ratios = ratios_from_inertia(truth.inertia)
    motion = zip(truth.r_hill, truth.v_hill, truth.R_world_body, truth.omega_body, strict=True)
    return [NavigationState(r, v, np.zeros(3), R, omega, ratios) for r, v, R, omega in motion]
