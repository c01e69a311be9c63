"""The chapter of the tracking study on starts from few returns."""

from dataclasses import replace

import numpy as np
import pytest

from pcnav.simulation.depth import Scene
from pcnav.simulation.random_truth import Satellite, satellite
from studies.tracking import few_returns
from studies.tracking.few_returns import FewStart
from studies.tracking.knowable import Knowledge, knowledge

KNOWN = Knowledge(attitude_sd_rad=0.002, position_sd_fraction=0.001, lead=50.0)
RIGHT = FewStart("boxsat", "far", 1, 80, 9, 0, 0.01, 0.01, "", KNOWN, 2.0)


@pytest.fixture(scope="module")
def boxsat() -> Satellite:
    return satellite("boxsat")


@pytest.mark.parametrize("seed", [3, 4])
def test_frames_are_of_their_kind(boxsat: Satellite, seed: int) -> None:
    def first(kind: str) -> np.ndarray:
        truth = few_returns.few_truth(boxsat, kind, seed)
        return next(iter(Scene.of(truth, boxsat.target.mesh).frames())).depth_m

    small, cut, far = (first(kind) > 0.0 for kind in few_returns.KINDS)
    assert small.shape == (64, 64) and not (small[[0, -1]].any() or small[:, [0, -1]].any())
    assert cut[[0, -1]].any() or cut[:, [0, -1]].any()
    assert 30 < np.count_nonzero(far) < 700


def test_a_start_is_judged_by_the_truth() -> None:
    start = few_returns.run_few("cubesat6u", "far", 20)
    assert start.started is not None and start.wrong == 0 and start.known.decides
    assert 0.0 < start.attitude_rad < np.deg2rad(2.0)


def test_what_too_few_returns_show_could_not_be_known(boxsat: Satellite) -> None:
    truth = few_returns.few_truth(boxsat, "far", 3)
    near = knowledge(Scene.of(truth, boxsat.target.mesh), boxsat)
    orbit = truth.orbit.model_copy(
        update={"r_hill_m": tuple(4.0 * x for x in truth.orbit.r_hill_m)}
    )
    away = Scene.of(truth.model_copy(update={"orbit": orbit}), boxsat.target.mesh)
    far = knowledge(away, boxsat)
    assert near.decides and not far.decides
    assert far.attitude_sd_rad > 3.0 * near.attitude_sd_rad


def test_bars_are_wrong_claims_and_starts_that_could_be_known() -> None:
    silent, wrong = replace(RIGHT, started=None), replace(RIGHT, wrong=2)
    unknowable = replace(silent, known=replace(KNOWN, lead=3.0))
    assert [claim.met for claim in few_returns.claims([RIGHT, *[unknowable] * 9])] == [True] * 2
    assert [claim.met for claim in few_returns.claims([*[RIGHT] * 3, silent])] == [True, False]
    assert [claim.met for claim in few_returns.claims([RIGHT, wrong])] == [False, True]
    names = [table.key for table in few_returns.tables({"boxsat, far": [RIGHT, silent, wrong]})]
    assert names == ["few_returns", "few_returns_cases", "few_returns_wrong"]
