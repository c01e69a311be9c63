"""The chaser's orbit as an ellipse, and motion relative to it without linearisation.

Hill axes (DESIGN): x along-track (in the plane, perpendicular to the radius), y minus orbit normal,
z nadir. They turn by minus the rate of the true anomaly about y. A mean motion of 0 is a laboratory
at rest: straight lines, and nothing is divided by it.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.integrate import solve_ivp

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import skew
from pcnav.dynamics.orbit import EARTH_MU_M3_S2

_NEWTON_STEPS = 50
_NEWTON_TOLERANCE_RAD = 1e-15
_MAX_ANOMALY_STEP_RAD = 0.02
"""Of one Runge-Kutta step: the error, of order step^5 / 120, stays below 1e-9 of the motion."""


@dataclass(frozen=True)
class OrbitPoint:
    """Where the chaser is on its ellipse."""

    anomaly_rad: float
    """True anomaly, which grows past 2 pi."""
    rate_rad_s: float
    acceleration_rad_s2: float
    radius_m: float
    """Infinite for a laboratory."""
    attraction_s2: float
    """Gravitational parameter over the radius cubed, 1/s^2."""


@dataclass(frozen=True)
class KeplerOrbit:
    """The chaser's orbit about the Earth; a mean motion of 0 is a laboratory at rest.

    Raises `ValueError` for anything but an ellipse.
    """

    mean_motion_rad_s: float
    eccentricity: float = 0.0
    true_anomaly_rad: float = 0.0
    """At time 0."""

    def __post_init__(self) -> None:
        if not 0.0 <= self.eccentricity < 1.0:
            raise ValueError(f"eccentricity {self.eccentricity}: expected 0 to below 1")
        if not self.mean_motion_rad_s >= 0.0:
            raise ValueError(f"mean motion {self.mean_motion_rad_s}: expected 0 or more")

    def at(self, time_s: float) -> OrbitPoint:
        """The chaser at a time: Kepler's equation and the area law."""
        return _orbit_point(self, float(time_s))

    def R_hill_world(self, time_s: float) -> FloatArray:
        """(3, 3) rotation from world to Hill components, Rot_y(nu(t) - nu(0))."""
        angle = self.at(time_s).anomaly_rad - self.true_anomaly_rad
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


@lru_cache(maxsize=8192)
def _orbit_point(orbit: KeplerOrbit, time_s: float) -> OrbitPoint:
    n, e = orbit.mean_motion_rad_s, orbit.eccentricity
    if n == 0.0:
        return OrbitPoint(orbit.true_anomaly_rad, 0.0, 0.0, float("inf"), 0.0)
    start = eccentric_anomaly_of(orbit.true_anomaly_rad, e)
    mean = start - e * np.sin(start) + n * time_s
    anomaly = eccentric_anomaly(float(mean), e)
    distance = 1.0 - e * np.cos(anomaly)
    rate = n * np.sqrt(1.0 - e**2) / distance**2
    acceleration = -2.0 * rate * n * e * np.sin(anomaly) / distance**2
    radius = np.cbrt(EARTH_MU_M3_S2 / n**2) * distance
    return OrbitPoint(
        anomaly_rad=true_anomaly_of(anomaly, e),
        rate_rad_s=float(rate),
        acceleration_rad_s2=float(acceleration),
        radius_m=float(radius),
        attraction_s2=float(n**2 / distance**3),
    )


def eccentric_anomaly(mean_anomaly_rad: float, eccentricity: float) -> float:
    """Eccentric anomaly E of ``M = E - e sin E``, rad, by Newton's method, kept in its bracket."""
    turns = 2.0 * np.pi * np.round(mean_anomaly_rad / (2.0 * np.pi))
    mean = mean_anomaly_rad - turns
    low, high = mean - eccentricity, mean + eccentricity
    anomaly = mean + eccentricity * np.sin(mean)
    for _ in range(_NEWTON_STEPS):
        excess = anomaly - eccentricity * np.sin(anomaly) - mean
        # The equation grows in E, so its sign tells the side the root is on.
        low, high = (low, min(high, anomaly)) if excess > 0.0 else (max(low, anomaly), high)
        step = excess / (1.0 - eccentricity * np.cos(anomaly))
        if abs(step) <= _NEWTON_TOLERANCE_RAD * max(1.0, abs(anomaly)):
            break
        anomaly -= step
        if not low <= anomaly <= high:
            anomaly = 0.5 * (low + high)
    return float(anomaly + turns)


def true_anomaly_of(eccentric_anomaly_rad: float, eccentricity: float) -> float:
    """True anomaly, rad, of an eccentric one; both grow past 2 pi together (Battin 1999)."""
    beta = eccentricity / (1.0 + np.sqrt(1.0 - eccentricity**2))
    sine, cosine = np.sin(eccentric_anomaly_rad), np.cos(eccentric_anomaly_rad)
    return float(eccentric_anomaly_rad + 2.0 * np.arctan2(beta * sine, 1.0 - beta * cosine))


def eccentric_anomaly_of(true_anomaly_rad: float, eccentricity: float) -> float:
    """Eccentric anomaly, rad, of a true one; the inverse of `true_anomaly_of`."""
    beta = eccentricity / (1.0 + np.sqrt(1.0 - eccentricity**2))
    sine, cosine = np.sin(true_anomaly_rad), np.cos(true_anomaly_rad)
    return float(true_anomaly_rad - 2.0 * np.arctan2(beta * sine, 1.0 + beta * cosine))


