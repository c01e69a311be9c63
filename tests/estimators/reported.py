"""What an estimator on stereo tracks reported, by name."""

from pcnav.dynamics.blocks import ATTITUDE, POSITION, RATE, RATIOS, VELOCITY
from pcnav.estimators.features.answer import Motion
from pcnav.runs.estimate import Estimate


def motion_of(estimate: Estimate) -> Motion:
    """Fails where nothing was estimated."""
    assert estimate.covariance is not None
    blocks = (POSITION, VELOCITY, ATTITUDE, RATE, RATIOS)
    r, v, R, omega, ratios = (estimate[block] for block in blocks)
    return Motion(r, v, R, omega, ratios, estimate.covariance, estimate.features.points)
