"""Figs. 2-6: the printed filter and pcnav's on the printed motions."""

from dataclasses import dataclass

import numpy as np

from pcnav.config.attitude_inertia import AttitudeInertiaTable, Propagation
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, xyzw_from_rotation
from pcnav.estimators.attitude_inertia.estimator import AttitudeInertiaEstimator
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    OMEGA,
    SIZE,
    THETA,
    AttitudeMeasurement,
    RotationState,
    TorqueFreeModel,
    parameters_from_printed,
    printed_covariance,
)
from pcnav.filtering.error_state import ErrorStateFilter

from . import paper
from .paper import Motion

GUESS = AttitudeInertiaTable(
    rate_deg_s=paper.GUESS_RATE_DEG_S,
    rate_sd_deg_s=5.0,
    inertia_ratios_zz=paper.GUESS_RATIOS,
    inertia_ratio_sd=0.4,
    attitude_sd_deg=paper.ATTITUDE_SD_DEG,
    angular_acceleration_psd_rad2_s3=0.0,
)
"""The printed first guess; its uncertainty is not printed."""
_TAKE_ALL = 1.0 - 1e-15
"""The paper has no gate."""


@dataclass(frozen=True)
class FilterRun:
    """A filter's estimates along a motion, the first attitude included."""

    name: str
    motion: Motion
    quaternion_xyzw: FloatArray
    """(n, 4)"""
    omega_body: FloatArray
    """(n, 3) rad/s."""
    ratios: FloatArray
    """(n, 5) Jxx, Jyy, Jxy, Jxz, Jyz over Jzz."""
    errors: FloatArray
    """(n, 11) estimate to truth: attitude (rad), rate (rad/s), printed ratios."""
    sd: FloatArray
    """(n, 11) as stated by the filter."""

    def rms(self, block: slice) -> float:
        """Of the error's components over the second half of the run."""
        late = self.errors[len(self.errors) // 2 :, block]
        return float(np.sqrt(np.mean(late**2)))


def measured(motion: Motion, half_angle_sd: float, seed: int) -> FloatArray:
    """(n, 3, 3) attitudes with errors about the body axes."""
    rng = np.random.default_rng(seed)
    errors = 2.0 * half_angle_sd * rng.standard_normal((len(motion.times_s), 3))
    # The first attitude defines the body axes and holds no error.
    errors[0] = 0.0
    return np.asarray(motion.R_world_body @ exp_rotation(errors))


def printed_run(name: str, motion: Motion, attitudes: FloatArray) -> FilterRun:
    """The filter of (36): Euler steps, one linearisation, Q and R as printed."""
    covariance = np.zeros((SIZE, SIZE))
    covariance[THETA, THETA] = 4.0 * paper.PRINTED_VARIANCE * np.eye(3)
    covariance[OMEGA, OMEGA] = np.radians(GUESS.rate_sd_deg_s) ** 2 * np.eye(3)
    covariance[INERTIA, INERTIA] = GUESS.inertia_ratio_sd**2 * np.eye(5)
    state = RotationState(
        attitudes[0],
        np.radians(GUESS.rate_deg_s),
        parameters_from_printed(np.array(GUESS.inertia_ratios_zz)),
    )
    kalman = ErrorStateFilter(state, covariance, gate_probability=_TAKE_ALL, max_iterations=1)
    model = TorqueFreeModel(0.0, Propagation.EULER, paper.PRINTED_VARIANCE)
    noise = 4.0 * paper.PRINTED_VARIANCE * np.eye(3)
    found = [(kalman.state, kalman.covariance)]
    for k in range(1, len(motion.times_s)):
        before = float(motion.times_s[k - 1])
        kalman.predict(model, before, float(motion.times_s[k]) - before)
        kalman.update([AttitudeMeasurement(attitudes[k], noise)])
        found.append((kalman.state, kalman.covariance))
    return _collected(name, motion, found)


def fitted_run(name: str, motion: Motion, attitudes: FloatArray) -> FilterRun:
    """pcnav's estimator from the printed guess, with the same R."""
    estimator = AttitudeInertiaEstimator(GUESS)
    found = []
    for time_s, R in zip(motion.times_s.tolist(), attitudes, strict=True):
        estimate = estimator.step(time_s, R)
        state = estimate.state
        one = RotationState(state.R_world_body[0], state.omega_body[0], state.parameters[0])
        found.append((one, estimate.covariance[0]))
    return _collected(name, motion, found)


def _collected(
    name: str, motion: Motion, found: list[tuple[RotationState, FloatArray]]
) -> FilterRun:
    states = [state for state, _ in found]
    spread = [printed_covariance(state, P) for state, P in found]
    errors = [state.printed_error(motion.truth(k)) for k, state in enumerate(states)]
    return FilterRun(
        name=name,
        motion=motion,
        quaternion_xyzw=continuous(np.stack([state.R_world_body for state in states])),
        omega_body=np.stack([state.omega_body for state in states]),
        ratios=np.stack([state.printed_ratios for state in states]),
        errors=np.array(errors),
        sd=np.sqrt(np.maximum(np.stack([np.diag(P) for P in spread]), 0.0)),
    )


def continuous(R: FloatArray) -> FloatArray:
    """(n, 4) scalar-last quaternions of (n, 3, 3) without jumps of sign."""
    q = xyzw_from_rotation(R)
    flips = np.cumprod(np.where(np.sum(q[1:] * q[:-1], axis=1) < 0.0, -1.0, 1.0))
    q[1:] *= flips[:, None]
    return q
