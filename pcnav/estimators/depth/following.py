"""The motion of a target as it is followed: as that of a free body, or in any way.

Both filters take in the same measurements. The one in force predicts the frames; the other goes
along beside it, and the odds between their predictions (`motion_contest`) say when to go over.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.config.depth import FilterTable, MotionChoice
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.mass_prior import MassBelief
from pcnav.dynamics.orbit import R_hill_world
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.depth.initial_arc import Fit, InitialArc, Timed, condensed, filter_from
from pcnav.estimators.depth.kinematic import (
    KinematicFilter,
    KinematicModel,
    densities_through,
    with_belief,
    with_mass,
)
from pcnav.estimators.depth.mass import learnt_belief
from pcnav.estimators.depth.mass_centre import MassCentreModel
from pcnav.estimators.depth.measuring import Kalman
from pcnav.estimators.depth.motion_contest import WINDOW_FRAMES, MotionContest
from pcnav.estimators.depth.round_axes import InChosenAxes, RoundAxes
from pcnav.filtering.error_state import Measurement, MotionModel
from pcnav.filtering.map_arc_fit import TimedMeasurements
from pcnav.filtering.predictive import predicted

_CLEAR_ODDS = 9.0
"""Logarithm of the odds against a free body at which it is given up: 8,000 to one."""
_LIKELY_ODDS = 5.0
"""... at which a free body that is on probation is believed, or dropped: 150 to one."""
_EVEN_ODDS = -1.0
"""It is watched for as many frames as it was fitted to; over a whole window it need only be as
good."""
_FIRST_WAIT, _LONGEST_WAIT = 8, 64
"""Frames after which a free motion is tried through the last frames; twice as many each time that
comes to nothing, for a slow torque shows in a long arc only."""
_GONE_THROUGH_AGAIN = (3, 4, 6)
"""Frames of the start after which it is followed anew."""
_LASTING = 4
"""A free motion that held for so many waits was one: the next wait is the first one again."""


@dataclass(frozen=True)
class MotionSetup:
    """What does not change while a target is followed."""

    model: MassCentreModel
    filtering: FilterTable
    diameter_m: float
    axes: RoundAxes | None = None
    """Of a round target."""

    @property
    def free(self) -> MotionModel[NavigationState]:
        """How a free body moves."""
        return self.model if self.axes is None else InChosenAxes(self.model, self.axes)

    @property
    def choice(self) -> MotionChoice:
        """Which motions are thought of."""
        return self.filtering.motion

    def R_hill_world(self, time_s: float) -> FloatArray:
        """(3, 3)"""
        return R_hill_world(time_s, self.model.mean_motion_rad_s)


@dataclass
class FreeBody:
    """A free body's filter, and the arc it is fitted anew with while that is short."""

    kalman: Kalman
    arc: InitialArc | None
    chi_square: float
    dof: int
    """Of the first fit."""

    @staticmethod
    def of(fit: Fit, arc: InitialArc, table: FilterTable) -> "FreeBody":
        """As fitted to an arc."""
        return FreeBody(filter_from(fit, table), arc, fit.chi_square, fit.dof)


@dataclass(frozen=True)
class _Recent:
    """A frame as it was measured, and the state after it."""

    timed: Timed
    state: NavigationState


