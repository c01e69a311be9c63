"""How far the initial arc of a track grows."""

import numpy as np
import pytest

from pcnav.dynamics.mass_prior import MassBelief
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.depth.initial_arc import InitialArc
from pcnav.estimators.depth.mass_centre import MassCentreModel
from pcnav.filtering.map_arc_fit import TimedMeasurements


def test_an_initial_arc_is_fitted_when_it_has_grown_up_to_400_frames(
    state: NavigationState, monkeypatch: pytest.MonkeyPatch
) -> None:
    belief = MassBelief(np.zeros(3), np.eye(3), state.inertia_ratios, np.eye(5))
    arc = InitialArc(MassCentreModel(0.0, 0.0, 0.0), state, belief)
    fits: list[int] = []
    monkeypatch.setattr(arc, "fit", lambda: fits.append(len(arc.frames)))
    while not arc.is_over:
        arc.extend(TimedMeasurements(0.5 * len(arc.frames), ()))
    assert len(arc.frames) == 400
    assert fits[0] == 6 and fits[-1] > 320
    growth = np.array(fits[1:]) / np.array(fits[:-1])
    assert growth[8:].min() >= 1.25 and growth[8:].max() < 1.28
