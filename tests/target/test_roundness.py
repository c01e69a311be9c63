"""Turns without a trace, against the motions they are."""

import numpy as np
import pytest

from pcnav.core.spatial import exp_rotation, log_rotation, make_transform, rotation_angle
from pcnav.target.roundness import Roundness

AXIS = np.array([0.36, -0.48, 0.8])
POINT = np.array([0.5, -1.0, 2.0])
STAGE, BALL = Roundness(POINT, AXIS[None]), Roundness(POINT, np.eye(3))


def test_turns_leave_the_axis_where_it_is():
    T = STAGE.turns(1.1 * AXIS)
    for p in (POINT, POINT + 3.0 * AXIS):
        assert np.allclose(T[:3, :3] @ p + T[:3, 3], p)


def test_the_nearest_turn_is_the_best_of_many():
    rng = np.random.default_rng(1)
    R = exp_rotation(rng.normal(size=(5, 3)))
    best = rotation_angle(np.swapaxes(STAGE.towards(R)[:, :3, :3], 1, 2) @ R)
    tried = exp_rotation(np.outer(np.linspace(-np.pi, np.pi, 721), AXIS))
    angles = rotation_angle(np.swapaxes(tried, 1, 2)[:, None] @ R)
    assert np.all(best <= angles.min(axis=0) + 1e-9)
    assert np.allclose(best, angles.min(axis=0), atol=5e-3)
    assert np.allclose(BALL.towards(R)[:, :3, :3], R)


@pytest.mark.parametrize("roundness", [STAGE, BALL], ids=["stage", "ball"])
def test_projection_takes_out_turns_and_nothing_else(roundness):
    R = exp_rotation(np.array([0.2, 0.7, -0.4]))
    T = make_transform(R, np.array([1.0, 2.0, 9.0]))
    projection = roundness.without_turns(R)
    assert np.allclose(projection @ projection, projection)
    assert np.linalg.matrix_rank(projection) == 6 - len(roundness.axes_model)
    for axis in roundness.axes_model:
        turned = T @ roundness.turns(1e-6 * axis)
        turn = log_rotation(R.T @ turned[:3, :3])
        error = np.concatenate([turned[:3, 3] - T[:3, 3], turn]) / 1e-6
        assert np.allclose(projection @ error, 0.0, atol=1e-4)
    across = np.cross(AXIS, [1.0, 0.0, 0.0])
    for kept in (np.r_[1.0, 0, 0, 0, 0, 0], np.r_[0, 0.0, 1.0, 0, 0, 0]):
        assert np.allclose(projection @ kept, kept)
    if roundness is STAGE:
        about_the_point = np.concatenate([R @ np.cross(POINT, across), across])
        assert np.allclose(projection @ about_the_point, about_the_point)