class FollowedMotion:
    """The filters of one target, and which of them is in force."""

    def __init__(
        self,
        setup: MotionSetup,
        belief: MassBelief,
        free: FreeBody | None,
        begin: NavigationState,
        arc: Sequence[Timed],
    ) -> None:
        """Begin with the frames of a start.

        Args:
            setup: of the target.
            belief: of its mass.
            free: fitted to the frames; None where no free motion fits them.
            begin: guess of the state at the first frame.
            arc: the frames, at least one, each with measurements.
        """
        self._setup, self._prior, self._belief = setup, belief, belief
        self._free, self._free_in_force = free, free is not None
        self._contest = MotionContest()
        self.contradicted: str | None = None
        """That the frames contradict what was stated of the mass, once they do."""
        if free is not None:
            self._heed(free.arc)
            self._contest = MotionContest(free.chi_square, free.dof)
        self._confirmed: MassBelief | None = None
        self._recent: deque[_Recent] = deque(maxlen=_LONGEST_WAIT)
        self._wait, self._since_try, self._frames_free = _FIRST_WAIT, 0, len(arc)
        self._kinematic: KinematicFilter | None = None
        self._n_followed, self._n_predicted = len(arc), 0
        self.time_s = arc[0].time_s
        if setup.choice is not MotionChoice.TORQUE_FREE:
            self._begin = with_mass(begin, belief, setup.R_hill_world(self.time_s))
            self._kinematic = self._followed([condensed(timed) for timed in arc])
            self._go_through_again()
        self.time_s = arc[-1].time_s

    def _followed(
        self, arc: Sequence[Timed], densities: FloatArray | None = None
    ) -> KinematicFilter:
        setup, time_s = self._setup, arc[0].time_s
        kinematic = KinematicFilter(
            *(self._begin, setup.model.mean_motion_rad_s, setup.diameter_m, setup.filtering),
            axes=setup.axes,
        )
        if densities is not None:
            kinematic.suggest(densities, arc[1].time_s - time_s)
        self._recent.clear()
        for timed in arc:
            if timed.time_s > time_s:
                kinematic.predict(time_s, timed.time_s - time_s)
                kinematic.learn(timed.measurements)
                time_s = timed.time_s
            kinematic.take_in(timed.measurements)
            self._recent.append(_Recent(timed, kinematic.kalman.state))
        return kinematic

    def _go_through_again(self) -> None:
        """Follow the first frames anew, with accelerations as they show: a filter that begins with
        any is long in unlearning them."""
        times_s = np.array([each.timed.time_s for each in self._recent])
        densities = densities_through(times_s, [each.state for each in self._recent])
        if densities is not None:
            self._kinematic = self._followed([each.timed for each in self._recent], densities)

    # What is in force.

    @property
    def name(self) -> MotionChoice:
        """As what the target is followed now: never `MotionChoice.AUTO`."""
        return MotionChoice.TORQUE_FREE if self._free_in_force else MotionChoice.KINEMATIC

    @property
    def is_torque_free(self) -> bool:
        """Whether the target is followed as a free body now."""
        return self._free_in_force

    @property
    def model(self) -> MotionModel[NavigationState]:
        """As the filter in force has the target move, but for what it does not know."""
        model = self._setup.model
        return model if self._free_in_force else KinematicModel(model.mean_motion_rad_s)

    @property
    def kalman(self) -> Kalman:
        """The filter in force."""
        if self._free_in_force:
            assert self._free is not None, "what is in force is there"
            return self._free.kalman
        assert self._kinematic is not None, "what is in force is there"
        return self._kinematic.kalman

    @property
    def kinematic(self) -> KinematicFilter | None:
        """The filter that follows any motion; None where only a free one is thought of."""
        return self._kinematic

    @property
    def before(self) -> NavigationState:
        """After the last frame that was measured, as the kinematic filter has it.

        Raises ``IndexError`` where only a free motion is thought of.
        """
        return self._recent[-1].state

    @property
    def is_lost(self) -> bool:
        """Whether accelerations may have carried the target anywhere by now."""
        # A jolt leaves the rate wide open: the next frame still finds the target from it.
        if self._free_in_force or self._kinematic is None or self._n_predicted < 2:
            return False
        return self._kinematic.is_lost

    @property
    def reported_covariance(self) -> FloatArray:
        """(20, 20) of the state in force, with the doubt about a mass that was only told, and about
        what a round target does not show."""
        covariance, axes = self.kalman.covariance, self._setup.axes
        if not self._free_in_force:
            hill = self._setup.R_hill_world(self.time_s)
            covariance = with_belief(self.kalman.state, covariance, self._belief, hill)
        return covariance if axes is None else axes.reported(covariance)

    @property
    def learnt_mass(self) -> MassBelief | None:
        """What was learnt of the mass, when that has settled."""
        if self._free_in_force and self._free is not None and self._free.arc is None:
            return learnt_belief(self._free.kalman.state, self._free.kalman.covariance)
        return self._confirmed

    # Frame by frame.

    def predict(self, time_s: float) -> None:
        """Move both filters to the time of a frame."""
        step_s = time_s - self.time_s
        if self._free is not None:
            self._free.kalman.predict(self._setup.free, self.time_s, step_s)
            self._free_before = self._free.kalman.snapshot()
        if self._kinematic is not None:
            self._kinematic.predict(self.time_s, step_s)
        self.time_s = time_s
        self._n_predicted += 1

    def take_in(
        self, measurements: Sequence[Measurement[NavigationState]], accepted: Sequence[bool]
    ) -> str | None:
        """Take in a frame that the filter in force was updated with; why it was changed, if so.

        Args:
            measurements: of the frame.
            accepted: which of them that filter used.
        """
        self._n_predicted = 0
        used = tuple(m for m, ok in zip(measurements, accepted, strict=True) if ok)
        timed = condensed(TimedMeasurements(self.time_s, used))
        if self._free_in_force:
            self._frames_free += 1
            self._extend_arc(timed)
        if self._kinematic is None:
            return None
        # What one filter refuses may be what tells that it is wrong.
        other = self._other
        refused = [m for m, ok in zip(measurements, accepted, strict=True) if not ok]
        heard = [m for m in refused if other is not None and other.would_accept(m)]
        if heard:
            timed = condensed(TimedMeasurements(self.time_s, (*used, *heard)))
        self._along(self._kinematic, timed)
        return self._judged() if self._setup.choice is MotionChoice.AUTO else None

    def take_in_again(self, frames: Sequence[Timed]) -> None:
        """Go through the last frames once more, which were measured anew.

        ``frames`` are as `condensed` has them, the last one taken in among them.
        """
        again = {timed.time_s: timed for timed in frames if timed.measurements}
        if self._free is not None and self._free.arc is not None:
            arc = self._free.arc
            arc.frames = [again.get(timed.time_s, timed) for timed in arc.frames]
            fit = arc.fit()
            if fit is not None:
                self._free.kalman = filter_from(fit, self._setup.filtering)
        if self._kinematic is None:
            return
        first = self._recent[0]
        hill = self._setup.R_hill_world(first.timed.time_s)
        self._begin = with_mass(first.state, self._belief, hill)
        timed = [again.get(each.timed.time_s, each.timed) for each in self._recent]
        self._kinematic = self._followed(timed)
        self._go_through_again()
        # A free motion that did not fit them may do so now.
        self._wait = _FIRST_WAIT

    def _along(self, kinematic: KinematicFilter, timed: Timed) -> None:
        """The filter that is not in force takes in the same, and both are compared."""
        updated = kinematic.kalman.snapshot()
        under_any = kinematic.learn(timed.measurements)
        if self._free is not None:
            before = self._free_before
            at = predicted(before.state, timed.measurements)
            self._contest.add(at.surprise(before.covariance), under_any)
        if self._free_in_force:
            kinematic.take_in(timed.measurements)
        else:
            kinematic.kalman.restore(updated)
            self._on_probation(timed)
        self._recent.append(_Recent(timed, kinematic.kalman.state))
        self._n_followed += 1
        if self._n_followed in _GONE_THROUGH_AGAIN:
            self._go_through_again()

    def _on_probation(self, timed: Timed) -> None:
        """A free body's filter that is not in force takes in a frame, or is dropped for it."""
        if self._free is None:
            return
        if any(self._free.kalman.update(timed.measurements).accepted):
            self._extend_arc(timed)
        else:
            self._drop()

    def _extend_arc(self, timed: Timed) -> None:
        """Keep the measurements of the initial arc, and go on from each fit of them all."""
        free = self._free
        if free is None or free.arc is None:
            return
        fit = free.arc.extend(timed)
        self._heed(free.arc)
        if fit is not None:
            free.kalman = filter_from(fit, self._setup.filtering)
        if free.arc.is_over:
            free.arc = None

    def _heed(self, arc: InitialArc | None) -> None:
        """Believe as little of the mass as an arc does that contradicts it."""
        if arc is not None and arc.remark not in (None, self.contradicted):
            self._prior, self.contradicted = arc.belief, arc.remark

    @property
    def prior(self) -> MassBelief:
        """What is believed of the mass before any frame, widened where the frames contradict it."""
        return self._prior

    # Going over.

    def _judged(self) -> str | None:
        if self._free_in_force:
            odds, frames = self._contest.odds_against()
            if odds > _CLEAR_ODDS:
                self.go_over(frames)
                return f"the last {frames} frames have odds of 1e{odds / 2.303:.0f} against it"
            self._confirm(odds)
            return None
        self._since_try += 1
        if self._free is None:
            if self._since_try >= self._wait:
                self._try_free()
            return None
        frames, odds = len(self._contest), self._contest.odds_for()
        if odds < -_LIKELY_ODDS:
            self._drop()
        elif frames >= min(self._wait, WINDOW_FRAMES) and (
            odds > _LIKELY_ODDS or (frames == WINDOW_FRAMES and odds > _EVEN_ODDS)
        ):
            self._free_in_force, self._frames_free = True, frames
            return f"it predicts the last {frames} frames as well or better"
        return None

    def _confirm(self, odds_against: float) -> None:
        """Keep what is learnt of the mass while the frames speak for a free body."""
        whole = len(self._contest) == WINDOW_FRAMES
        if whole and odds_against < 0.0 and self._contest.odds_for() > _LIKELY_ODDS:
            assert self._free is not None, "it is in force"
            self._confirmed = learnt_belief(self._free.kalman.state, self._free.kalman.covariance)

    def go_over(self, frames: int = 0) -> None:
        """Follow as any motion from now on; the motion changed so many measured frames ago."""
        assert self._kinematic is not None, "any motion is thought of"
        lasted = self._frames_free > _LASTING * self._wait
        self._wait = _FIRST_WAIT if lasted else min(2 * self._wait, _LONGEST_WAIT)
        self._free_in_force = False
        self._forget_free()
        while len(self._recent) > frames:
            self._recent.popleft()
        self._belief = self._confirmed or self._prior
        self._kinematic.believe(self._belief, self._setup.R_hill_world(self.time_s))

    def _drop(self) -> None:
        self._forget_free()
        self._wait = min(2 * self._wait, _LONGEST_WAIT)

    def _forget_free(self) -> None:
        self._free, self._contest, self._since_try = None, MotionContest(), 0

    def _try_free(self) -> None:
        """Fit a free motion to the last frames: with the mass as it was learnt, or anew."""
        recent = list(self._recent)[-self._wait :]
        self._since_try = 0
        if len(recent) < min(self._wait, _FIRST_WAIT):
            return
        first = recent[0]
        hill = self._setup.R_hill_world(first.timed.time_s)
        for belief in filter(None, (self._confirmed, self._prior)):
            guess = with_mass(first.state, belief, hill)
            arc = InitialArc(self._setup.model, guess, belief, self._setup.axes)
            arc.frames = [each.timed for each in recent]
            fit = arc.fit()
            self._heed(arc)
            if fit is not None:
                self._free = FreeBody.of(fit, arc, self._setup.filtering)
                self._contest = MotionContest(fit.chi_square, fit.dof)
                return
        self._wait = min(2 * self._wait, _LONGEST_WAIT)

    @property
    def _other(self) -> Kalman | None:
        if self._free_in_force:
            return None if self._kinematic is None else self._kinematic.kalman
        return None if self._free is None else self._free.kalman
