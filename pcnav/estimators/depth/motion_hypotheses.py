"""The first state of a track: pose hypotheses followed over frames until one motion stands out."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, log_rotation, make_transform, rotation_angle
from pcnav.estimators.depth.motion_within import motion_about
from pcnav.estimators.depth.pose_fit import SingleFramePose
from pcnav.estimators.depth.target_odds import CLEAR_LEAD, NATS_PER_CONFLICT, odds_over
from pcnav.target.row_motion import Readout
from pcnav.target.satellite import Target

_MAX_STEP_RAD = 0.5
"""Two frames are linked when the attitude is this near to what the motion so far predicts."""
_MAX_SHIFT_FRACTION = 0.3
"""... and the model origin this near, over the diameter."""
MAX_TURN_CHANGE = 0.5
"""Of the last turn, where that is larger: the rate of a tumbling body wanders within one."""
_REACH_SD = 3.0
"""Either is so many deviations of what poses err by and a motion changes by."""
MIN_FRAMES = 3
"""With the target in them, that a motion takes ..."""
_MIN_FAST_FRAMES = 4
"""... and one that turns by more than frames are linked by: two attitudes are explained by any
rate, a third by many."""
_STEADY_SHARE = 0.1
"""A rate that changes by less than this share of it may be prescribed."""
MAX_OBSERVATIONS = 10
"""A motion is followed over so many frames with hypotheses; then the best one is taken."""
_MAX_LAG = 0.1
"""An observation whose inlier ratio is so much below that of another of its motion is dropped, if
that is more than chance makes it:"""
_CHANCE_SD = 3.0
"""so many deviations of a share of so few pixels."""
_STRAY_RATIO, _STRAY_FRACTION = 6.0, 0.01
"""An observation is a stray if it lies off the way by so many times more than usual, and by more
than that share of the diameter; at most one ..."""
_STRAYS_OF = 5
"""... of so many is left out."""
_MAX_MOTIONS, _MAX_FAST_MOTIONS = 24, 96


@dataclass(frozen=True)
class PoseObservation:
    """A pose that one frame allows, and where the camera was."""

    time_s: float
    T_cam_world: FloatArray
    pose: SingleFramePose

    @property
    def T_cam_model(self) -> FloatArray:
        """(4, 4)"""
        return self.pose.T_cam_model

    @property
    def R_world_body(self) -> FloatArray:
        """(3, 3) attitude of the target."""
        return np.asarray(self.T_cam_world[:3, :3].T @ self.T_cam_model[:3, :3])

    @property
    def p_world_model(self) -> FloatArray:
        """(3,) origin of the model, m."""
        p_cam_model = self.T_cam_model[:3, 3] - self.T_cam_world[:3, 3]
        return np.asarray(self.T_cam_world[:3, :3].T @ p_cam_model)


@dataclass(frozen=True)
class MotionHypothesis:
    """PoseObservations that one tumbling body can have made, in order of time."""

    observations: tuple[PoseObservation, ...]
    """The last ones."""
    earlier_odds: float = 0.0
    """Of those before them."""

    @property
    def inlier_ratio(self) -> float:
        """Mean over the frames."""
        return float(np.mean([observation.pose.inlier_ratio for observation in self.observations]))

    @cached_property
    def odds(self) -> float:
        """Logarithm of the odds for the target against anything else that moves so."""
        return self.earlier_odds + _odds(self.observations)

    def followed_by(self, observation: PoseObservation) -> "MotionHypothesis":
        """With one more; what the oldest said stays in the odds."""
        observations = _sound((*self.observations, observation))
        kept = observations[-MAX_OBSERVATIONS:]
        earlier = self.earlier_odds
        if len(kept) < len(observations):
            earlier += _odds(observations) - _odds(kept)
        return MotionHypothesis(kept, earlier)

    @cached_property
    def turns(self) -> FloatArray:
        """(n - 1, 3) rotation vectors from one observation to the next, body axes: the smallest
        that they allow."""
        attitudes = [observation.R_world_body for observation in self.observations]
        return np.reshape([log_rotation(a.T @ b) for a, b in pairwise(attitudes)], (-1, 3))

    @property
    def is_fast(self) -> bool:
        """Whether it turns by more between frames than a hypothesis may be off."""
        return bool(np.any(np.linalg.norm(self.turns, axis=1) > _MAX_STEP_RAD))

    @property
    def is_ripe(self) -> bool:
        """Whether so many frames show it that it can be decided on."""
        return len(self.observations) >= (_MIN_FAST_FRAMES if self.is_fast else MIN_FRAMES)

    @property
    def is_steady(self) -> bool:
        """Whether the rate, seen in the body, is as good as constant."""
        times = np.diff([observation.time_s for observation in self.observations])
        rates = self.turns / times[:, None]
        spread = np.linalg.norm(rates - rates.mean(axis=0), axis=1)
        return bool(np.all(spread < _STEADY_SHARE * np.linalg.norm(rates.mean(axis=0))))

    def without_strays(self, diameter_m: float) -> "MotionHypothesis":
        """Without observations that lie off the way from the one before to the one after: a fit of
        few returns may have slid along a face that shows no edge."""
        kept = self.observations
        for _ in range(len(kept) // _STRAYS_OF):
            off = _off_the_way(kept, diameter_m)
            worst = int(np.argmax(off))
            if not off[worst] > max(_STRAY_RATIO * float(np.median(off)), _STRAY_FRACTION):
                break
            kept = (*kept[: worst + 1], *kept[worst + 2 :])
        return replace(self, observations=kept)

    def short_of(self) -> list[tuple[int, FloatArray]]:
        """Observations that explain clearly less than those before and after them, and the pose
        T_cam_model (4, 4) that lies between those: fits that rested beside the target."""
        ratios, by_chance = _shares(self.observations)
        good = np.flatnonzero(ratios >= ratios.max() - by_chance)
        found = []
        for k in np.flatnonzero(ratios < ratios.max() - by_chance).tolist():
            place = int(np.searchsorted(good, k))
            if 0 < place < len(good):
                ends = (self.observations[good[place - 1]], self.observations[good[place]])
                at = self.observations[k]
                T_world_model = make_transform(*_between(*ends, at.time_s))
                found.append((k, at.T_cam_world @ T_world_model))
        return found

    def with_pose(self, k: int, pose: SingleFramePose) -> "MotionHypothesis":
        """With another pose in observation k."""
        changed = replace(self.observations[k], pose=pose)
        observations = (*self.observations[:k], changed, *self.observations[k + 1 :])
        return replace(self, observations=observations)

    def log_weight(self, frames: int) -> float:
        """Log-likelihood of the last frames, up to a constant that depends on the frames alone."""
        support = [s.pose.agreement.support for s in self.observations[-frames:]]
        return NATS_PER_CONFLICT * float(np.sum(support))

    def predicted_attitude(self, time_s: float) -> FloatArray:
        """(3, 3) R_world_body if the last rate, seen in the body, goes on."""
        last = self.observations[-1]
        if len(self.observations) == 1:
            return last.R_world_body
        return np.asarray(
            last.R_world_body @ exp_rotation(self._last_rate() * (time_s - last.time_s))
        )

    def predicted_position(self, time_s: float) -> FloatArray:
        """(3,) p_world_model if the last velocity goes on."""
        last = self.observations[-1]
        if len(self.observations) == 1:
            return last.p_world_model
        before = self.observations[-2]
        share = (time_s - last.time_s) / (last.time_s - before.time_s)
        return np.asarray(last.p_world_model + share * (last.p_world_model - before.p_world_model))

    def motion_at(self, k: int) -> Readout | None:
        """How the target moves in the camera about observation k; of a single one as that frame
        shows it, if it does."""
        if len(self.observations) == 1:
            return self.observations[0].pose.motion
        return motion_about([(o.time_s, o.T_cam_model) for o in self.observations], k)

    def _last_rate(self) -> FloatArray:
        before, last = self.observations[-2:]
        turn = log_rotation(before.R_world_body.T @ last.R_world_body)
        return np.asarray(turn / (last.time_s - before.time_s))


@dataclass(frozen=True)
class Decision:
    """The motion accepted, and whether another one explains the frames as well."""

    motion: MotionHypothesis
    undecided: bool
    even: tuple[MotionHypothesis, ...] = ()
    """Fast motions that are as likely as it is by their frames one by one: which of them, a body
    can make, only the frames together tell."""


class MotionHypotheses:
    """Links pose hypotheses of successive frames into motions and decides between them."""

    def __init__(self, target: Target) -> None:
        self._target = target
        self._motions: tuple[MotionHypothesis, ...] = ()

    def add(
        self,
        time_s: float,
        T_cam_world: FloatArray,
        hypotheses: Sequence[SingleFramePose],
        prior_odds: float = 0.0,
    ) -> Decision | None:
        """Take in the hypotheses of a frame; a decision as soon as one can be made.

        A motion is decided on when the odds are clear that it is the target's, and no other one
        explains the frames nearly as well. After ten frames the best motion is taken even if
        another one is as good, and called undecided. A motion that the target's symmetry maps onto
        the best one is no other. ``prior_odds``: their logarithm, before any frame.
        """
        observations = [
            PoseObservation(time_s, T_cam_world, hypothesis) for hypothesis in hypotheses
        ]
        if not observations:
            return None
        linked = [self._extended(motion, observations) for motion in self._motions]
        grown = [motion for motion in linked if motion is not None]
        stuck = [motion for motion, own in zip(self._motions, linked, strict=True) if own is None]
        fast = [each for motion in stuck for each in self._fast(motion, observations)]
        # What no motion so far leads to may be the beginning of the right one.
        claimed = {id(motion.observations[-1]) for motion in grown}
        new = [
            MotionHypothesis((observation,))
            for observation in observations
            if id(observation) not in claimed
        ]
        best_first = sorted([*grown, *fast, *new], key=lambda motion: -motion.odds)
        # What is clearly something else is not worth being followed.
        alive = [motion for motion in best_first[1:] if motion.odds > -CLEAR_LEAD]
        best_first = best_first[:1] + alive
        slow = [motion for motion in best_first if not motion.is_fast][:_MAX_MOTIONS]
        fast = [motion for motion in best_first if motion.is_fast][:_MAX_FAST_MOTIONS]
        kept = {id(motion) for motion in (*slow, *fast)}
        self._motions = tuple(motion for motion in best_first if id(motion) in kept)
        return self._decide(prior_odds)

    def looked_again(
        self, prior_odds: float, looked: Callable[[MotionHypothesis], MotionHypothesis]
    ) -> Decision | None:
        """The decision once every motion was gone through again that may be the target's."""
        again = [
            looked(motion) if motion.is_ripe and motion.odds > 0.0 else motion
            for motion in self._motions
        ]
        self._motions = tuple(sorted(again, key=lambda motion: -motion.odds))
        return self._decide(prior_odds)

    def refute(self, motions: Sequence[MotionHypothesis]) -> None:
        """Leave out motions that turned out not to be possible."""
        refuted = {id(motion) for motion in motions}
        self._motions = tuple(m for m in self._motions if id(m) not in refuted)

    def predicted(self, time_s: float, T_cam_world: FloatArray) -> tuple[FloatArray, ...]:
        """Poses T_cam_model (4, 4) where the motions so far would have the target now; fast ones
        do not lead near enough."""
        return tuple(
            T_cam_world @ make_transform(m.predicted_attitude(time_s), m.predicted_position(time_s))
            for m in self._motions
            if not m.is_fast
        )

    @property
    def times_s(self) -> frozenset[float]:
        """Of the frames that any motion has an observation in."""
        return frozenset(s.time_s for motion in self._motions for s in motion.observations)

    @property
    def best(self) -> MotionHypothesis | None:
        """The motion for which most speaks so far."""
        return self._motions[0] if self._motions else None

    def _extended(
        self, motion: MotionHypothesis, observations: list[PoseObservation]
    ) -> MotionHypothesis | None:
        """The motion with the likeliest of the observations that fit it, by what explains the frame
        and by how near the motion leads; None when none do."""
        attitude = motion.predicted_attitude(observations[0].time_s)
        before = motion.observations[-1].p_world_model
        fitting = []
        for observation in observations:
            turn = float(rotation_angle(attitude.T @ observation.R_world_body)) / _MAX_STEP_RAD
            # In the world: a camera that pans moves a still target about its own frame.
            shift_m = float(np.linalg.norm(observation.p_world_model - before))
            shift = shift_m / (_MAX_SHIFT_FRACTION * self._target.diameter_m)
            if turn <= 1.0 and shift <= 1.0:
                surprise = 0.5 * _REACH_SD**2 * (turn**2 + shift**2)
                support = NATS_PER_CONFLICT * observation.pose.agreement.support
                fitting.append((support - surprise, observation))
        if not fitting:
            return None
        return motion.followed_by(max(fitting, key=lambda pair: pair[0])[1])

    def _fast(
        self, motion: MotionHypothesis, observations: list[PoseObservation]
    ) -> list[MotionHypothesis]:
        """The motion with observations that it leads to if it turns by more between frames than
        hypotheses may be off: any of a first turn, in each of the target's equivalent attitudes;
        afterwards the one that is nearest to where the last turn leads."""
        before = motion.observations[-1].p_world_model
        reach_m = _MAX_SHIFT_FRACTION * self._target.diameter_m
        attitude = motion.predicted_attitude(observations[0].time_s)
        last_turn = float(np.linalg.norm(motion.turns[-1])) if motion.is_fast else 0.0
        found: list[tuple[float, PoseObservation]] = []
        for observation in observations:
            if np.linalg.norm(observation.p_world_model - before) > reach_m:
                continue
            for equivalent in self._equivalents(observation):
                turn = float(rotation_angle(attitude.T @ equivalent.R_world_body))
                if len(motion.observations) == 1 or turn < MAX_TURN_CHANGE * last_turn:
                    found.append((turn, equivalent))
        found.sort(key=lambda pair: pair[0])
        chosen = found if len(motion.observations) == 1 else found[:1]
        return [motion.followed_by(observation) for _, observation in chosen]

    def _equivalents(self, observation: PoseObservation) -> list[PoseObservation]:
        """The same in all attitudes that the target's symmetry leaves."""
        pose, motions = observation.pose, self._target.symmetry_transforms
        return [
            replace(
                observation,
                pose=replace(pose, T_cam_model=pose.T_cam_model @ motion, comparison=None),
            )
            if k
            else observation
            for k, motion in enumerate(motions)
        ]

    def _decide(self, prior_odds: float) -> Decision | None:
        ripe = [motion for motion in self._motions if motion.is_ripe]
        clear = [motion for motion in ripe if prior_odds + motion.odds >= CLEAR_LEAD]
        if not clear:
            return None
        best = _likeliest(clear)
        rivals = [m for m in self._motions if m is not best and _rivals(best, m)]
        undecided = [m for m in rivals if not self._symmetric(best, m)]
        if undecided and len(best.observations) < MAX_OBSERVATIONS:
            return None
        even = [m for m in ripe if m.is_fast and best.odds - m.odds < CLEAR_LEAD and m is not best]
        return Decision(best, undecided=bool(undecided), even=tuple(even) if best.is_fast else ())

    def _symmetric(self, a: MotionHypothesis, b: MotionHypothesis) -> bool:
        """Whether the target's own symmetry turns one motion into the other."""
        between = np.linalg.inv(a.observations[-1].T_cam_model) @ b.observations[-1].T_cam_model
        return bool(self._target.leave_no_trace(between[None], 0.5 * _MAX_STEP_RAD, np.inf)[0])


