"""Rotation and inertia of a free body, frame by frame: from recorded attitudes, or from images."""

from dataclasses import replace

import numpy as np

from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import ATTITUDE, RATE, RATIOS, ROTATION_LAYOUT
from pcnav.dynamics.inertia_parameters import ratios_from_parameters, ratios_jacobian
from pcnav.estimators.attitude_inertia.chained_inertia import ChainedInertiaEstimator
from pcnav.estimators.attitude_inertia.estimator import AttitudeInertiaEstimator, RotationEstimate
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    SIZE,
    RotationState,
    TorqueFreeModel,
    carry,
)
from pcnav.estimators.image_motion.chain import ImageMotionChain
from pcnav.estimators.image_motion.outcomes import feature_outcomes, outcome_in_words
from pcnav.estimators.interface import Estimator, Given
from pcnav.recordings.attitudes import MeasuredAttitude
from pcnav.recordings.tracks import TrackFrame
from pcnav.runs.estimate import Estimate, FeatureUse, Note, Output
from pcnav.runs.status import Status

_MEASURED_SD = "sd_measured_rad"
_NIS_DOF = 3
"""Of an attitude."""


class RecordedAttitudes(Estimator):
    """The filter of Deng 2024, carried on where there is no attitude."""

    output = Output(ROTATION_LAYOUT, notes=(_MEASURED_SD,))

    def __init__(self, table: AttitudeInertiaTable) -> None:
        self._filter = AttitudeInertiaEstimator(table)
        self._model = TorqueFreeModel(table.angular_acceleration_psd_rad2_s3, table.propagation)
        self._noise = np.radians(table.attitude_sd_deg) ** 2 * np.eye(3)
        self._last: RotationEstimate | None = None

    def step(self, frame: MeasuredAttitude, /) -> Estimate:
        """See `Estimator`."""
        time_s = frame.time_s
        if frame.R_world_body is not None:
            noise = self._noise if frame.covariance is None else frame.covariance
            last = self._last = self._filter.step(time_s, frame.R_world_body, noise)
            found = (last.state, last.covariance[0])
            return _answer(time_s, found, noise, float(last.nis[0]), bool(last.accepted[0]))
        if self._last is None:
            return _answer(time_s, None, None)
        before = self._last
        state, P = carry(self._model, before.state, before.covariance, time_s - before.time_s)
        return _answer(time_s, (state, P[0]), None)


class ChainedAttitudes(Estimator):
    """The attitudes of a chain of images, whose whole arc is fitted as it grows."""

    output = Output(ROTATION_LAYOUT, notes=(_MEASURED_SD, "outcome"), has_feature_outcomes=True)

    def __init__(self, given: Given) -> None:
        about, self._settings = given.about, given.pipeline.image_motion
        self._chain = ImageMotionChain(about.camera, about.pixel_sigma_px, self._settings)
        self._fits = ChainedInertiaEstimator(given.pipeline.attitude_inertia)

    def step(self, frame: TrackFrame, /) -> Estimate:
        """See `Estimator`."""
        seen, begun = self._chain.step(frame), len(self._fits.axes)
        found = self._fits.step(seen)
        state = None if found is None else (found.state, found.covariance)
        noise = seen.covariance if seen.reference is not None else None
        answer = _answer(
            seen.time_s,
            state,
            noise,
            words={"outcome": outcome_in_words(seen.outcome, self._settings)},
            new_axes=self._fits.axes[-1][1] if len(self._fits.axes) > begun else None,
        )
        outcomes = feature_outcomes(seen, frame.features)
        return replace(answer, features=FeatureUse(outcomes=outcomes))


def _answer(
    time_s: float,
    state: tuple[RotationState, FloatArray] | None,
    noise: FloatArray | None,
    nis: float = float("nan"),
    accepted: bool = True,
    *,
    words: dict[str, Note] | None = None,
    new_axes: FloatArray | None = None,
) -> Estimate:
    """One frame of a run.

    Args:
        time_s: of the frame.
        state: of one body, and the covariance (11, 11) of its errors; None without an estimate.
        noise: (3, 3) of the attitude taken in, rad^2; None without one.
        nis: of its innovation.
        accepted: whether it passed the gate.
        words: of the notes.
        new_axes: see `Estimate`.
    """
    rms = None if noise is None else float(np.sqrt(np.trace(noise) / 3.0))
    status = Status.ACQUIRING
    if state is not None:
        status = Status.LOCKED if noise is not None and accepted else Status.COASTING
    values, covariance = ({}, None) if state is None else _reported(*state)
    return Estimate(
        time_s=time_s,
        status=str(status),
        values=values,
        covariance=covariance,
        nis=nis,
        nis_dof=0 if np.isnan(nis) else _NIS_DOF,
        notes={_MEASURED_SD: rms, **(words or {})},
        new_axes=new_axes,
    )


def _reported(
    state: RotationState, covariance: FloatArray
) -> tuple[dict[str, FloatArray], FloatArray]:
    """Attitude, rate, ratios over Ixx and the covariance of all three."""
    parameters = state.parameters.reshape(5)
    change = np.eye(SIZE)
    change[INERTIA, INERTIA] = ratios_jacobian(parameters)
    values = {
        ATTITUDE.name: state.R_world_body.reshape(3, 3),
        RATE.name: state.omega_body.reshape(3),
        RATIOS.name: ratios_from_parameters(parameters),
    }
    return values, change @ covariance @ change.T
