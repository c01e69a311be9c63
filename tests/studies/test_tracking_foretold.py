"""The chapter on forecasts: where a point is, seen independently, and how its shares read."""

import numpy as np
import pytest

from pcnav.core.arrays import BoolArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.orbit import R_hill_world
from pcnav.dynamics.state import NavigationState
from pcnav.evaluation.forecast.point import TargetPoint
from studies.tracking import foretold
from studies.tracking.foretold import AHEAD_S, QUANTITIES, Foretold, claims, tables


def test_a_point_moves_as_its_places_say() -> None:
    """Its velocity is the difference of where it is a moment later and earlier."""
    state = NavigationState(
        r_hill=np.array([18.0, -3.0, 2.0]),
        v_hill=np.array([0.01, -0.02, 0.005]),
        com_model=np.array([0.3, -0.2, 0.5]),
        R_world_body=exp_rotation(np.array([0.4, -1.1, 0.7])),
        omega_body=np.array([0.05, -0.12, 0.08]),
        inertia_ratios=np.array([0.8, 1.3, 0.05, -0.04, 0.02]),
    )
    n, at_s, step_s = 1.1e-3, 40.0, 1e-4
    point = TargetPoint("tip", np.array([1.5, 4.0, -0.7]))
    turned = make_transform(exp_rotation(np.array([0.0, 0.0, np.pi])), np.array([0.1, 0.0, 0.0]))

    def place(later_s: float) -> np.ndarray:
        R = R_hill_world(at_s + later_s, n) @ state.R_world_body
        R = R @ exp_rotation(state.omega_body * later_s)
        p_model = turned[:3, :3] @ np.array([1.5, 4.0, -0.7]) + turned[:3, 3]
        arm = p_model - state.com_model
        return np.asarray(state.r_hill + state.v_hill * later_s + R @ arm)

    p, v, R = foretold._seen(state, at_s, n, point, turned)
    np.testing.assert_allclose(p, place(0.0), atol=1e-12)
    np.testing.assert_allclose(v, (place(step_s) - place(-step_s)) / (2.0 * step_s), atol=1e-7)
    np.testing.assert_allclose(R, R_hill_world(at_s, n) @ state.R_world_body @ turned[:3, :3])


def test_shares_are_of_all_runs_that_end_with_a_claim() -> None:
    def held(wrong: tuple[int, int, int]) -> BoolArray:
        found = np.ones((len(AHEAD_S), 2, len(QUANTITIES)), np.bool_)
        found[wrong] = False
        return found

    runs = [
        Foretold("boxsat", 1, held((0, 1, 0))),
        Foretold("boxsat", 2, held((3, 0, 2))),
        Foretold("boxsat", 3, None),
    ]
    shares = {each.quantity: each.ours for each in claims({"boxsat": runs})}
    # One of two points of two runs; the attitude is the same of both points.
    assert shares["position 10 s ahead inside 95 %"] == pytest.approx(0.75)
    assert shares["attitude 120 s ahead inside 95 %"] == pytest.approx(0.5)
    assert shares["velocity 30 s ahead inside 95 %"] == 1.0
    (table,) = tables({"boxsat": runs})
    assert table.rows[0][:3] == ("boxsat", "position", "2")


def test_a_short_track_tells_little_and_holds() -> None:
    run = foretold.run_foretold("boxsat", 3, 14)
    assert run.held is not None and run.held.shape == (4, 2, 3)
    assert run.held[:2].mean() > 0.8
