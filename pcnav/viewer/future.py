"""Where a run's last estimate says that the target will be, for the ghost of a forecast."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import make_transform
from pcnav.dynamics.blocks import ATTITUDE
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.evaluation.forecast.point import TargetPoint, forecast
from pcnav.evaluation.forecast.start import read_start

AHEAD_S = (5.0, 10.0, 30.0, 60.0, 120.0)
_N_DRAWN = 500
"""States: a deviation is then right to 3 %, which is more than an eye sees."""


@dataclass(frozen=True)
class FuturePose:
    """The target at one time to come."""

    T_cam_model: FloatArray
    """(4, 4) the mean, seen by the camera of the last estimate as it goes on in its orbit."""
    covariance_cam: FloatArray
    """(3, 3) of the model origin, camera axes, m^2."""
    reach: float
    """So many deviations hold 95 % of the motions drawn."""
    radius_rad: float
    """The attitude is within this angle of the mean in 95 % of them."""


def future_poses(
    folder: Path, T_cam_model: FloatArray, ahead_s: tuple[float, ...] = AHEAD_S
) -> dict[float, FuturePose] | None:
    """By the time ahead, from the last estimate, whose pose (4, 4) is given; None of a run whose
    future cannot be told."""
    try:
        start, _, run = read_start(folder)
    except InputError:
        return None
    last = int(np.flatnonzero(run.has_estimate)[-1])
    seed = 0 if run.pipeline is None else run.pipeline.seed
    origin = TargetPoint("model origin", np.zeros(3))
    times = np.array([0.0, *ahead_s])
    told = forecast(start, origin, times, np.random.default_rng(seed), n=_N_DRAWN)
    R_cam_world = T_cam_model[:3, :3] @ run.trajectory[ATTITUDE][last].T
    R_hill_world = KeplerOrbit(start.mean_motion_rad_s).R_hill_world(start.time_s)
    R_cam_hill = R_cam_world @ R_hill_world.T
    now, *later = told.instants
    return {
        ahead: FuturePose(
            make_transform(
                R_cam_hill @ at.attitude.mean,
                T_cam_model[:3, 3] + R_cam_hill @ (at.position.mean - now.position.mean),
            ),
            R_cam_hill @ at.position.covariance @ R_cam_hill.T,
            at.position.reach,
            at.attitude.radius,
        )
        for ahead, at in zip(ahead_s, later, strict=True)
    }
