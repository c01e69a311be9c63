"""Relative motion of a target without a model, in its unique principal axes (Hu 2024).

Frames are gathered until an arc shows motion and inertia (`arc_start`); from then
on a filter follows them (`feature_following`): the pixels of every feature, each
once. In print the filter takes the attitude of the principal frame and the points, which come from
the same pixels, as independent measurements; that is an option. Frames without features are coasted
through.
"""

from dataclasses import replace

import numpy as np

from pcnav.config.principal_axes import PrincipalAxesTable
from pcnav.core.arrays import FloatArray
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.estimators.features.answer import Used, stereo_estimate, stereo_output
from pcnav.estimators.features.bookkeeping import check_frame
from pcnav.estimators.interface import Estimator
from pcnav.estimators.principal_axes.arc_start import start_from_arc
from pcnav.estimators.principal_axes.feature_following import FeatureFollower, Taken
from pcnav.estimators.principal_axes.feature_states import PrincipalState
from pcnav.estimators.principal_axes.principal_choice import (
    NOTES,
    reported_motion,
)
from pcnav.recordings.tracks import TrackFrame
from pcnav.runs.estimate import Estimate
from pcnav.runs.status import Status

_MIN_POINTS = 3
_TRY_EVERY = 0.25
"""Of the shortest arc, between tries to start."""


class PrincipalAxesEstimator(Estimator):
    """Consumes frames of stereo tracks; nothing of the target is known before."""

    output = stereo_output(NOTES)

    def __init__(
        self, rig: StereoRig, orbit: KeplerOrbit, table: PrincipalAxesTable, seed: int = 0
    ) -> None:
        """``seed`` is that of the draws of consensus among many features."""
        self._rig, self._orbit, self._table = rig, orbit, table
        self._rng = np.random.default_rng(seed)
        self._arc: list[TrackFrame] = []
        self._next_try_s = -np.inf
        self._follower: FeatureFollower | None = None
        self._used_at_start: tuple[int, ...] = ()
        self._time_s: float | None = None

    @property
    def state(self) -> PrincipalState | None:
        """The filter's state; None while acquiring."""
        return self._follower.state if self._follower is not None else None

    @property
    def covariance(self) -> FloatArray | None:
        """(14 + 3N, 14 + 3N) of the state's error; None while acquiring."""
        return self._follower.covariance if self._follower is not None else None

    @property
    def features(self) -> tuple[int, ...]:
        """In the order of the state's points."""
        return self._follower.features if self._follower is not None else ()

    @property
    def triple(self) -> tuple[int, int, int] | None:
        """The features whose photogrammetric frame (6) gave the principal axes their signs."""
        return self._follower.triple if self._follower is not None else None

    def step(self, frame: TrackFrame, /) -> Estimate:
        """See `Estimator`."""
        check_frame(frame, self._time_s)
        self._time_s = frame.time_s
        seen = _well_formed(frame, self._rig)
        if self._follower is None:
            initialised = self._acquire(seen)
            if initialised is None:
                return stereo_estimate(frame, self._orbit, Status.ACQUIRING)
            return self._answer(initialised, frame, Taken(used=self._used_at_start))
        self._follower.predict(frame.time_s)
        taken = self._follower.take(seen) if len(seen.features) else Taken()
        if self._follower.is_lost:
            self._follower, self._arc = None, []
            lost = Used(rejected=taken.rejected, squared=taken.squared, gate=taken.gate)
            return stereo_estimate(frame, self._orbit, Status.LOST, of=lost)
        return self._answer(self._follower, frame, taken)

    def _acquire(self, frame: TrackFrame) -> FeatureFollower | None:
        """Gather an arc and start when it shows the principal axes, or is as long as it may be."""
        table = self._table
        if len(frame.features) >= _MIN_POINTS:
            earliest = frame.time_s - table.max_arc_s
            self._arc = [f for f in self._arc if f.time_s >= earliest] + [frame]
            length = frame.time_s - self._arc[0].time_s
            if length >= table.arc_s - 1e-9 and frame.time_s >= self._next_try_s:
                self._next_try_s = frame.time_s + _TRY_EVERY * table.arc_s
                self._start(length + 2.0 * _TRY_EVERY * table.arc_s >= table.max_arc_s)
        if self._follower is not None:
            self._follower.predict(frame.time_s)
        return self._follower

    def _start(self, at_last: bool) -> None:
        start = start_from_arc(self._arc, self._rig, self._orbit, self._table, self._rng)
        if start is None:
            return
        if at_last or start.is_ready:
            self._follower = FeatureFollower(start, self._rig, self._orbit, self._table, self._rng)
            self._arc, self._used_at_start = [], start.used

    def _answer(self, follower: FeatureFollower, frame: TrackFrame, taken: Taken) -> Estimate:
        state, covariance, result = follower.state, follower.covariance, taken.result
        certainty = follower.certainty
        status = Status.COASTING
        if taken.used:
            status = Status.LOCKED if certainty.is_determined else Status.AMBIGUOUS
        nis = float("nan") if result is None else result.joint_nis
        dof = 0 if result is None else result.joint_dof
        return stereo_estimate(
            frame,
            self._orbit,
            status,
            reported_motion(state, covariance, follower.features),
            Used(taken.used, taken.rejected, nis, dof, taken.squared, taken.gate),
            certainty.notes(),
        )


def _well_formed(frame: TrackFrame, rig: StereoRig) -> TrackFrame:
    """The frame without features that cannot be points before the rig."""
    kept = rig.disparity(frame.pixels) > 0.0
    if kept.all():
        return frame
    return replace(frame, features=frame.features[kept], pixels=frame.pixels[kept])
