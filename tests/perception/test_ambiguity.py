"""The ambiguity group and its solution by prediction."""

import numpy as np
import pytest

from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.perception.recognition import AxesCase, apply_case, possible_cases, resolve_case
from pcnav.target.catalogue import Rectangle

SHEET = Rectangle("sheet", np.eye(4), 4.0, 1.5, two_sided=True)
FACE = Rectangle("face", np.eye(4), 4.0, 1.5, two_sided=False)


def test_cases_form_a_group_of_half_turns_that_map_a_rectangle_onto_itself() -> None:
    corners = np.array([[x, y, 0.0] for x in (-0.75, 0.75) for y in (-2.0, 2.0)])
    motions = {case: apply_case(np.eye(4), case) for case in AxesCase}
    for a, T in motions.items():
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
        np.testing.assert_array_equal(T @ T, np.eye(4))
        moved = corners @ T[:3, :3].T
        assert {tuple(p) for p in moved.tolist()} == {tuple(p) for p in corners.tolist()}
        for other in motions.values():
            assert sum(np.array_equal(T @ other, member) for member in motions.values()) == 1
        axis = "IXYZ".index(a)
        if axis:
            np.testing.assert_array_equal(T[:3, axis - 1], np.eye(3)[axis - 1])
    assert len({T.tobytes() for T in motions.values()}) == 4


def test_a_case_turns_the_frame_in_place() -> None:
    T = make_transform(exp_rotation(np.array([0.3, 1.0, -2.0])), np.array([1.0, 2.0, 20.0]))
    before = T.copy()
    for case in AxesCase:
        np.testing.assert_allclose(apply_case(T, case), T @ apply_case(np.eye(4), case), atol=1e-15)
        np.testing.assert_array_equal(apply_case(apply_case(T, case), case), before)
    np.testing.assert_array_equal(T, before)


def test_which_cases_can_be_seen() -> None:
    assert set(possible_cases(SHEET)) == set(AxesCase)
    # The normal that perception gives always faces the sensor, and so does a solid's.
    assert set(possible_cases(FACE)) == {AxesCase.I, AxesCase.Z}
    for case in possible_cases(FACE):
        np.testing.assert_array_equal(apply_case(np.eye(4), case)[:3, 2], [0.0, 0.0, 1.0])


@pytest.mark.parametrize("rectangle", [SHEET, FACE], ids=["sheet", "face"])
def test_every_case_is_resolved_whatever_the_attitude(rectangle: Rectangle) -> None:
    rng = np.random.default_rng(0)
    for _ in range(100):
        truth = exp_rotation(rng.normal(0.0, 2.0, 3))
        axis = rng.normal(size=3)
        off = rng.uniform(0.0, np.deg2rad(60.0))
        predicted = truth @ exp_rotation(off * axis / np.linalg.norm(axis))
        for case in possible_cases(rectangle):
            # Its inverse, which is the case itself, is what hides the truth.
            measured = truth @ apply_case(np.eye(4), case)[:3, :3]
            found, scalar = resolve_case(measured, predicted, rectangle)
            assert found is case
            assert scalar == pytest.approx(np.cos(0.5 * off), abs=1e-9)


def test_scalar_parts_of_the_wrong_cases_vanish() -> None:
    # Yu 2019 (25): for a perfect prediction the others are half turns, with scalar part 0.
    truth = exp_rotation(np.array([0.4, -0.2, 1.0]))
    found, scalar = resolve_case(truth @ np.diag([1.0, -1.0, -1.0]), truth, FACE)
    assert scalar < 1e-7
    assert found in possible_cases(FACE)
    found, scalar = resolve_case(truth @ np.diag([1.0, -1.0, -1.0]), truth, SHEET)
    assert found is AxesCase.X
    assert scalar == pytest.approx(1.0)
