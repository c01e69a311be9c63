"""How strongly a target that moves in any way is accelerated, as the estimates of its run show it.

A filter's own level is that from one frame to the next. A forecast reaches over many frames, over
which a sway averages out and a push adds up. So the states of the run are carried forward over
spans of different lengths, as the forecast will be, and compared with the later ones.
"""

import numpy as np

from pcnav.config.depth import MotionChoice
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.spatial import exp_rotation, log_rotation
from pcnav.dynamics.blocks import ATTITUDE, POSITION, RATE, VELOCITY
from pcnav.dynamics.orbit import hill_transition
from pcnav.dynamics.trajectory import Trajectory
from pcnav.runs.run import Run

_MAX_SPAN_SHARE = 0.34
"""Of the stretch: three spans at least tell how far a forecast over one is off."""


def densities_of_run(run: Run, mean_motion_rad_s: float) -> tuple[float, float]:
    """Power spectral densities, m^2/s^3 and rad^2/s^3, of white accelerations that lead as far off
    as the last stretch of kinematic motion was found to be led.

    Those of the span over which they are largest; zero of a stretch of fewer than three frames.
    """
    frames = _stretch(run)
    if len(frames) < 3:
        return 0.0, 0.0
    known = run.trajectory.at(frames)
    spans, longest = [1], max(1, int(_MAX_SPAN_SHARE * len(frames)))
    while 2 * spans[-1] <= longest:
        spans.append(2 * spans[-1])
    each = np.array([_densities(known, span, mean_motion_rad_s) for span in spans])
    translation, rotation = each.max(axis=0)
    return float(translation), float(rotation)


def _stretch(run: Run) -> IntArray:
    """Frames with an estimate since the motion became kinematic for the last time."""
    known = np.flatnonzero(run.has_estimate)
    words = run.words["motion"]
    others = [int(k) for k in known if words[k] != MotionChoice.KINEMATIC]
    return known[known > max(others, default=-1)]


def _densities(known: Trajectory, span: int, mean_motion_rad_s: float) -> FloatArray:
    """(2,) by the mean squared misses of places and attitudes over so many frames.

    White acceleration of density q adds ``q t^3 / 3`` to the variance along each axis. What the
    deviations of both ends explain is taken off.
    """
    steps = known.time_s[span:] - known.time_s[:-span]
    by_place, by_turn = np.zeros((2, len(steps)))
    for k, step in enumerate(steps.tolist()):
        before = np.concatenate([known[POSITION][k], known[VELOCITY][k]])
        led = hill_transition(mean_motion_rad_s, step)[:3] @ before
        R = known[ATTITUDE][k] @ exp_rotation(known[RATE][k] * step)
        by_place[k] = np.sum((known[POSITION][k + span] - led) ** 2)
        by_turn[k] = np.sum(log_rotation(R.T @ known[ATTITUDE][k + span]) ** 2)
    found = []
    for missed, value, rate in (
        (by_place, POSITION, VELOCITY),
        (by_turn, ATTITUDE, RATE),
    ):
        of_value, of_rate = (np.sum(known.sd_of(block) ** 2, axis=1) for block in (value, rate))
        explained = of_value[:-span] + of_value[span:] + steps**2 * of_rate[:-span]
        # Over the three axes.
        found.append(max(missed.mean() - explained.mean(), 0.0) / np.mean(steps**3))
    return np.array(found)