def _sound(observations: tuple[PoseObservation, ...]) -> tuple[PoseObservation, ...]:
    """Those that do not explain their frames much worse than the others do.

    A fit that went astray may still be near enough to be linked. Shares of few pixels vary.
    """
    ratios, by_chance = _shares(observations)
    sound = ratios >= ratios.max() - np.maximum(_MAX_LAG, by_chance)
    return tuple(s for s, is_sound in zip(observations, sound, strict=True) if is_sound)


def _shares(observations: Sequence[PoseObservation]) -> tuple[FloatArray, FloatArray]:
    """(n,) inlier ratios, and by how much chance may make each less than another."""
    ratios = np.array([observation.pose.inlier_ratio for observation in observations])
    pixels = [s.pose.agreement.agree + s.pose.agreement.conflict for s in observations]
    return ratios, _CHANCE_SD * np.sqrt(ratios * (1.0 - ratios) / np.maximum(pixels, 1))


def _off_the_way(observations: Sequence[PoseObservation], diameter_m: float) -> FloatArray:
    """(n - 2,) how far the observations but the first and the last lie from between their
    neighbours, as a share of the diameter, a turn counted by what it moves the rim."""
    found = []
    for before, at, after in zip(observations, observations[1:], observations[2:], strict=False):
        R_world_between, p_world_between = _between(before, after, at.time_s)
        angle = float(rotation_angle(R_world_between.T @ at.R_world_body))
        shift = float(np.linalg.norm(at.p_world_model - p_world_between)) / diameter_m
        found.append(float(np.hypot(shift, 0.5 * angle)))
    return np.array(found)


