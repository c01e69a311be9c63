"""The forecast of one point of a target: position, velocity, attitude, and which way it faces."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.orbit import R_hill_world
from pcnav.evaluation.forecast.cloud import Cloud
from pcnav.evaluation.forecast.spread import Spread, spread_of_rotations, spread_of_vectors
from pcnav.evaluation.forecast.start import ForecastStart

_N_DRAWN = 2000
"""States: a deviation is then right to 2 %, a share of 95 % to half a percent."""


@dataclass(frozen=True)
class TargetPoint:
    """A point of the target, and which way its surface looks there."""

    name: str
    p_model: FloatArray | None
    """(3,) m, as the mesh has it; None of the mass centre."""
    normal_model: FloatArray | None = None
    """(3,) outward; None of a point without a side."""
    two_sided: bool = False


@dataclass(frozen=True)
class PointMotion:
    """N drawn motions of a point at one time, seen in the turning Hill frame."""

    position: FloatArray
    """(N, 3) from the chaser's mass centre, Hill axes, m."""
    velocity: FloatArray
    """(N, 3) Hill axes, m/s."""
    R_hill_body: FloatArray
    """(N, 3, 3)"""
    facing_rad: FloatArray | None
    """(N,) angle between the normal and the direction to the chaser; None without a normal."""
    turning_rad_s: FloatArray | None
    """(N,) rate at which the normal turns; None without one."""

    @staticmethod
    def of(cloud: Cloud, point: TargetPoint, start: ForecastStart) -> "PointMotion":
        """Of a point in a cloud of states."""
        n = start.mean_motion_rad_s
        R = R_hill_world(cloud.time_s, n) @ cloud.R_world_body
        arm = np.zeros_like(cloud.com_model)
        if point.p_model is not None:
            arm = start.mesh_scale * point.p_model - cloud.com_model
        # A body at rest in the world turns about y of the Hill frame.
        orbit_body = n * R[:, 1]
        rate = cloud.omega_body + orbit_body
        position = cloud.relative[:, :3] + _turned(R, arm)
        velocity = cloud.relative[:, 3:] + _turned(R, np.cross(rate, arm))
        if point.normal_model is None:
            return PointMotion(position, velocity, R, None, None)
        normal = np.broadcast_to(point.normal_model, arm.shape)
        to_chaser = -position / np.linalg.norm(position, axis=1)[:, None]
        cosine = np.sum(to_chaser * _turned(R, normal), axis=1)
        if point.two_sided:
            cosine = np.abs(cosine)
        facing = np.arccos(np.clip(cosine, -1.0, 1.0))
        turning = np.linalg.norm(np.cross(rate, normal), axis=1)
        return PointMotion(position, velocity, R, facing, turning)


@dataclass(frozen=True)
class Limits:
    """What a point must keep to, to be captured; None is no limit."""

    facing_rad: float | None = None
    speed_m_s: float | None = None
    turning_rad_s: float | None = None

    def kept(self, motion: PointMotion) -> FloatArray:
        """(N,) 1 where the motion keeps all of them, else 0."""
        within = np.ones(len(motion.position), dtype=np.bool_)
        if self.facing_rad is not None and motion.facing_rad is not None:
            within &= motion.facing_rad <= self.facing_rad
        if self.speed_m_s is not None:
            within &= np.linalg.norm(motion.velocity, axis=1) <= self.speed_m_s
        if self.turning_rad_s is not None and motion.turning_rad_s is not None:
            within &= motion.turning_rad_s <= self.turning_rad_s
        return within.astype(np.float64)


@dataclass(frozen=True)
class Instant:
    """The forecast at one time."""

    time_s: float
    position: Spread
    """Hill, m."""
    velocity: Spread
    """Hill, m/s."""
    attitude: Spread
    """R_hill_body; errors about the body's axes, rad."""
    facing_rad: FloatArray | None
    """(3,) 5, 50 and 95 % points; None without a normal."""
    probability: float
    """That the point is within the limits."""


@dataclass(frozen=True)
class Forecast:
    """Of a point over times, the first that of the estimate."""

    start: ForecastStart
    point: TargetPoint
    limits: Limits
    instants: tuple[Instant, ...]

    @property
    def ahead_s(self) -> FloatArray:
        """(n,) since the estimate."""
        return np.array([each.time_s for each in self.instants]) - self.start.time_s


def forecast(
    start: ForecastStart,
    point: TargetPoint,
    ahead_s: FloatArray,
    rng: np.random.Generator,
    limits: Limits = Limits(),
    n: int = _N_DRAWN,
) -> Forecast:
    """At increasing times (m,) from the estimate on, s, of so many drawn states."""
    cloud = begin = Cloud.drawn(start, n, rng)
    instants = []
    for ahead in ahead_s.tolist():
        # How strong accelerations are depends on the span: that of a free body's hardly count.
        since = cloud if start.torque_free else begin
        step_s = start.time_s + ahead - since.time_s
        if step_s > 0.0:
            cloud = since.moved(start, step_s, rng)
        instants.append(_instant(cloud.time_s, PointMotion.of(cloud, point, start), limits))
    return Forecast(start, point, limits, tuple(instants))


def _instant(time_s: float, motion: PointMotion, limits: Limits) -> Instant:
    facing = None
    if motion.facing_rad is not None:
        facing = np.quantile(motion.facing_rad, [0.05, 0.5, 0.95])
    return Instant(
        time_s=time_s,
        position=spread_of_vectors(motion.position),
        velocity=spread_of_vectors(motion.velocity),
        attitude=spread_of_rotations(motion.R_hill_body),
        facing_rad=facing,
        probability=float(limits.kept(motion).mean()),
    )


def _turned(R: FloatArray, vectors: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("nij,nj->ni", R, vectors))
