"""The chapter of the tracking study on frames as real sensors make them."""

from dataclasses import replace

import numpy as np
import pytest

from pcnav.simulation.depth import Scene
from studies.tracking import abroad
from studies.tracking.cases_abroad import CASES

from .test_tracking_parts import judged_run


def a_run(case: str, words: str, off_m: list[float], seed: int = 1) -> abroad.AbroadRun:
    """Of frames called locked (l), ambiguous (a) or coasting (c), off along x."""
    names = {"l": "locked", "a": "ambiguous", "c": "coasting"}
    status = tuple(names[letter] for letter in words)
    return abroad.AbroadRun(case, False, seed, judged_run(status, np.array(off_m)))


@pytest.mark.parametrize("name", CASES)
def test_every_case_shows_its_fault_and_beside_it_the_same_truth(name: str) -> None:
    case = CASES[name]
    pipeline, target = case.pipeline(3, 2), case.base.found.target
    scene = Scene.of(pipeline, target.mesh)
    frame = next(scene.frames())
    assert np.count_nonzero(frame.depth_m) > 100 and np.isfinite(frame.depth_m).all()
    if case.beside is None:
        return
    other = CASES[case.beside]
    assert other.base == case.base
    plain = Scene.of(other.pipeline(3, 2), target.mesh)
    assert pipeline != plain.pipeline
    if pipeline.motion == plain.pipeline.motion and pipeline.camera == plain.pipeline.camera:
        np.testing.assert_array_equal(scene.truth.poses, plain.truth.poses)


def test_a_lock_beyond_the_bound_is_wrong_and_coasting_is_none() -> None:
    # 5 % of boxsat's diameter is 0.48 m.
    run = a_run("wall", "llaclc", [0.1, 0.6, 0.6, 0.6, 0.4, 0.1])
    assert run.wrong.tolist() == [False, True, True, False, False, False]
    assert run.right.tolist() == [True, False, False, False, True, False]
    assert run.beside == "clean" and a_run("clean", "l", [0.0]).beside is None


def test_claims_judge_poses_wrong_locks_honesty_and_the_error_ratio() -> None:
    # A deviation of 0.1 m is stated along each axis: 0.245 m is a NEES of 1 a degree of freedom.
    sd = np.full(40, 0.1)

    def made(case: str, words: str, off_m: float) -> abroad.AbroadRun:
        run = a_run(case, words, [off_m] * 40)
        return replace(run, run=judged_run(run.run.said.status, np.full(40, off_m), sd))

    clean = made("clean", "l" * 40, 0.245)

    def met(case: str, words: str, off_m: float) -> tuple[object, bool]:
        _, claim = abroad.claims({"clean": [clean], case: [made(case, words, off_m)]})
        return claim.ours, claim.met

    ours, _ = met("replaced_50", "l" * 39 + "c", 0.26)
    assert ours == [pytest.approx(0.975), 0, pytest.approx(0.26**2 / 0.06)]
    assert met("replaced_50", "l" * 39 + "c", 0.26)[1]
    assert not met("replaced_50", "l" * 37 + "ccc", 0.26)[1]  # too few
    assert not met("replaced_50", "l" * 40, 0.7)[1]  # wrong
    assert not met("replaced_50", "l" * 40, 0.1)[1]  # less error than stated is not honest either
    assert not met("replaced_50", "l" * 40, 0.3)[1]
    # Where no information is lost the errors are compared, too.
    assert len(met("wall", "l" * 40, 0.26)[0]) == 4  # type: ignore[arg-type]


def test_the_ratio_is_over_frames_that_are_right_in_both_runs_of_a_seed() -> None:
    clean = a_run("clean", "lllc", [0.1, 0.1, 0.1, 0.1])
    fault = a_run("false_5", "clll", [0.4, 0.2, 0.2, 0.4])
    other = a_run("false_5", "llll", [0.4, 0.4, 0.4, 0.4], seed=2)
    ratios = abroad._ratios({"clean": [clean], "false_5": [fault, other]}, [fault, other])
    assert ratios is not None and ratios[0] == pytest.approx(2.0)
    assert abroad._ratios({}, [fault]) is None
    table = abroad.tables({"clean": [clean], "false_5": [fault, other]})[0]
    assert [row[0] for row in table.rows] == ["clean", "false_5"]


def test_cases_come_with_and_without_a_first_pose() -> None:
    assert len(abroad.CASES) == 2 * len(CASES)
    assert set(abroad.QUICK_CASES) <= set(abroad.CASES)
    run = abroad.run_abroad("wall", True, 1, frames=2)
    assert run.name == "wall, first pose" and run.beside == "clean, first pose"
    assert len(run.run) == 2


@pytest.mark.study
def test_a_jolt_that_leaves_a_direction_open_does_not_stop_the_claims() -> None:
    """Edges that tell of the direction are too short for the coarse grid on which the target is
    found again."""
    run = abroad.run_abroad("impulse", False, 405, frames=40)
    assert run.run.claims[2:].all() and not run.wrong.any()


def test_the_frame_after_a_first_pose_is_not_claimed_beside_the_target() -> None:
    """Its prediction knows no rate: this target turns by 7 deg in between."""
    run = abroad.run_abroad("fast", True, 403, frames=2)
    assert run.run.claims.all() and not run.wrong.any()
