"""A forecast as a table of numbers."""

import csv
import io

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import xyzw_from_rotation
from pcnav.evaluation.forecast.point import Forecast, Instant

_PAIRS = ("xx", "xy", "xz", "yy", "yz", "zz")
COLUMNS = (
    *("ahead_s", "time_s", "p_x_m", "p_y_m", "p_z_m", "v_x_m_s", "v_y_m_s", "v_z_m_s"),
    *("q_x", "q_y", "q_z", "q_w"),
    *(f"cov_p_{pair}_m2" for pair in _PAIRS),
    *(f"cov_v_{pair}_m2_s2" for pair in _PAIRS),
    *(f"cov_theta_{pair}_rad2" for pair in _PAIRS),
    *("reach_p", "reach_v", "reach_theta", "radius95_m", "radius95_m_s", "angle95_deg"),
    *("facing_5_deg", "facing_50_deg", "facing_95_deg", "probability"),
)
"""Position and velocity in Hill axes, R_hill_body as a quaternion, scalar last; ``theta`` about the
body's axes. The 95 % ellipsoid is ``(x - mean)^T cov^-1 (x - mean) <= reach^2``."""


def forecast_csv(forecast: Forecast) -> str:
    """Header and one row a time."""
    stream = io.StringIO()
    rows = csv.writer(stream, lineterminator="\n")
    rows.writerow(COLUMNS)
    for ahead, instant in zip(forecast.ahead_s.tolist(), forecast.instants, strict=True):
        rows.writerow([ahead, instant.time_s, *_numbers(instant)])
    return stream.getvalue()


def _numbers(at: Instant) -> list[float | str]:
    spreads = (at.position, at.velocity, at.attitude)
    facing = ["", "", ""] if at.facing_rad is None else np.rad2deg(at.facing_rad).tolist()
    return [
        *at.position.mean.tolist(),
        *at.velocity.mean.tolist(),
        *xyzw_from_rotation(at.attitude.mean).tolist(),
        *(value for each in spreads for value in _upper(each.covariance)),
        *(each.reach for each in spreads),
        *(at.position.radius, at.velocity.radius, float(np.rad2deg(at.attitude.radius))),
        *(*facing, at.probability),
    ]


def _upper(covariance: FloatArray) -> list[float]:
    return [float(value) for value in covariance[np.triu_indices(3)]]
