"""Attitude of a target from its features, frame by frame: relative rotations chained (13), (18).

At the first frame the body axes are parallel to the camera's (section 2.3). Every later frame is
matched with an earlier one that has an attitude: the last such, which is the paper's chain, or a
key frame that is kept while its features stay in view. The chaser's own attitude is taken out, so
the attitudes are inertial.

A frame that is not measured has no attitude, and says why. The covariances are those of first
order and exact in it: two relative rotations that share a frame share its noise.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from pcnav.config.image_motion import ImageMotionTable, MatchSolver, Reference
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, log_rotation, rotation_angle
from pcnav.estimators.image_motion.essential import normalised
from pcnav.estimators.image_motion.relative import (
    Expected,
    Outcome,
    RelativeMotion,
    matched,
    measure,
)
from pcnav.recordings.tracks import MonocularTracks, TrackFrame

_UNEXPECTED_SD = 5.0
"""A rotation this far from the one that the rate predicts is rejected."""
_KEYS_TRIED = 2
_PATIENCE = 4
"""Frames in a row that may fail before a segment is begun with new features."""


@dataclass(frozen=True)
class ChainLink:
    """How the turn since the reference depends on the noise of both frames, to first order."""

    features: IntArray
    """(m,) that determined the turn."""
    by_reference: FloatArray
    """(m, 3, 2) rad, of theta, per standard deviation of a coordinate in the reference."""
    seen: IntArray
    """(k,) all features of the frame."""
    by_own: FloatArray
    """(k, 3, 2) as ``by_reference``, in the frame itself; 0 of those that were not used."""
    covariance: FloatArray
    """(3, 3) of the turn alone, in theta, rad^2."""
    worst_sd: float
    """About its worst axis, rad."""

    def turned(self, R_new_old: FloatArray) -> "ChainLink":
        """With errors along other body axes (3, 3)."""
        return replace(
            self,
            by_reference=R_new_old @ self.by_reference,
            by_own=R_new_old @ self.by_own,
            covariance=R_new_old @ self.covariance @ R_new_old.T,
        )

    @staticmethod
    def to_nothing(seen: IntArray) -> "ChainLink":
        """Of a frame that defines the axes."""
        return ChainLink(
            features=np.zeros(0, dtype=np.intp),
            by_reference=np.zeros((0, 3, 2)),
            seen=seen,
            by_own=np.zeros((len(seen), 3, 2)),
            covariance=np.zeros((3, 3)),
            worst_sd=0.0,
        )


@dataclass(frozen=True)
class ChainFrame:
    """One frame's attitude, or why there is none."""

    time_s: float
    outcome: Outcome
    segment: int
    """Counts the times the chain had to begin anew; each segment has body axes of its own."""
    reference: int | None
    """Number of the frame it was compared with."""
    matches: int
    agreeing: int
    R_cam_world: FloatArray
    """(3, 3) as given."""
    R_world_body: FloatArray | None = None
    """(3, 3)"""
    covariance: FloatArray | None = None
    """(3, 3) of theta in ``R_world_body = R_hat exp(theta)``, rad^2."""
    relative: RelativeMotion | None = None
    """To the reference."""
    link: ChainLink | None = None
    """To the reference, where the frame has an attitude."""
    matched: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    """(n,) features that it has in common with the reference, those of ``relative``."""

    @property
    def R_cam_body(self) -> FloatArray | None:
        """(3, 3) R_i of the paper."""
        return None if self.R_world_body is None else self.R_cam_world @ self.R_world_body


@dataclass(frozen=True)
class _Placed:
    """A frame with an attitude."""

    number: int
    time_s: float
    features: IntArray
    points: FloatArray
    """(n, 2) normalised."""
    R_cam_world: FloatArray
    R_cam_body: FloatArray
    covariance: FloatArray
    link: ChainLink

    @property
    def R_world_body(self) -> FloatArray:
        return self.R_cam_world.T @ self.R_cam_body


