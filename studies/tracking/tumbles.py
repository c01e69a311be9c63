"""Tumbles of boxsat: what blackouts, repeated runs and faults happen to."""

from pcnav.config.pipeline_file import Pipeline
from pcnav.simulation.random_truth import Satellite, Spread, random_truth, satellite

FRAME_RATE_HZ = 2.0
_SPREAD = Spread(range_m=(15.0, 30.0), rate_deg_s=(1.0, 5.0), speed_m_s=0.02)


def boxsat() -> Satellite:
    """The target and the pipeline that is shipped with it."""
    return satellite("boxsat")


def tumble(seed: int, frames: int) -> Pipeline:
    """One with the truth and the noise of the seed."""
    return random_truth(boxsat(), _SPREAD, seed, frames=frames, frame_rate_hz=FRAME_RATE_HZ)
