"""Relative state of a target of unknown inertia and shape from feature tracks (Segal 2011).

A bank of iterated filters, one per hypothesis of the target's inertia, sees the same frames. The
innovations weigh the hypotheses; the most probable filter, or the mean of all, is the estimate.
"""

from dataclasses import replace

import numpy as np

from pcnav.config.inertia_bank import BankEstimate, InertiaBankTable, inertia_matrix
from pcnav.core.arrays import BoolArray, FloatArray, IntArray, picked
from pcnav.core.errors import InputError
from pcnav.core.spatial import rotation_from_xyzw
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.rigid_body import ratios_from_inertia
from pcnav.estimators.features.answer import Motion, Used, stereo_estimate, stereo_output
from pcnav.estimators.features.bookkeeping import FeatureBook, check_frame
from pcnav.estimators.inertia_bank.bank import InertiaBank, start_motion, triangulated
from pcnav.estimators.inertia_bank.hypotheses import Mixture, moment_matched
from pcnav.estimators.inertia_bank.relative_state import (
    IB_MOTION_SIZE,
    PixelMeasurements,
    RelativeStates,
    point_slice,
    reduced_pixels,
)
from pcnav.estimators.interface import Estimator
from pcnav.filtering.batched_filter import BatchedUpdate
from pcnav.recordings.tracks import TrackFrame
from pcnav.runs.estimate import Estimate, FeaturePoint
from pcnav.runs.status import Status

_MIN_POINTS = 3
_DECIDED = 0.9
"""A hypothesis of less weight leaves the estimate ambiguous."""


