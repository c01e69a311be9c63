"""ADD and ADD-S against plain double loops and closed forms."""

import math

import numpy as np
import pytest
import trimesh

from pcnav.core.spatial import exp_rotation, make_transform, transform_points
from pcnav.evaluation.model_distance import model_distances, surface_points

IDENTITY = np.eye(4)[None]
HALF_TURN = make_transform(np.diag([-1.0, -1.0, 1.0]), np.zeros(3))


def random_poses(generator: np.random.Generator, count: int, spread: float):
    true = make_transform(
        exp_rotation(generator.normal(size=(count, 3))), generator.normal(size=(count, 3))
    )
    change = make_transform(
        exp_rotation(spread * generator.normal(size=(count, 3))),
        spread * generator.normal(size=(count, 3)),
    )
    return true, true @ change


@pytest.mark.parametrize("spread", [0.01, 0.3, 3.0])
def test_both_distances_equal_a_double_loop(spread: float) -> None:
    generator = np.random.default_rng(1)
    points = generator.normal(size=(40, 3))
    true, estimated = random_poses(generator, 5, spread)
    found = model_distances(points, true, estimated)
    for k in range(5):
        at = [true[k, :3, :3] @ p + true[k, :3, 3] for p in points]
        guess = [estimated[k, :3, :3] @ p + estimated[k, :3, 3] for p in points]
        add = sum(math.dist(a, b) for a, b in zip(at, guess, strict=True)) / len(points)
        add_s = sum(min(math.dist(a, b) for b in guess) for a in at) / len(points)
        assert found.add_m[k] == pytest.approx(add, rel=1e-12)
        assert found.add_s_m[k] == pytest.approx(add_s, rel=1e-12)


def test_a_long_run_is_cut_into_batches_without_a_trace(monkeypatch: pytest.MonkeyPatch) -> None:
    generator = np.random.default_rng(2)
    points = generator.normal(size=(30, 3))
    true, estimated = random_poses(generator, 17, 0.2)
    whole = model_distances(points, true, estimated)
    monkeypatch.setattr("pcnav.evaluation.model_distance._POINTS_AT_ONCE", 100)
    cut = model_distances(points, true, estimated)
    np.testing.assert_allclose(cut.add_m, whole.add_m, rtol=1e-13)
    np.testing.assert_allclose(cut.add_s_m, whole.add_s_m, rtol=1e-13)


def test_a_shifted_pose_has_the_shift_as_add() -> None:
    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    points = surface_points(mesh, IDENTITY, 500)
    shifted = IDENTITY.copy()
    shifted[0, :3, 3] = 0.3, -0.4, 1.2
    found = model_distances(points, IDENTITY, shifted)
    assert found.add_m[0] == pytest.approx(1.3)
    assert found.add_s_m[0] < 1.3


def test_add_s_of_a_shifted_sphere_is_its_closed_form() -> None:
    """It is the mean distance of a point to the other sphere's surface."""
    radius, shift = 2.0, 0.8
    sphere = trimesh.creation.icosphere(subdivisions=5, radius=radius)
    points = surface_points(sphere, IDENTITY, 60_000)
    moved = IDENTITY.copy()
    moved[0, :3, 3] = 0.0, shift, 0.0
    # u = |x + d|^2 is uniform between (r - d)^2 and (r + d)^2 (Archimedes), so the mean of
    # |sqrt(u) - r| is an integral of elementary functions.
    squares = np.linspace((radius - shift) ** 2, (radius + shift) ** 2, 200_001)
    expected = np.trapezoid(np.abs(np.sqrt(squares) - radius), squares) / np.ptp(squares)
    found = model_distances(points, moved, IDENTITY)
    # Sampled points lie apart by a few hundredths: that is what is added in square.
    assert found.add_s_m[0] == pytest.approx(expected, rel=0.01)


def test_a_symmetry_costs_nothing_in_add_s() -> None:
    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    motions = np.stack([np.eye(4), HALF_TURN])
    points = surface_points(mesh, motions, 1001)
    assert len(points) == 1002
    found = model_distances(points, IDENTITY, HALF_TURN[None])
    assert found.add_s_m[0] < 1e-12
    # Every point is turned to the far side of the axis.
    distance = 2.0 * np.hypot(points[:, 0], points[:, 1]).mean()
    assert found.add_m[0] == pytest.approx(distance)
    alone = surface_points(mesh, IDENTITY, 1002)
    assert model_distances(alone, IDENTITY, HALF_TURN[None]).add_s_m[0] > 0.01


def test_surface_points_lie_evenly_on_the_surface_and_are_reproducible() -> None:
    mesh = trimesh.creation.box((1.0, 2.0, 3.0))
    points = surface_points(mesh, IDENTITY, 20_000, seed=3)
    np.testing.assert_array_equal(points, surface_points(mesh, IDENTITY, 20_000, seed=3))
    outside = np.max(np.abs(points) - [0.5, 1.0, 1.5], axis=1)
    np.testing.assert_allclose(outside, 0.0, atol=1e-12)
    top = np.mean(np.isclose(points[:, 2], 1.5))
    assert top == pytest.approx(2.0 / 22.0, abs=0.01)


def test_frames_without_a_pose_stay_without_a_distance() -> None:
    points = transform_points(np.eye(4), np.eye(3))
    poses = np.repeat(IDENTITY, 3, axis=0)
    gap = poses.copy()
    gap[1] = np.nan
    found = model_distances(points, poses, gap)
    np.testing.assert_array_equal(np.isnan(found.add_m), [False, True, False])
    np.testing.assert_array_equal(np.isnan(found.add_s_m), [False, True, False])
    assert found.add_m[0] == 0.0