class ImageMotionChain:
    """Takes in monocular frames in order of time."""

    def __init__(
        self, camera: PinholeCamera, pixel_sigma_px: float, settings: ImageMotionTable
    ) -> None:
        self._camera, self._settings = camera, settings
        sigma_px = settings.pixel_sigma_px or pixel_sigma_px
        self._sigma = float(sigma_px / np.sqrt(camera.fx * camera.fy))
        self._number = -1
        self._segment = -1
        self._unmeasured = 0
        self._keys: list[_Placed] = []
        self._last: _Placed | None = None
        self._omega_body: FloatArray | None = None

    def step(self, frame: TrackFrame) -> ChainFrame:
        """Attitude at a frame. Raises `InputError` for the robust solver without its library."""
        self._number += 1
        points = normalised(self._camera, frame.pixels)
        found = [self._compared(frame, points, each) for each in self._references(frame)]
        good = [each for each in found if each[0].R_world_body is not None]
        self._unmeasured = 0 if good else self._unmeasured + 1
        if good:
            chosen, placed = min(good, key=lambda each: float(np.trace(_covariance(each[0]))))
            self._place(placed)
            return chosen
        shared = max((each[0].matches for each in found), default=0)
        enough = self._settings.min_matches
        if shared < enough <= len(frame.features) or self._seen_anew(frame, shared):
            return self._begin_segment(frame, points)
        if found:
            return max((each[0] for each in found), key=lambda each: each.matches)
        return _empty(frame, max(self._segment, 0))

    def _seen_anew(self, frame: TrackFrame, shared: int) -> bool:
        """Whether the chain waits for a side of the target that has turned away.

        The few features left of it, often of one face, are matched in vain for as long as that
        face is in view; the many new ones would tell each other's turn.
        """
        new = len(frame.features) - shared
        return self._unmeasured > _PATIENCE and new > max(shared, self._settings.min_matches)

    def _references(self, frame: TrackFrame) -> list[_Placed]:
        """What a frame is compared with, the best first."""
        if self._last is None:
            return []
        if self._settings.reference is Reference.ADJACENT:
            return [self._last]
        key = self._keys[-1]
        in_view = len(np.intersect1d(key.features, frame.features))
        enough = max(self._settings.min_matches, self._settings.key_share * len(key.features))
        if in_view < enough and self._last.number != key.number:
            self._keys = [*self._keys, self._last][-_KEYS_TRIED:]
        return self._keys[::-1]

    def _begin_segment(self, frame: TrackFrame, points: FloatArray) -> ChainFrame:
        """A new segment, whose body axes are the camera's."""
        self._segment += 1
        self._unmeasured = 0
        self._omega_body = None
        self._last = _Placed(
            *(self._number, frame.time_s, frame.features, points, frame.R_cam_world),
            *(np.eye(3), np.zeros((3, 3)), ChainLink.to_nothing(frame.features)),
        )
        self._keys = [self._last]
        return ChainFrame(
            *(frame.time_s, Outcome.FIRST, self._segment, None, 0, 0, frame.R_cam_world),
            *(frame.R_cam_world.T, np.zeros((3, 3))),
            link=self._last.link,
        )

    def _place(self, placed: _Placed) -> None:
        last = self._last
        if last is not None and placed.time_s > last.time_s:
            turn = log_rotation(last.R_world_body.T @ placed.R_world_body)
            self._omega_body = turn / (placed.time_s - last.time_s)
        self._last = placed

    def _expected(self, frame: TrackFrame, reference: _Placed) -> Expected | None:
        """What the rate up to now predicts of the rotation from the reference."""
        if self._omega_body is None or self._last is None:
            return None
        turn = self._omega_body * (frame.time_s - self._last.time_s)
        R_cam_body = frame.R_cam_world @ self._last.R_world_body @ exp_rotation(turn)
        change = self._settings.rate_change * float(np.linalg.norm(turn))
        # The last two attitudes make the rate: their errors are carried on.
        sd = float(np.hypot(change, 2.0 * self._last.link.worst_sd))
        return Expected(R_cam_body @ reference.R_cam_body.T, max(sd, self._sigma))

    def _compared(
        self, frame: TrackFrame, points: FloatArray, reference: _Placed
    ) -> tuple[ChainFrame, _Placed]:
        """A frame against a reference; the second is of use where there is an attitude."""
        features, at_first, at_second = matched(reference.features, frame.features)
        expected = self._expected(frame, reference)
        relative = measure(
            reference.points[at_first], points[at_second], self._sigma, self._settings, expected
        )
        if self._settings.solver is not MatchSolver.EIGHT_POINT:
            relative = _believed(relative, expected)
        result = ChainFrame(
            *(frame.time_s, relative.outcome, self._segment, reference.number),
            *(relative.matches, int(relative.agreeing.sum()), frame.R_cam_world),
            relative=relative,
            matched=features,
        )
        if relative.motion is None or relative.gain is None:
            return result, reference
        R_cam_body = relative.motion.R_second_first @ reference.R_cam_body
        # eps is along the axes of the reference's camera, theta along those of the body.
        A, gain = reference.R_cam_body.T, relative.gain
        used = relative.agreeing
        by_own = np.zeros((len(frame.features), 3, 2))
        by_own[at_second[used]] = self._sigma * (A @ gain.by_second)
        link = ChainLink(
            features=features[used],
            by_reference=self._sigma * (A @ gain.by_first),
            seen=frame.features,
            by_own=by_own,
            covariance=A @ gain.covariance @ A.T,
            worst_sd=float(np.sqrt(np.linalg.eigvalsh(gain.covariance)[-1])),
        )
        cross = shared_noise(link, reference.link.seen, reference.link.by_own)
        covariance = reference.covariance + link.covariance + cross + cross.T
        placed = _Placed(
            *(self._number, frame.time_s, frame.features, points, frame.R_cam_world),
            *(R_cam_body, covariance, link),
        )
        R_world_body = placed.R_world_body
        return replace(result, R_world_body=R_world_body, covariance=covariance, link=link), placed


