"""What a run says of itself, from facts that are made up."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pcnav.core.camera import PinholeCamera
from pcnav.dynamics.blocks import POSE_LAYOUT
from pcnav.evaluation.diagnosis import Diagnosis, Facts, diagnosis
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.perception.view_hypotheses import RegionTried, SearchReport
from pcnav.recordings.frame_survey import FrameSurvey, FrameSurveyor
from pcnav.recordings.sequence import Frame
from pcnav.runs.collector import collected
from pcnav.runs.estimate import Estimate, Output
from pcnav.runs.run import Run

OUTPUT = Output(POSE_LAYOUT, has_nis=False, notes=("inlier_ratio",))
CAMERA = PinholeCamera(100, 80, 150.0, 150.0, 49.5, 39.5)
SURVEY = FrameSurvey(np.full(20, 5000), near_m=1.0, far_m=3.0, span_m=4.3, pixels_per_radian=600.0)
FACTS = Facts(SURVEY, diameter_m=0.15, min_frames=3)


def run_of(statuses: str, ratios: dict[str, float] | None = None) -> Run:
    """One letter a frame: acquiring, locked, coasting, lost ("x"); inlier ratios by letter."""
    names = {"a": "acquiring", "l": "locked", "c": "coasting", "x": "lost"}
    ratios = {"a": float("nan"), "l": 0.97, "c": 0.3, "x": 0.22} | (ratios or {})
    return collected(
        "depth",
        OUTPUT,
        [
            Estimate(
                float(k),
                names[letter],
                T_cam_target=None if letter == "a" else np.eye(4),
                notes={"inlier_ratio": ratios[letter]},
            )
            for k, letter in enumerate(statuses)
        ],
    )


def said(statuses: str, facts: Facts = FACTS) -> Diagnosis:
    return diagnosis(run_of(statuses), facts)


def surveyed(**changes: Any) -> Facts:
    return replace(FACTS, survey=replace(SURVEY, **changes))


def test_a_run_that_follows_to_its_end_says_nothing() -> None:
    assert said("aallllllllcllllllllc") == Diagnosis(found=True)


def test_the_sizes_tell_a_background() -> None:
    (sentence,) = said("a" * 20).warnings
    assert not said("a" * 20).found
    assert sentence.startswith("no target found in 20 frames: ")
    assert "the returns span 4.30 m, the target 0.150 m" in sentence


@pytest.mark.parametrize(
    ("diameter_m", "unit"),
    [(17e3, "millimetres"), (85.0, "centimetres or millimetres"), (14.0, "inches or c")],
)
def test_a_target_larger_than_all_that_is_seen_tells_a_unit(diameter_m: float, unit: str) -> None:
    facts = replace(surveyed(near_m=0.2, far_m=0.3, span_m=0.7), diameter_m=diameter_m)
    (sentence,) = said("a" * 20, facts).warnings
    assert "between 0.200 m and 0.300 m" in sentence
    assert f"is the mesh in {unit}" in sentence


def test_depths_in_another_unit_are_told_by_the_size_in_pixels() -> None:
    facts = surveyed(near_m=500.0, far_m=900.0, span_m=600.0)
    (sentence,) = said("a" * 20, facts).warnings
    assert "0.180 px" in sentence and "is the depth in another unit than metres?" in sentence


def test_frames_without_returns_are_counted() -> None:
    counts = np.array([0] * 8 + [5000] * 12)
    (sentence,) = said("a" * 20, surveyed(n_returns=counts)).warnings
    assert "8 frames without any return" in sentence
    nan = {"near_m": np.nan, "far_m": np.nan, "span_m": np.nan}
    (sentence,) = said("a" * 20, surveyed(n_returns=np.zeros(20, int), **nan)).warnings
    assert sentence == (
        "no target found in 20 frames: no frame has any return: is the depth 0 throughout, or "
        "taken away by a mask, a range gate or a region of interest?"
    )
    (sentence,) = said("a" * 20, surveyed(n_returns=np.full(20, 7))).warnings
    assert "at most 7 returns in a frame" in sentence


def test_too_few_frames_for_a_motion_are_told() -> None:
    facts = surveyed(n_returns=np.array([5000]), span_m=0.15)
    (sentence,) = said("a", facts).warnings
    assert sentence == "no target found in 1 frame: a motion takes 3"


def test_where_the_target_was_looked_for_is_told() -> None:
    tried = (RegionTried(0.16, 900, 0.31), RegionTried(0.12, 500, float("nan")))
    facts = replace(FACTS, search=SearchReport(0.15, 4.3, 1, tried))
    (sentence,) = said("a" * 20, facts).warnings
    assert sentence.endswith(
        "the returns span 4.30 m, the target 0.150 m; 1 larger plane taken out, "
        "2 parts of its size tried, the best place found for it explains 31% of what is seen there"
    )
    (sentence,) = said("a" * 20, replace(facts, search=SearchReport(0.15, 4.3, 0, ()))).warnings
    assert sentence.endswith("no part of a frame is of its size")
    nothing = SearchReport(0.15, 4.3, 0, tried[1:])
    (sentence,) = said("a" * 20, replace(facts, search=nothing)).warnings
    assert sentence.endswith("1 part of its size tried, none looks like it")


def test_a_track_that_ends_early_is_lost_and_says_by_how_much() -> None:
    found = said("aalllllllllxaaaaaaaa")
    assert found.found
    assert found.warnings == (
        "followed until frame 10 of 20, not found since: the share of the returns explained went "
        "from 97% to 22%",
    )
    empty = surveyed(n_returns=np.array([5000] * 11 + [0] * 9))
    (sentence,) = said("aalllllllllcccccccca", empty).warnings
    assert sentence.endswith("not found since: no frame since has any return")


def test_noise_that_is_not_as_stated_is_told() -> None:
    run = run_of("aallllllll")
    assert run.trajectory.T_cam_target is not None
    run.trajectory.T_cam_target[2:, 2, 3] = 2.0
    noise = SensorNoise(0.003, growth=2)
    facts = replace(FACTS, noise=noise, stated_sigma_m=0.004)
    found = diagnosis(run, facts)
    # The estimator warned of it when it noticed.
    assert found.warnings == ()
    (sentence,) = found.said
    assert "12.0 mm at 2.00 m, where 4.00 mm was stated" in sentence
    assert not diagnosis(run, replace(facts, stated_sigma_m=0.01)).said
    assert not diagnosis(run, replace(facts, stated_sigma_m=None)).said


def test_a_target_of_another_size_than_its_mesh_is_told() -> None:
    (sentence,) = diagnosis(run_of("allllll"), replace(FACTS, mesh_scale=0.988)).warnings
    assert "1.2 % smaller than its mesh" in sentence
    assert not diagnosis(run_of("allllll"), FACTS).warnings


def test_an_estimate_that_is_only_coasted_is_no_find() -> None:
    assert not said("cccc").found


def test_a_run_on_anything_but_depth_frames_tells_its_statuses() -> None:
    found = diagnosis(run_of("aaax"), Facts())
    assert found.warnings == ("nothing found in 4 frames: acquiring in 3, lost in 1",)


def test_frames_are_surveyed_as_they_are() -> None:
    """A wall 2 m away that fills the left half, then nothing."""
    surveyor = FrameSurveyor()
    depth = np.zeros((80, 100), np.float32)
    surveyor.add(Frame(0, 0.0, depth, CAMERA, np.eye(4)))
    wall = depth.copy()
    wall[:, :50] = 2.0
    surveyor.add(Frame(1, 1.0, wall, CAMERA, np.eye(4)))
    survey = surveyor.survey()
    assert survey.n_returns.tolist() == [0, 4000] and survey.n_empty == 1
    assert survey.near_m == survey.far_m == pytest.approx(2.0)
    # 50 x 80 pixels of 2/150 m, without 4 % of either extent.
    assert survey.span_m == pytest.approx(0.96 * np.hypot(50, 80) * 2 / 150, rel=0.02)
    assert survey.pixels_per_radian == 150.0
    with np.errstate(all="raise"):
        assert np.isnan(FrameSurveyor().survey().near_m)
