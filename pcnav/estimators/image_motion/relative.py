"""The motion between two frames from their matches: measured, or the reason why it is not."""

from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from pcnav.config.image_motion import ImageMotionTable, MatchSolver
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.spatial import log_rotation, rotation_angle
from pcnav.estimators.image_motion import degeneracy
from pcnav.estimators.image_motion.essential import (
    direction_given_rotation,
    eight_point,
    essential_of,
    in_front,
    mirrored_rotation,
    out_of_plane_angle,
    pose_of,
    sampson,
)
from pcnav.estimators.image_motion.refinement import MotionGain, motion_gain, refine
from pcnav.estimators.image_motion.robust import consensus

_SAME_ROTATION_SD = 1.0
"""Two minima closer than this, in standard deviations of the better one, are one."""
_MIN_IN_FRONT = 0.75
_ROUNDS = 3


class Outcome(StrEnum):
    """What became of the match of two frames."""

    MEASURED = "measured"
    FIRST = "first"
    """The first frame of a chain has nothing to be matched with."""
    FEW_MATCHES = "few_matches"
    NO_CONSENSUS = "no_consensus"
    """Most matches agree with no one motion: wrong matches."""
    NO_MOTION = "no_motion"
    """Nothing moved in the image: a repeated frame, or a target at rest."""
    NO_PARALLAX = "no_parallax"
    """A rotation of the camera alone explains the matches as well."""
    PLANAR = "planar"
    """A homography explains the matches as well: the points lie in a plane, or seem to."""
    AMBIGUOUS = "ambiguous"
    """Two motions explain the matches alike."""
    UNEXPECTED = "unexpected"
    """The rotation is far from what the rate up to now predicts: wrong matches."""
    IMPRECISE = "imprecise"
    """The rotation is too uncertain for a first-order covariance: with so little
    perspective not even the sign of the turn out of the image plane is sure."""


@dataclass(frozen=True)
class Candidate:
    """A motion that explains the matches."""

    R_second_first: FloatArray
    """(3, 3)"""
    direction: FloatArray
    """(3,) unit t of ``p_second = R p_first + t``; nan where it is not determined."""
    squared: float
    """Chi-square of its errors."""


@dataclass(frozen=True)
class RelativeMotion:
    """Two frames compared."""

    outcome: Outcome
    matches: int
    agreeing: BoolArray
    """(n,) of the matches."""
    motion: Candidate | None = None
    """None unless measured."""
    gain: MotionGain | None = None
    """Of the matches that agree. None unless measured."""
    candidates: tuple[Candidate, ...] = field(default=())
    """What the matches allow, best first; with `AMBIGUOUS` and the degenerate outcomes these are
    all that can be said."""
    squared: FloatArray | None = None
    """(n,) distance of each match to its epipolar line, squared, over the variance of a coordinate;
    None where there was no motion to compare them with."""
    gate: float = np.nan
    """What ``squared`` of an agreeing match stays below; nan without a gate."""

    @property
    def covariance(self) -> FloatArray | None:
        """(3, 3) of eps in ``R = R_hat exp(eps)``, rad^2, axes of the first camera."""
        return None if self.gain is None else self.gain.covariance


@dataclass(frozen=True)
class Expected:
    """What is expected of a rotation before it is measured; it chooses, it is never averaged in."""

    R_second_first: FloatArray
    """(3, 3)"""
    sd_rad: float


def measure(
    first: FloatArray,
    second: FloatArray,
    sigma: float,
    settings: ImageMotionTable,
    expected: Expected | None = None,
) -> RelativeMotion:
    """Relative motion of matches (n, 2) in normalised coordinates with noise ``sigma``.

    Raises `InputError` for the robust solver without PoseLib.
    """
    count = len(first)
    none = np.zeros(count, dtype=np.bool_)
    if count < settings.min_matches:
        return RelativeMotion(Outcome.FEW_MATCHES, count, none)
    if degeneracy.at_rest(first, second, sigma).explains:
        return RelativeMotion(Outcome.NO_MOTION, count, none)
    if settings.solver is MatchSolver.EIGHT_POINT:
        return _by_eight_points(first, second, sigma)
    found = _fitted(first, second, sigma, settings, expected)
    if found is None:
        return RelativeMotion(Outcome.NO_CONSENSUS, count, none)
    candidates, agreeing, squared = found
    judged = replace(
        RelativeMotion(Outcome.NO_CONSENSUS, count, agreeing, candidates=candidates),
        squared=squared,
        gate=float(settings.inlier_gate_sigma**2),
    )
    a, b = first[agreeing], second[agreeing]
    most = np.deg2rad(settings.max_turn_deg)
    if out_of_plane_angle(candidates[0].R_second_first, a, b) > most:
        return judged
    simpler = _simpler(a, b, sigma)
    if simpler is not None:
        return replace(judged, outcome=simpler[0], candidates=simpler[1])
    gain = motion_gain(candidates[0].R_second_first, candidates[0].direction, a, b, sigma)
    candidates = _distinct(candidates, gain, settings, expected)
    judged = replace(judged, candidates=candidates)
    if len(candidates) > 1:
        return replace(judged, outcome=Outcome.AMBIGUOUS)
    best = candidates[0]
    gain = motion_gain(best.R_second_first, best.direction, a, b, sigma)
    worst = float(np.sqrt(np.linalg.eigvalsh(gain.covariance)[-1]))
    turned = out_of_plane_angle(best.R_second_first, a, b)
    if worst > np.deg2rad(settings.max_sd_deg) or turned < settings.min_significance * worst:
        return replace(judged, outcome=Outcome.IMPRECISE)
    return replace(judged, outcome=Outcome.MEASURED, motion=best, gain=gain)