def relative_acceleration(
    orbit: KeplerOrbit, r_hill: FloatArray, v_hill: FloatArray, time_s: float
) -> FloatArray:
    """(..., 3) acceleration seen in the turning Hill axes, m/s^2, exact for two point masses.

    Segal 2011 (18) in Hill axes, with the lost sign of its along-track line. The difference of the
    two attractions is formed without cancellation (Battin 1999, section 8.4). Batched over leading
    dimensions of r_hill (m) and v_hill (m/s).
    """
    point = orbit.at(time_s)
    if point.attraction_s2 == 0.0:
        return np.zeros(np.broadcast_shapes(r_hill.shape, v_hill.shape))
    by_r, by_v = _frame_terms(point)
    radius = point.radius_m
    q = (np.sum(r_hill * r_hill, axis=-1) - 2.0 * radius * r_hill[..., 2]) / radius**2
    power = -1.5 * np.log1p(q)
    gravity = -point.attraction_s2 * np.exp(power)[..., None] * r_hill
    # The chaser lies at -radius on the nadir axis through the Earth's centre.
    gravity[..., 2] += point.attraction_s2 * radius * np.expm1(power)
    return np.asarray(gravity + r_hill @ by_r.T + v_hill @ by_v.T)


def relative_jacobian(
    orbit: KeplerOrbit, r_hill: FloatArray, time_s: float
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of `relative_acceleration` by r (..., 3, 3) and by v (3, 3)."""
    point = orbit.at(time_s)
    if point.attraction_s2 == 0.0:
        return np.zeros((*r_hill.shape, 3)), np.zeros((3, 3))
    by_r, by_v = _frame_terms(point)
    # From the Earth's centre, in units of the chaser's radius.
    p = r_hill / point.radius_m - np.array([0.0, 0.0, 1.0])
    square = np.sum(p * p, axis=-1)[..., None, None]
    gradient = 3.0 * p[..., :, None] * p[..., None, :] / square - np.eye(3)
    return np.asarray(point.attraction_s2 * square**-1.5 * gradient + by_r), by_v


def _frame_terms(point: OrbitPoint) -> tuple[FloatArray, FloatArray]:
    """(3, 3) accelerations of the turning axes per metre and per metre a second."""
    turn = skew(np.array([0.0, -point.rate_rad_s, 0.0]))
    return (
        -skew(np.array([0.0, -point.acceleration_rad_s2, 0.0])) - turn @ turn,
        -2.0 * turn,
    )


def step_relative(
    orbit: KeplerOrbit, r_hill: FloatArray, v_hill: FloatArray, time_s: float, step_s: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """r and v (..., 3) after a time step, and their transition matrix (..., 6, 6).

    Runge-Kutta of order 4 on the motion and its variational equations, in as many steps as keep
    the turn of the Hill axes small. Meant for filters; truth comes from `propagate_relative`.
    """
    turn = orbit.at(time_s + 0.5 * step_s).rate_rad_s * abs(step_s)
    steps = max(1, int(np.ceil(turn / _MAX_ANOMALY_STEP_RAD)))
    h = step_s / steps
    shape = np.broadcast_shapes(r_hill.shape, v_hill.shape)
    # Column 0 is the motion, the others its derivatives by the start.
    y = np.zeros((*shape[:-1], 6, 7))
    y[..., :3, 0], y[..., 3:, 0] = r_hill, v_hill
    y[..., :, 1:] = np.eye(6)
    for k in range(steps):
        t = time_s + k * h
        k1 = _slope(orbit, y, t)
        k2 = _slope(orbit, y + 0.5 * h * k1, t + 0.5 * h)
        k3 = _slope(orbit, y + 0.5 * h * k2, t + 0.5 * h)
        k4 = _slope(orbit, y + h * k3, t + h)
        y = y + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)
    return y[..., :3, 0], y[..., 3:, 0], y[..., :, 1:]


def _slope(orbit: KeplerOrbit, y: FloatArray, time_s: float) -> FloatArray:
    by_r, by_v = relative_jacobian(orbit, y[..., :3, 0], time_s)
    slope = np.empty_like(y)
    slope[..., :3, :] = y[..., 3:, :]
    slope[..., 3:, 0] = relative_acceleration(orbit, y[..., :3, 0], y[..., 3:, 0], time_s)
    slope[..., 3:, 1:] = by_r @ y[..., :3, 1:] + by_v @ y[..., 3:, 1:]
    return slope


def propagate_relative(
    orbit: KeplerOrbit, r_hill: FloatArray, v_hill: FloatArray, times_s: FloatArray
) -> FloatArray:
    """(n, 6) relative position and velocity, Hill axes, at increasing times; state given at [0].

    Integrated with DOP853 to a relative tolerance of 1e-12.
    """

    def derivative(t: float, state: FloatArray) -> FloatArray:
        acceleration = relative_acceleration(orbit, state[:3], state[3:], t)
        return np.concatenate([state[3:], acceleration])

    start = np.concatenate([r_hill, v_hill])
    if len(times_s) == 1:
        return start[None, :]
    span = (float(times_s[0]), float(times_s[-1]))
    solution = solve_ivp(
        derivative, span, start, method="DOP853", t_eval=times_s, rtol=1e-12, atol=1e-12
    )
    return np.asarray(solution.y.T)
