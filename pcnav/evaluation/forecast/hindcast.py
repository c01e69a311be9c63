"""How well a run's earlier estimates foretold its last ones.

A filter that follows a wrong motion, as that of a free body where a torque acts, is sure of itself
and corrected in every frame. Over a longer span it misses by more than it states.
"""

from dataclasses import dataclass, replace

import numpy as np

from pcnav.core.arrays import IntArray
from pcnav.evaluation.forecast.cloud import Cloud
from pcnav.evaluation.forecast.point import PointMotion, TargetPoint
from pcnav.evaluation.forecast.spread import Spread, spread_of_rotations, spread_of_vectors
from pcnav.evaluation.forecast.start import ForecastStart, covariance_at, state_at
from pcnav.runs.run import Run

_FORECASTS = 8
_N_DRAWN = 400
_SPAN_SHARE = 1.0 / 3.0
"""Of the frames since the motion changed for the last time."""
_MIN_FRAMES = 12
_MIN_HELD = 0.5
"""Share of the forecasts below which the run contradicts itself: of a filter that is right more
than 95 % hold, since an estimate and the one that it becomes have most of their errors in
common."""
_ORIGIN = TargetPoint("origin", np.zeros(3))


@dataclass(frozen=True)
class Hindcast:
    """Of forecasts over one span."""

    span_s: float
    forecasts: int
    held: int
    """Whose position and attitude were both within the 95 % ellipsoid."""

    @property
    def is_refuted(self) -> bool:
        """Whether the run's own estimates contradict its forecasts."""
        return self.held < _MIN_HELD * self.forecasts


def hindcast(run: Run, start: ForecastStart, rng: np.random.Generator) -> Hindcast | None:
    """Of a free body; None of any other motion, whose forecasts were made to hold, and of a run
    that is too short."""
    frames = _stretch(run)
    if not start.torque_free or len(frames) < _MIN_FRAMES:
        return None
    span = int(_SPAN_SHARE * len(frames))
    begins = np.unique(np.linspace(0, len(frames) - 1 - span, _FORECASTS).astype(np.intp))
    held = [_held(run, start, int(frames[k]), int(frames[k + span]), rng) for k in begins]
    span_s = float(np.mean(run.time_s[frames[begins + span]] - run.time_s[frames[begins]]))
    return Hindcast(span_s, len(held), sum(held))


def _stretch(run: Run) -> IntArray:
    """Frames of the last track with one motion."""
    words = run.words.get("motion", ("",) * len(run))
    known, last = run.has_estimate, len(run) - 1 - int(np.argmax(run.has_estimate[::-1]))
    first = last
    while first > 0 and known[first - 1] and words[first - 1] == words[last]:
        first -= 1
    return np.arange(first, last + 1)


def _held(run: Run, start: ForecastStart, begin: int, end: int, rng: np.random.Generator) -> bool:
    drawn = _drawn(run, start, begin, rng)
    foretold = drawn.moved(start, float(run.time_s[end]) - drawn.time_s, rng)
    places, turns = _spreads(foretold, start)
    # The later estimate is no truth. What both have in common only makes them differ less.
    place, turn = _spreads(_drawn(run, start, end, rng), start)
    near = replace(places, covariance=places.covariance + place.covariance)
    alike = replace(turns, covariance=turns.covariance + turn.covariance)
    return bool(near.holds(place.mean) and alike.holds(turn.mean))


def _drawn(run: Run, start: ForecastStart, k: int, rng: np.random.Generator) -> Cloud:
    """States about the estimate of frame k."""
    at = replace(
        start,
        time_s=float(run.time_s[k]),
        state=state_at(run.trajectory, k),
        covariance=covariance_at(run.trajectory, k),
    )
    return Cloud.drawn(at, _N_DRAWN, rng)


def _spreads(cloud: Cloud, start: ForecastStart) -> tuple[Spread, Spread]:
    """Of position and attitude."""
    motion = PointMotion.of(cloud, _ORIGIN, start)
    return spread_of_vectors(motion.position), spread_of_rotations(motion.R_hill_body)