class InertiaBankEstimator(Estimator):
    """Consumes frames of stereo tracks; nothing of the target is known before."""

    def __init__(
        self, rig: StereoRig, orbit: KeplerOrbit, table: InertiaBankTable, seed: int = 0
    ) -> None:
        """``seed`` is unused: nothing here is drawn at random."""
        self._rig, self._orbit, self._table = rig, orbit, table
        self._inertia = np.stack([inertia_matrix(values) for values in table.hypotheses])
        self._ratios = np.stack([ratios_from_inertia(inertia) for inertia in self._inertia])
        weights = (f"weight_{k + 1}" for k in range(len(self._ratios)))
        self.output = stereo_output(("hypothesis", *weights))
        self._bank: InertiaBank | None = None
        self._book = FeatureBook()
        self._time_s: float | None = None

    def step(self, frame: TrackFrame, /) -> Estimate:
        """See `Estimator`."""
        self._check(frame)
        self._time_s = frame.time_s
        R_rig_hill = frame.R_cam_world @ self._orbit.R_hill_world(frame.time_s).T
        if self._bank is None:
            return self._acquire(frame, R_rig_hill)
        plausible = self._bank.plausible()[0]
        result, seen = self._update(self._bank, frame, R_rig_hill)
        accepted = result.accepted[0] if result is not None else np.zeros(0, dtype=np.bool_)
        used = tuple(f for f, ok in zip(seen, accepted, strict=True) if ok)
        rejected = tuple(f for f, ok in zip(seen, accepted, strict=True) if not ok)
        self._book = self._book.noted(frame.time_s, used, rejected)
        if self._book.frames_refused >= self._table.max_rejections:
            self._bank, self._book = None, FeatureBook()
            lost = replace(_judged(result, seen, plausible), rejected=rejected)
            return stereo_estimate(frame, self._orbit, Status.LOST, of=lost)
        self._forget_and_add(self._bank, frame, R_rig_hill)
        taken = replace(_judged(result, seen, plausible), used=used, rejected=rejected)
        return self._answer(self._bank, frame, result, taken)

    def _check(self, frame: TrackFrame) -> None:
        check_frame(frame, self._time_s)
        disparity = StereoRig.disparity(frame.pixels)
        if not (np.all(np.isfinite(frame.pixels)) and np.all(disparity > 0.0)):
            where = f"frame at {frame.time_s:g} s"
            raise InputError(where, "pixels", "expected finite pixels of positive disparity")

    def _acquire(self, frame: TrackFrame, R_rig_hill: FloatArray) -> Estimate:
        """Begin with the first frame of enough points, which are triangulated."""
        if len(frame.features) < _MIN_POINTS:
            return stereo_estimate(frame, self._orbit, Status.ACQUIRING)
        positions, noise = triangulated(self._rig, R_rig_hill, frame.pixels[None])
        attitude = rotation_from_xyzw(np.array(self._table.attitude_xyzw))
        start = start_motion(self._table, positions, attitude[None])
        self._bank = InertiaBank(self._table, self._orbit, self._inertia[None], start, frame.time_s)
        count = min(len(frame.features), self._table.max_features)
        self._bank.add(positions[:, :count], noise[:, :count])
        features = tuple(int(f) for f in frame.features[:count])
        self._book = FeatureBook().added(frame.time_s, features)
        return self._answer(self._bank, frame, None, Used(features))

    def _update(
        self, bank: InertiaBank, frame: TrackFrame, R_rig_hill: FloatArray
    ) -> tuple[BatchedUpdate | None, tuple[int, ...]]:
        """Move to the frame and update with the points that are in the state; their numbers."""
        slots = self._book.slots(frame.features)
        known = slots >= 0
        if not known.any():
            return bank.step(frame.time_s, None), ()
        pixels = reduced_pixels(frame.pixels[known])[None]
        measured = PixelMeasurements(self._rig, R_rig_hill, slots[known], pixels)
        return bank.step(frame.time_s, measured), tuple(frame.features[known].tolist())

    def _forget_and_add(self, bank: InertiaBank, frame: TrackFrame, R_rig_hill: FloatArray) -> None:
        """Drop points that are always rejected or make room for new ones; add the new ones."""
        book, most = self._book, self._table.max_features
        unknown = [k for k, slot in enumerate(book.slots(frame.features)) if slot < 0]
        new = unknown[:most]
        dropped = set(book.rejected(self._table.max_rejections))
        stay = [name for name in book.features if name not in dropped]
        # Those in view are not dropped for others in view.
        out_of_view = [name for name in stay if book.last_seen_s[name] < frame.time_s]
        out_of_view.sort(key=lambda name: book.last_seen_s[name])
        dropped |= set(out_of_view[: max(0, len(stay) + len(new) - most)])
        if dropped:
            stay = [name for name in stay if name not in dropped]
            bank.keep(np.array([book.features.index(name) for name in stay], dtype=np.intp))
        new = new[: most - len(stay)]
        if new:
            bank.add(*triangulated(self._rig, R_rig_hill, frame.pixels[new][None]))
        added = frame.features[new].tolist()
        self._book = book.without(dropped).added(frame.time_s, added)

    def _answer(
        self,
        bank: InertiaBank,
        frame: TrackFrame,
        result: BatchedUpdate | None,
        taken: Used,
    ) -> Estimate:
        weights = bank.weights()[0]
        best = int(np.argmax(weights))
        blend = weights
        if self._table.estimate is BankEstimate.MAP:
            blend = np.eye(len(weights))[best]
        chosen: IntArray = np.flatnonzero(blend > 0.0)
        mixture = moment_matched(
            picked(bank.states, chosen),
            bank.covariance[chosen],
            blend[chosen][None] / blend[chosen].sum(),
            self._ratios[chosen][None],
        )
        is_decided = bool(weights[best] >= _DECIDED)
        status = Status.LOCKED if is_decided else Status.AMBIGUOUS
        motion = self._motion(mixture, frame.time_s)
        if self._table.estimate is BankEstimate.MAP and not is_decided:
            motion = _with_doubt(motion, weights, self._ratios)
        notes = {f"weight_{k + 1}": float(weight) for k, weight in enumerate(weights)}
        nis = float("nan") if result is None or not taken.used else float(result.joint_nis[best])
        dof = 0 if result is None else int(result.joint_dof[best])
        return stereo_estimate(
            frame,
            self._orbit,
            status if taken.used else Status.COASTING,
            motion,
            replace(taken, nis=nis, nis_dof=dof),
            {"hypothesis": float(best + 1), **notes},
        )

    def _motion(self, mixture: Mixture, time_s: float) -> Motion:
        """In the terms that all feature estimators report: world attitude, body errors."""
        states: RelativeStates = mixture.states
        n = states.size
        to_body = np.eye(n + mixture.parameters.shape[1])
        to_body[:n, :n] = states.to_body_errors()[0]
        covariance = to_body @ mixture.covariance[0] @ to_body.T
        rows = np.r_[:IB_MOTION_SIZE, n : len(covariance)]
        points = {
            feature: FeaturePoint(
                states.points_body[0, k], covariance[point_slice(k), point_slice(k)]
            )
            for k, feature in enumerate(self._book.features)
        }
        return Motion(
            r_hill=states.r_hill[0],
            v_hill=states.v_hill[0],
            R_world_body=self._orbit.R_hill_world(time_s).T @ states.R_hill_body[0],
            omega_body=states.omega_body[0],
            inertia_ratios=mixture.parameters[0],
            covariance=covariance[np.ix_(rows, rows)],
            points=points,
        )


def _judged(result: BatchedUpdate | None, seen: tuple[int, ...], plausible: BoolArray) -> Used:
    """Distances and gate of the points seen: of the plausible hypothesis (h,) that is nearest."""
    if result is None or not plausible.any():
        return Used()
    nearest = np.fmin.reduce(result.nis[plausible], axis=0)
    return Used(squared=dict(zip(seen, nearest.tolist(), strict=True)), gate=result.gate)


def _with_doubt(motion: Motion, weights: FloatArray, ratios: FloatArray) -> Motion:
    """One hypothesis followed while others may be right: how far its inertia is from theirs.

    ``weights`` (H,) and ``ratios`` (H, 5) of all hypotheses. The second moment about the one
    followed is that of its error as the bank knows it. Once decided, the inertia is held fixed.
    """
    away = ratios - motion.inertia_ratios
    covariance = motion.covariance.copy()
    covariance[IB_MOTION_SIZE:, IB_MOTION_SIZE:] += away.T @ (weights[:, None] * away)
    return replace(motion, covariance=covariance)
