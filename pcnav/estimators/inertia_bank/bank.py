"""A bank of filters in step, one per inertia hypothesis, over one or many runs at once."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from pcnav.config.inertia_bank import InertiaBankTable
from pcnav.core.arrays import BoolArray, FloatArray, IntArray, chosen, is_finite, picked
from pcnav.core.spatial import skew
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.estimators.inertia_bank.hypotheses import log_likelihood, normalised
from pcnav.estimators.inertia_bank.relative_state import (
    IB_MOTION_SIZE,
    IB_OMEGA,
    IB_R_HILL,
    IB_THETA,
    IB_V_HILL,
    PixelMeasurements,
    PixelsAhead,
    RelativeMotion,
    RelativeStates,
    point_slice,
)
from pcnav.filtering.batched_filter import BatchedFilter, BatchedUpdate

_FASTEST_RAD_S = 10.0
"""No satellite spins faster than this (95 turns a minute): such a filter has run away."""
_PLAUSIBLE = 1e-3
"""A hypothesis of this weight counts in deciding what is a wrong match."""


def start_motion(
    table: InertiaBankTable, positions: FloatArray, R_hill_body: FloatArray
) -> tuple[RelativeStates, FloatArray]:
    """Motion and its covariance (R, 12, 12) at the first frame, without any point yet.

    Of points (R, m, 3) in Hill axes, m, and attitudes (R, 3, 3) as known before: the mass centre
    is expected in the midst of the points. Their median is taken, which a wrong match among them
    does not move far. The rest are the table's priors.
    """
    runs = len(positions)
    states = RelativeStates(
        r_hill=np.median(positions, axis=1),
        v_hill=np.tile(table.velocity_m_s, (runs, 1)),
        R_hill_body=R_hill_body,
        omega_body=np.tile(np.radians(table.rate_deg_s), (runs, 1)),
        points_body=np.zeros((runs, 0, 3)),
        coupled=table.kinematic_coupling,
    )
    sd = np.zeros(IB_MOTION_SIZE)
    sd[IB_R_HILL], sd[IB_V_HILL] = table.mass_centre_sd_m, table.velocity_sd_m_s
    sd[IB_THETA], sd[IB_OMEGA] = np.radians(table.attitude_sd_deg), np.radians(table.rate_sd_deg_s)
    # The priors are independent in body terms.
    to_own = states.motion_from_body_errors()
    return states, (to_own * sd**2) @ np.swapaxes(to_own, -1, -2)


def add_points(
    states: RelativeStates, covariance: FloatArray, positions: FloatArray, noise: FloatArray
) -> tuple[RelativeStates, FloatArray]:
    """States and covariances (B, n, n) with triangulated points (B, m, 3), Hill axes, added.

    Their covariances (B, m, 3, 3) are independent of all that is known. As positions they are
    appended as they are; as points of the body they take over errors of mass centre and attitude.
    """
    batch, n = covariance.shape[:2]
    m = positions.shape[1]
    arms = (positions - states.r_hill[:, None]) @ states.R_hill_body
    own_axes = np.eye(3) if states.coupled else np.swapaxes(states.R_hill_body, -1, -2)
    by_known = np.zeros((batch, 3 * m, n))
    if not states.coupled:
        for i in range(m):
            by_known[:, 3 * i : 3 * i + 3, IB_R_HILL] = -own_axes
            by_known[:, 3 * i : 3 * i + 3, IB_THETA] = skew(arms[:, i])
    larger = np.zeros((batch, n + 3 * m, n + 3 * m))
    larger[:, :n, :n] = covariance
    cross = by_known @ covariance
    larger[:, n:, :n], larger[:, :n, n:] = cross, np.swapaxes(cross, -1, -2)
    larger[:, n:, n:] = cross @ np.swapaxes(by_known, -1, -2)
    for i in range(m):
        rows = slice(n + 3 * i, n + 3 * i + 3)
        larger[:, rows, rows] += own_axes @ noise[:, i] @ np.swapaxes(own_axes, -1, -2)
    points = np.concatenate([states.points_body, arms], axis=1)
    return states.with_points(points), larger


def keep_points(
    states: RelativeStates, covariance: FloatArray, kept: IntArray
) -> tuple[RelativeStates, FloatArray]:
    """States and covariances with these points only: the others are marginalised."""
    rows = np.concatenate(
        [np.arange(IB_MOTION_SIZE), *(np.r_[point_slice(int(i))] for i in kept)]
    ).astype(np.intp)
    return states.with_points(states.points_body[:, kept]), covariance[:, rows[:, None], rows]


def triangulated(
    rig: StereoRig, R_rig_hill: FloatArray, pixels: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Points (..., 3) and covariances (..., 3, 3) of pixels (..., 4), in Hill axes."""
    points, noise = rig.triangulate(pixels)
    return np.asarray(points @ R_rig_hill), np.asarray(R_rig_hill.T @ noise @ R_rig_hill)


