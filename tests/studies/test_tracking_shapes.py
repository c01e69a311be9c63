"""The chapter of the tracking study on targets of any shape."""

from dataclasses import replace

import numpy as np
import pytest

from studies.tracking import any_shape
from studies.tracking.shapes import SHAPES
from studies.tracking.starts import Outcome, Start


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_is_of_one_size_and_has_hardly_a_rectangle(name: str) -> None:
    mesh = SHAPES[name]()
    assert np.isfinite(mesh.vertices).all() and len(mesh.faces) > 30
    assert 1.0 < float(np.linalg.norm(mesh.extents)) < 8.0


def test_a_start_of_a_shape_is_judged_by_the_truth() -> None:
    start = any_shape.run_shape("hexagonal bus", 3)
    assert start.outcome is Outcome.RIGHT and start.rate_deg_s == pytest.approx(12.0)
    assert np.rad2deg(start.attitude_rad) < 0.5


def test_bars_are_those_of_all_starts() -> None:
    right = Start("stage", 1, Outcome.RIGHT, "locked", 3, 0.4, 0.01, 0.001, 12.0, 12.0)
    wrong = replace(right, outcome=Outcome.WRONG, seconds=3.0)
    assert [claim.met for claim in any_shape.claims([right] * 50)] == [True] * 4
    met = [claim.met for claim in any_shape.claims([*[right] * 20, wrong])]
    assert met == [False, False, True, False]