def shared_noise(link: ChainLink, features: IntArray, gain: FloatArray) -> FloatArray:
    """(..., 3, 3) covariance of the turn of a link with errors that hold its reference's noise.

    These are ``gain`` (..., k, 3, 2) times the noise of ``features`` (k,) in the reference.
    """
    _, i, j = matched(link.features, features)
    return np.asarray(np.einsum("nik,...njk->...ij", link.by_reference[i], gain[..., j, :, :]))


def run_chain(tracks: MonocularTracks, settings: ImageMotionTable) -> tuple[ChainFrame, ...]:
    """All frames of a recording."""
    return chain_frames(tracks.camera, tracks.pixel_sigma_px, tracks.frames, settings)


def chain_frames(
    camera: PinholeCamera,
    pixel_sigma_px: float,
    frames: Iterable[TrackFrame],
    settings: ImageMotionTable,
) -> tuple[ChainFrame, ...]:
    """Attitudes of frames in order of time."""
    chain = ImageMotionChain(camera, pixel_sigma_px, settings)
    return tuple(chain.step(frame) for frame in frames)


def _believed(relative: RelativeMotion, expected: Expected | None) -> RelativeMotion:
    """A measured rotation far from what was expected is one of wrong matches."""
    if expected is None or relative.motion is None or relative.covariance is None:
        return relative
    off = float(rotation_angle(expected.R_second_first.T @ relative.motion.R_second_first))
    own = float(np.linalg.eigvalsh(relative.covariance)[-1])
    if off <= _UNEXPECTED_SD * np.sqrt(expected.sd_rad**2 + own):
        return relative
    return replace(relative, outcome=Outcome.UNEXPECTED, motion=None, gain=None)


def _empty(frame: TrackFrame, segment: int) -> ChainFrame:
    return ChainFrame(frame.time_s, Outcome.FEW_MATCHES, segment, None, 0, 0, frame.R_cam_world)


def _covariance(frame: ChainFrame) -> FloatArray:
    return np.full((3, 3), np.inf) if frame.covariance is None else frame.covariance
