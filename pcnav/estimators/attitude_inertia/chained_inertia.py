"""Attitude, rate and inertia ratios of a free body from a chain of attitudes of one camera.

The model is that of Deng 2024 (`estimator`). That filter takes the errors
of its attitudes as independent; those of a chain share the noise of its key frames. So all
attitudes are fitted as one arc, under the joint covariance of their errors, again whenever the arc
has grown by a share. Between fits the last one is carried on.

A chain that had to begin anew has new body axes. They are tied to the old ones by the attitude
that the motion predicts, of which the new segment then tells nothing: what was learnt goes on.
"""

from dataclasses import dataclass, replace

import numpy as np

from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import log_rotation
from pcnav.estimators.attitude_inertia.estimator import initial_belief
from pcnav.estimators.attitude_inertia.rotation_fit import AttitudeArc, RotationPrior, fit_rotations
from pcnav.estimators.attitude_inertia.rotation_model import (
    THETA,
    RotationState,
    TorqueFreeModel,
    carry,
)
from pcnav.estimators.image_motion.chain import ChainFrame
from pcnav.estimators.image_motion.chain_errors import ChainErrors
from pcnav.filtering.least_squares import ArcGrowth

_FIRST_FIT, _GROWTH = 4, 1.1
_MAX_FITTED = 400
"""Attitudes of a fit; of a longer arc as many, evenly spaced."""
_MIN_SD_RAD = 1e-4
"""Of each attitude beside what the chain states: second-order terms, and the camera itself."""
_MAX_SD_RAD = float(np.radians(1.5))
"""About its worst axis, of a turn that is used: the joint covariance is of first order, and along
the valley of a turn that few features tell that is not enough."""
_TIED_SD_RAD = 0.2
"""A new segment is tied to a prediction better than this, otherwise all begins anew."""
_FREE_RAD2 = 1.0
"""Variance of the attitude that ties a segment: far above the prediction's, so that it tells
nothing, far below where a rotation stops being linear."""
_SILENT = 1e6 * np.eye(3)


@dataclass(frozen=True)
class ChainedEstimate:
    """The estimate at a frame."""

    time_s: float
    state: RotationState
    """(1,)"""
    covariance: FloatArray
    """(11, 11) of its errors."""
    fitted: bool
    """Whether the frame ends a fit; otherwise the last one is carried on."""


class ChainedInertiaEstimator:
    """Takes in the frames of a chain in order of time."""

    def __init__(self, table: AttitudeInertiaTable) -> None:
        self._table = table
        self._model = TorqueFreeModel(table.angular_acceleration_psd_rad2_s3, table.propagation)
        self._number = -1
        self.axes: list[tuple[int, FloatArray]] = []
        """Frames at which new body axes were chosen, and R_world_body (3, 3) there."""
        self._begin_anew()

    def _begin_anew(self) -> None:
        self._errors = ChainErrors()
        self._segment = -1
        self._R_segment_body = np.eye(3)
        self._numbers: list[int] = []
        self._times_s: list[float] = []
        self._attitudes: list[FloatArray] = []
        self._prior: RotationPrior | None = None
        self._start: RotationState | None = None
        self._now: ChainedEstimate | None = None
        self._growth = ArcGrowth(_FIRST_FIT, _GROWTH)

    def step(self, frame: ChainFrame) -> ChainedEstimate | None:
        """Take in a frame; None while too few attitudes are known."""
        self._number += 1
        if self._now is not None:
            self._now = self._carried(self._now, frame.time_s)
        if frame.R_world_body is None or frame.link is None:
            return self._now
        if frame.segment != self._segment:
            self._begin_segment(frame)
        if frame.reference is not None:
            link = frame.link.turned(self._R_segment_body.T)
            self._errors.add(self._number, frame.reference, link)
        if frame.link.worst_sd > _MAX_SD_RAD:
            return self._now
        self._numbers.append(self._number)
        self._times_s.append(frame.time_s)
        self._attitudes.append(frame.R_world_body @ self._R_segment_body)
        if self._growth.is_due(len(self._numbers)):
            self._now = self._fitted() or self._now
        return self._now

    def _begin_segment(self, frame: ChainFrame) -> None:
        """New axes: those of the prediction, or the first."""
        assert frame.R_world_body is not None and frame.link is not None
        now = self._now
        if now is not None and _worst_sd(now.covariance) > _TIED_SD_RAD:
            now = None
        if now is None:
            self._begin_anew()
            self.axes.append((self._number, frame.R_world_body))
        own = np.zeros((3, 3))
        if now is not None:
            own = _FREE_RAD2 * np.eye(3)
            self._R_segment_body = frame.R_world_body.T @ now.state.R_world_body[0]
        self._segment = frame.segment
        self._errors.begin(self._number, frame.link, own)

    def _carried(self, now: ChainedEstimate, time_s: float) -> ChainedEstimate:
        state, covariance = carry(self._model, now.state, now.covariance[None], time_s - now.time_s)
        return ChainedEstimate(time_s, state, covariance[0], False)

    def _fitted(self) -> ChainedEstimate | None:
        """The whole arc as one; None where the fit does not settle."""
        prior, start = self._believed()
        count = len(self._numbers)
        at = np.unique(np.linspace(0, count - 1, min(count, _MAX_FITTED)).round().astype(int))
        noise = self._errors.covariance([self._numbers[k] for k in at])
        noise += _MIN_SD_RAD**2 * np.eye(len(noise))
        # The first attitude is the mean of the prior, and so no measurement.
        noise[:3, :], noise[:, :3] = 0.0, 0.0
        noise[:3, :3] = _SILENT
        arc = AttitudeArc(
            np.array([self._times_s[k] for k in at]),
            np.stack([self._attitudes[k] for k in at])[:, None],
            noise,
        )
        fit = fit_rotations(self._model, prior, arc, start)
        if not fit.converged[0]:
            return None
        self._start = fit.start
        return ChainedEstimate(self._times_s[-1], fit.end, fit.covariance[0], True)

    def _believed(self) -> tuple[RotationPrior, RotationState]:
        """The prior, and where the next fit begins: the last, at first the rate just seen."""
        if self._prior is not None and self._start is not None:
            return self._prior, self._start
        rate, parameters, covariance = initial_belief(self._table)
        covariance[THETA, THETA] = _MIN_SD_RAD**2 * np.eye(3)
        first, second = self._attitudes[0], self._attitudes[1]
        seen = log_rotation(first.T @ second) / (self._times_s[1] - self._times_s[0])
        mean = RotationState(first[None], rate[None], parameters[None])
        self._prior = RotationPrior(mean, covariance)
        return self._prior, replace(mean, omega_body=seen[None])


def _worst_sd(covariance: FloatArray) -> float:
    return float(np.sqrt(np.linalg.eigvalsh(covariance[THETA, THETA])[-1]))
