"""How strongly a target that moves in any way is accelerated, as the estimates of its run show it.

A filter's own level is that from one frame to the next. A forecast reaches over many frames, over
which a sway averages out and a push adds up. So the states of the run are carried forward over
spans of different lengths, as the forecast will be, and compared with the later ones: each span has
a density of its own. It rests on the few spans that a run has room for, which its draws show.
"""

from dataclasses import dataclass

import numpy as np

from pcnav.config.depth import MotionChoice
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.spatial import exp_rotation, log_rotation, skew
from pcnav.dynamics.blocks import ATTITUDE, CENTRE, POSITION, RATE, VELOCITY
from pcnav.dynamics.orbit import R_hill_world, hill_transition
from pcnav.dynamics.trajectory import Trajectory
from pcnav.runs.run import Run

_MAX_SPAN_SHARE = 0.34
"""Of the stretch: three spans at least tell how far a forecast over one is off."""
_MIN_FRAMES = 4
_MAX_GROWTH = 1.0
"""Power of the span by which a density grows at most beyond the longest one: that of a push."""


@dataclass(frozen=True)
class Accelerations:
    """Densities of white accelerations that lead as far off as a run was found to be led."""

    span_s: FloatArray
    """(k,) increasing."""
    density: FloatArray
    """(k, 2) power spectral densities over spans: m^2/s^3 of a translation, rad^2/s^3 of a
    rotation."""
    degrees: FloatArray
    """(k,) independent numbers that each rests on; infinite of what is known."""

    @staticmethod
    def known(translation: float, rotation: float) -> "Accelerations":
        """The same over all spans."""
        return Accelerations(np.ones(1), np.array([[translation, rotation]]), np.full(1, np.inf))

    def drawn(self, ahead_s: float, n: int, rng: np.random.Generator) -> FloatArray:
        """(n, 2) densities over a span, as uncertain as they are."""
        k = np.interp(np.log(ahead_s), np.log(self.span_s), np.arange(len(self.span_s)))
        below, above = int(np.floor(k)), int(np.ceil(k))
        part = k - below
        density = (1.0 - part) * self.density[below] + part * self.density[above]
        if ahead_s > self.span_s[-1]:
            density = density * (ahead_s / self.span_s[-1]) ** self._growth()
        degrees = self.degrees[above]
        if np.isinf(degrees):
            return np.broadcast_to(density, (n, 2))
        # A variance that was measured by few numbers: the scaled inverse chi-square distribution.
        return np.asarray(density * degrees / rng.chisquare(degrees, (n, 2)))

    def _growth(self) -> FloatArray:
        """(2,) power of the span by which the densities grow."""
        if len(self.span_s) < 2:
            return np.zeros(2)
        before, last = np.maximum(self.density[-2:], np.finfo(np.float64).tiny)
        power = np.log(last / before) / np.log(self.span_s[-1] / self.span_s[-2])
        return np.asarray(np.clip(power, 0.0, _MAX_GROWTH))


def accelerations_of_run(run: Run, mean_motion_rad_s: float) -> Accelerations:
    """Of the last stretch of kinematic motion of a run that was read with its covariances.

    None are known of a stretch of fewer than four frames.
    """
    frames = _stretch(run)
    if len(frames) < _MIN_FRAMES:
        return Accelerations.known(0.0, 0.0)
    known = run.trajectory.at(frames)
    own = _own_variances(known, mean_motion_rad_s)
    spans, longest = [1], max(1, int(_MAX_SPAN_SHARE * len(frames)))
    while 2 * spans[-1] <= longest:
        spans.append(2 * spans[-1])
    return Accelerations(
        np.array([np.mean(known.time_s[span:] - known.time_s[:-span]) for span in spans]),
        np.array([_densities(known, own, span, mean_motion_rad_s) for span in spans]),
        np.array([3.0 * (len(frames) - span) / span for span in spans]),
    )


def _stretch(run: Run) -> IntArray:
    """Frames with an estimate since the motion became kinematic for the last time."""
    known = np.flatnonzero(run.has_estimate)
    words = run.words["motion"]
    others = [int(k) for k in known if words[k] != MotionChoice.KINEMATIC]
    return known[known > max(others, default=-1)]


def _own_variances(known: Trajectory, mean_motion_rad_s: float) -> FloatArray:
    """(n, 4) of place, velocity, attitude and rate, summed over the axes.

    A mass centre that is only believed is a label on the body: its doubt is no doubt of the motion.
    """
    P, layout = known.covariance, known.layout
    assert P is not None, "the run was read with its covariances"
    found = np.empty((len(known), 4))
    for k, time_s in enumerate(known.time_s.tolist()):
        R = R_hill_world(time_s, mean_motion_rad_s) @ known[ATTITUDE][k]
        by_centre = (R, R @ skew(known[RATE][k]))
        for j, block in enumerate((POSITION, VELOCITY, ATTITUDE, RATE)):
            rows = np.eye(layout.size)[layout.slice_of(block)]
            if j < len(by_centre):
                rows[:, layout.slice_of(CENTRE)] -= by_centre[j]
            found[k, j] = np.trace(rows @ P[k] @ rows.T)
    return found


def _densities(
    known: Trajectory, own: FloatArray, span: int, mean_motion_rad_s: float
) -> FloatArray:
    """(2,) by the mean squared misses of places and attitudes over so many frames.

    White acceleration of density q adds ``q t^3 / 3`` to the variance along each axis. What the
    deviations of both ends explain is taken off.
    """
    steps = known.time_s[span:] - known.time_s[:-span]
    missed = np.zeros((2, len(steps)))
    for k, step in enumerate(steps.tolist()):
        before = np.concatenate([known[POSITION][k], known[VELOCITY][k]])
        led = hill_transition(mean_motion_rad_s, step)[:3] @ before
        R = known[ATTITUDE][k] @ exp_rotation(known[RATE][k] * step)
        missed[0, k] = np.sum((known[POSITION][k + span] - led) ** 2)
        missed[1, k] = np.sum(log_rotation(R.T @ known[ATTITUDE][k + span]) ** 2)
    value, rate = own.T[0::2], own.T[1::2]
    excess = missed - (value[:, :-span] + value[:, span:] + steps**2 * rate[:, :-span])
    return np.asarray(np.maximum(excess.mean(axis=1), 0.0) / np.mean(steps**3))
