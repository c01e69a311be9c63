"""Odds for the target against anything else that holds a pose."""

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.estimators.depth.target_odds import (
    CLEAR_LEAD,
    TrackOdds,
    frame_odds,
    lead,
    novelty,
    odds_over,
)
from pcnav.perception.agreement import Agreement


def turned(angle_rad: float) -> FloatArray:
    """T_cam_model of a target that turns about an oblique axis, 5 m away."""
    axis = np.array([0.6, 0.0, 0.8])
    return make_transform(exp_rotation(angle_rad * axis), np.array([0.1, 0.2, 5.0]))


def test_many_returns_explained_in_full_are_clear_at_once_and_few_are_not() -> None:
    assert frame_odds(Agreement(5000, 0)) > CLEAR_LEAD
    assert 0.0 < frame_odds(Agreement(150, 0)) < CLEAR_LEAD
    assert frame_odds(Agreement(0, 0)) == 0.0


@pytest.mark.parametrize(
    ("may_lack_a_part", "chance", "contradicted"), [(False, 0.75, 0.05), (True, 0.6, 0.12)]
)
def test_how_much_of_a_view_may_be_contradicted(
    may_lack_a_part: bool, chance: float, contradicted: float
) -> None:
    """Three quarters are explained by chance, and a twentieth of the target is not: even odds lie
    at a share of 0.872. Of a target that is alone and of several bodies one may be missing: there
    at 0.759."""
    against, favour = np.log((1 - chance) / contradicted), np.log((1 - contradicted) / chance)
    even = against / (against + favour)

    def odds(share: float, pixels: float) -> float:
        counts = round(pixels * share), round(pixels * (1.0 - share))
        return frame_odds(Agreement(*counts, may_lack_a_part=may_lack_a_part))

    assert odds(even, 1e6) == pytest.approx(0.0, abs=1e-3)
    assert odds(even + 0.03, 3000) > 0.5 and odds(even - 0.03, 3000) < -0.5


def test_conflicts_that_false_returns_explain_do_not_count() -> None:
    spoilt = Agreement(3000, 2800, hidden=1200, contradictions=40)
    assert frame_odds(spoilt) > CLEAR_LEAD
    assert frame_odds(Agreement(3000, 2800)) < -CLEAR_LEAD


def test_the_same_view_again_is_little_evidence_and_another_side_is_much() -> None:
    found = Agreement(300, 0)
    one = frame_odds(found)
    assert odds_over([(turned(0.0), found)] * 3) == pytest.approx(1.5 * one)
    turning = [(turned(0.5 * k), found) for k in range(3)]
    assert odds_over(turning) == pytest.approx(3.0 * one)
    assert novelty([], turned(0.0)) == 1.0
    assert novelty([turned(0.0)], turned(0.03)) == pytest.approx(0.25 + 0.03 / 0.15)
    back = novelty([turned(0.0), turned(1.0)], turned(0.03))
    assert back == pytest.approx(0.25 + 0.03 / 0.15), "what was seen before is nothing new"


def test_a_lead_counts_a_quarter_of_a_nat_for_each_return_explained_more() -> None:
    assert lead(Agreement(993, 7), [Agreement(945, 55), Agreement(500, 500)]) == 12.0
    assert lead(Agreement(993, 7), []) == np.inf


def verdicts(odds: TrackOdds) -> tuple[bool, bool]:
    """Whether the track is clear, and whether it is refuted."""
    return odds.is_clear, odds.is_refuted


def test_a_track_is_clear_until_frames_contradict_it_and_refuted_after_more() -> None:
    odds = TrackOdds(CLEAR_LEAD + 1.0)
    assert verdicts(odds) == (True, False)
    odds.add(turned(0.0), Agreement(3000, 0))
    assert verdicts(odds) == (True, False)
    wrong = Agreement(2100, 900)
    odds.add(turned(0.1), wrong)
    assert verdicts(odds) == (False, False)
    for k in range(4):
        odds.add(turned(0.3 + 0.3 * k), wrong)
    assert verdicts(odds) == (False, True)
    # A right view says so at once, but one does not make up for them all.
    odds.add(turned(2.0), Agreement(3000, 0))
    assert verdicts(odds) == (False, False)