def _by_eight_points(first: FloatArray, second: FloatArray, sigma: float) -> RelativeMotion:
    """The paper's: all matches, no refinement. The covariance is that of the least squares it
    stands for, so it is a lower bound."""
    R, t = pose_of(eight_point(first, second), first, second)
    errors = sampson(essential_of(R, t), first, second) / sigma
    found = Candidate(R, t, float(errors @ errors))
    gain = motion_gain(R, t, first, second, sigma)
    everything = np.ones(len(first), dtype=np.bool_)
    return RelativeMotion(
        *(Outcome.MEASURED, len(first), everything, found, gain, (found,)), squared=errors**2
    )


def _fitted(
    first: FloatArray,
    second: FloatArray,
    sigma: float,
    settings: ImageMotionTable,
    expected: Expected | None,
) -> tuple[tuple[Candidate, ...], BoolArray, FloatArray] | None:
    """Least-squares motions, best first, the matches that agree, and the squared distances, over
    their variance, that they were judged by; None without consensus."""
    gate = settings.inlier_gate_sigma
    E, agreeing = consensus(first, second, gate * sigma)
    fewest = max(settings.min_matches, int(np.ceil(settings.min_agreeing * len(first))))
    if agreeing.sum() < settings.min_matches:
        return None
    candidates: tuple[Candidate, ...] = ()
    errors = np.zeros(0)
    starts = [pose_of(E, first[agreeing], second[agreeing])[0]]
    if expected is not None:
        starts.append(expected.R_second_first)
    for _ in range(_ROUNDS):
        candidates = _minima(starts, first[agreeing], second[agreeing], sigma)
        best = candidates[0]
        errors = sampson(essential_of(best.R_second_first, best.direction), first, second)
        now: BoolArray = np.asarray(
            (np.abs(errors) < gate * sigma)
            & in_front(best.R_second_first, best.direction, first, second)
        )
        if now.sum() < fewest:
            return None
        if np.array_equal(now, agreeing):
            break
        agreeing, starts = now, [each.R_second_first for each in candidates]
    return candidates, agreeing, (errors / sigma) ** 2


def _minima(
    starts: list[FloatArray], first: FloatArray, second: FloatArray, sigma: float
) -> tuple[Candidate, ...]:
    """The least-squares motions reached from rotations and from what they are confused with."""
    R = np.stack(
        [turn for start in starts for turn in (start, mirrored_rotation(start, first, second))]
    )
    count = len(R)
    a, b = (np.broadcast_to(x, (count, *x.shape)) for x in (first, second))
    t = direction_given_rotation(R, a, b)
    refined = refine(R, t, first, second, sigma)
    before = np.mean(in_front(refined.R, refined.t, a, b), axis=-1)
    # The other sign of t puts points that were behind the camera before it.
    t = np.where((before < 0.5)[:, None], -refined.t, refined.t)
    before = np.maximum(before, 1.0 - before)
    fit = refined.settled & (before >= _MIN_IN_FRONT)
    order = np.lexsort((refined.squared, ~fit))
    return tuple(
        Candidate(refined.R[k], t[k], float(refined.squared[k]))
        for k in order
        if fit[k] or k == order[0]
    )


def _simpler(
    first: FloatArray, second: FloatArray, sigma: float
) -> tuple[Outcome, tuple[Candidate, ...]] | None:
    """The simplest motion that explains the matches as well, with the rotations it allows."""
    unknown = np.full(3, np.nan)
    if degeneracy.at_rest(first, second, sigma).explains:
        return Outcome.NO_MOTION, ()
    R, judged = degeneracy.rotation_alone(first, second, sigma)
    if judged.explains:
        return Outcome.NO_PARALLAX, (Candidate(R, unknown, np.nan),)
    H, judged = degeneracy.plane(first, second, sigma)
    if not judged.explains:
        return None
    allowed = degeneracy.rotations_of_plane(H, first, second)
    return Outcome.PLANAR, tuple(Candidate(each, unknown, np.nan) for each in allowed)


def _distinct(
    candidates: tuple[Candidate, ...],
    gain: MotionGain,
    settings: ImageMotionTable,
    expected: Expected | None,
) -> tuple[Candidate, ...]:
    """Motions that are neither the same as a better one nor clearly worse, best first.

    What is expected of the rotation weighs in here, and only here.
    """

    def cost(each: Candidate) -> float:
        if expected is None:
            return each.squared
        off = float(rotation_angle(expected.R_second_first.T @ each.R_second_first))
        return each.squared + (off / expected.sd_rad) ** 2

    information = np.linalg.inv(gain.covariance)
    ordered = sorted(candidates, key=cost)
    kept = [ordered[0]]
    for each in ordered[1:]:
        if cost(each) - cost(ordered[0]) > settings.ambiguous_chi_square:
            break
        apart = [log_rotation(other.R_second_first.T @ each.R_second_first) for other in kept]
        if all(off @ information @ off > _SAME_ROTATION_SD**2 for off in apart):
            kept.append(each)
    return tuple(kept)


def matched(
    first_features: IntArray, second_features: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Numbers of the features in both frames, and their places in each."""
    return np.intersect1d(first_features, second_features, return_indices=True)