def _between(
    before: PoseObservation, after: PoseObservation, time_s: float
) -> tuple[FloatArray, FloatArray]:
    """(3, 3) R_world_body and (3,) p_world_model on the way from one observation to another."""
    share = (time_s - before.time_s) / (after.time_s - before.time_s)
    turn = share * log_rotation(before.R_world_body.T @ after.R_world_body)
    position = (1.0 - share) * before.p_world_model + share * after.p_world_model
    return before.R_world_body @ exp_rotation(turn), position


def _odds(observations: Sequence[PoseObservation]) -> float:
    return odds_over((s.T_cam_model, s.pose.agreement) for s in observations)


def _likeliest(motions: Sequence[MotionHypothesis]) -> MotionHypothesis:
    """The one that explains most of the frames that it has in common with each other one."""
    best = motions[0]
    for other in motions[1:]:
        frames = min(len(best.observations), len(other.observations))
        if other.log_weight(frames) > best.log_weight(frames):
            best = other
    return best


def _rivals(best: MotionHypothesis, other: MotionHypothesis) -> bool:
    """Whether another motion, which may be the target's, is not much less likely, over the frames
    that both have."""
    if other.observations[-1] is best.observations[-1] or other.odds <= 0.0:
        return False
    frames = min(len(best.observations), len(other.observations))
    return best.log_weight(frames) - other.log_weight(frames) < CLEAR_LEAD