class InertiaBank:
    """R runs of h filters each, which differ in the inertia they assume."""

    def __init__(
        self,
        table: InertiaBankTable,
        orbit: KeplerOrbit,
        inertia: FloatArray,
        start: tuple[RelativeStates, FloatArray],
        time_s: float,
    ) -> None:
        """With inertia matrices (R, h, 3, 3) and the start of the R runs, the same for all h."""
        self._runs, self._h = inertia.shape[:2]
        self._every: IntArray = np.repeat(np.arange(self._runs, dtype=np.intp), self._h)
        states, covariance = start
        self._table, self.time_s, self._initialised = table, time_s, False
        self.inertia = inertia
        flat = inertia.reshape(-1, 3, 3)
        self._model = RelativeMotion(
            orbit,
            flat,
            np.asarray(np.linalg.inv(flat), dtype=np.float64),
            table.acceleration_psd_m2_s3,
            table.angular_acceleration_psd_rad2_s3,
        )
        self._filter = BatchedFilter(
            picked(states, self._every),
            covariance[self._every],
            gate_probability=table.gate_probability,
            max_iterations=table.max_iterations,
        )
        prior = np.array(table.prior or np.ones(self._h))
        self.log_posterior = np.tile(np.log(prior / prior.sum()), (self._runs, 1))
        self.broken: BoolArray = np.zeros(self._runs * self._h, dtype=np.bool_)
        """(R h,) filters whose numbers broke down: they stay as they last were, with weight 0."""

    @property
    def states(self) -> RelativeStates:
        """(R h,) run after run."""
        return self._filter.states

    @property
    def covariance(self) -> FloatArray:
        """(R h, n, n) of their errors."""
        return self._filter.covariance

    def weights(self) -> FloatArray:
        """(R, h) probabilities of the hypotheses."""
        return normalised(self.log_posterior)

    def plausible(self) -> BoolArray:
        """(R, h) hypotheses that may be true: a point that one of them explains is taken in."""
        return np.asarray(self.weights() >= _PLAUSIBLE)

    def predict(self, time_s: float) -> None:
        """Move all filters to a time."""
        if time_s != self.time_s:
            with self._breaking():
                self._filter.predict(self._model, self.time_s, time_s - self.time_s)
            self.time_s = time_s

    def step(self, time_s: float, seen: PixelMeasurements | None) -> BatchedUpdate | None:
        """Move all filters to a time and take in what the runs saw then, pixels (R, m, 3).

        The first frame after the start is taken in ahead of the prediction; see `PixelsAhead`.
        """
        if seen is None:
            self.predict(time_s)
            return None
        seen = seen.take(self._every)
        if self._initialised:
            self.predict(time_s)
            return self._update(seen)
        self._initialised = True
        ahead = PixelsAhead(seen, self._model, self.time_s, time_s - self.time_s)
        result = self._update(ahead)
        self.predict(time_s)
        return result

    def _update(self, seen: PixelMeasurements | PixelsAhead) -> BatchedUpdate:
        """Update all filters and weigh the hypotheses."""
        with self._breaking():
            result = self._filter.update(seen, self._agreed)
        gained = log_likelihood(result, self._table.likelihood, seen.noise)
        gained = np.where(self.broken, 0.0, gained)
        self.log_posterior = self.log_posterior + gained.reshape(self._runs, self._h)
        return result

    @contextmanager
    def _breaking(self) -> Iterator[None]:
        """Filters whose numbers break down in the block, or did before, stay as they were.

        Under an inertia that no body can have, Euler's equation may let rates grow without bound.
        """
        states, covariance = self._filter.states, self._filter.covariance
        with np.errstate(over="ignore", invalid="ignore"):
            yield
        now = self._filter
        sound = is_finite(now.states) & np.isfinite(now.covariance).all(axis=(1, 2))
        with np.errstate(invalid="ignore", over="ignore"):
            sound &= np.linalg.norm(now.states.omega_body, axis=1) < _FASTEST_RAD_S
        self.broken = self.broken | ~sound
        if self.broken.any():
            lost = self.broken.reshape(self._runs, self._h)
            self.log_posterior = np.where(lost, -np.inf, self.log_posterior)
            now.states = chosen(self.broken, states, now.states)
            now.covariance = np.where(self.broken[:, None, None], covariance, now.covariance)

    def _agreed(self, accepted: BoolArray) -> BoolArray:
        """(R h, m) what is used: the same in all filters of a run, else they cannot be compared.

        A point that any plausible hypothesis explains is no wrong match.
        """
        by_run = accepted.reshape(self._runs, self._h, -1)
        agreed = np.any(by_run & self.plausible()[..., None], axis=1, keepdims=True)
        return np.broadcast_to(agreed, by_run.shape).reshape(accepted.shape)

    def add(self, positions: FloatArray, noise: FloatArray) -> None:
        """Add points (R, m, 3) with covariances (R, m, 3, 3), Hill axes."""
        self._filter.states, self._filter.covariance = add_points(
            self.states, self.covariance, positions[self._every], noise[self._every]
        )

    def keep(self, kept: IntArray) -> None:
        """Forget all points but these."""
        self._filter.states, self._filter.covariance = keep_points(
            self.states, self.covariance, kept
        )
