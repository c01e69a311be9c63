"""Runs of edges: their derivative by the pose, and the edges that have none."""

import numpy as np
import pytest
import trimesh

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera, project
from pcnav.core.spatial import exp_rotation, make_transform, transform_points
from pcnav.perception.edge_counts import OFFSET_PX
from tests.perception.outlines import (
    BOX,
    FACING,
    DrawPose,
    View,
    at,
    is_mean,
    join,
    moved,
    one_edge,
    sampled,
    sheet,
)


def crossings(pixels: FloatArray, major: FloatArray, upright: bool) -> FloatArray:
    """Where the line through two pixels (2, 2) crosses rows (if upright) or columns."""
    (a0, a1), (b0, b1) = pixels[:, int(upright)], pixels[:, 1 - int(upright)]
    return np.asarray(b0 + (b1 - b0) * (major - a0) / (a1 - a0))


def numerical_jacobian(
    ends: FloatArray, camera: PinholeCamera, T: FloatArray
) -> tuple[FloatArray, FloatArray, int]:
    """How a pose displaces a projected edge outward: in its middle (6,), change by crossing (6,).

    And how many pixel columns or rows it crosses.
    """
    pixels = project(camera, transform_points(T, ends))
    along = np.abs(pixels[1] - pixels[0])
    upright = bool(along[1] > along[0])
    low, high = np.sort(pixels[:, int(upright)])
    major = np.arange(np.ceil(low), np.floor(high) + 1)
    inward = project(camera, T[None, :3, 3])[0]
    side = np.sign(inward[1 - int(upright)] - crossings(pixels, inward[int(upright)], upright))
    jacobian = []
    for step in 1e-6 * np.eye(6):
        ahead, behind = (
            crossings(project(camera, transform_points(moved(T, d), ends)), major, upright)
            for d in (step, -step)
        )
        jacobian.append(np.polyfit(major - major.mean(), -side * (ahead - behind) / 2e-6, 1))
    tilt, mean = np.array(jacobian).T
    return mean, tilt, len(major)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_jacobian_is_the_motion_of_the_projected_edge(
    camera: PinholeCamera, random_pose: DrawPose, seed: int
) -> None:
    view = View(BOX, camera)
    T = random_pose(np.random.default_rng(seed), 14.0, 18.0)
    frame, compared = view.frame(T), 0
    for k in range(len(view.edges.ends)):
        runs = view.runs(frame, T, edges=one_edge(view.edges, k))
        if len(runs) != 2 or is_mean(runs).tolist() != [True, False]:
            continue  # not in view, or cut into short stretches
        mean, tilt, n = numerical_jacobian(view.edges.vertices[view.edges.ends[k]], camera, T)
        np.testing.assert_allclose(runs.jacobian[1], tilt, rtol=1e-6, atol=1e-8)
        # A line stays a line: the middle of the stretch that is seen is somewhere along it.
        along = (runs.jacobian[0] - mean) @ tilt / (tilt @ tilt)
        assert abs(along) < 0.5 * n
        np.testing.assert_allclose(runs.jacobian[0], mean + along * tilt, rtol=1e-6, atol=1e-6)
        compared += 1
    assert compared >= 3


def test_comparison_can_be_repeated(camera: PinholeCamera, random_pose: DrawPose) -> None:
    view = View(BOX, camera)
    T = random_pose(np.random.default_rng(3))
    frame = view.frame(moved(T, np.full(6, 1e-3)))
    first, second = view.runs(frame, T), view.runs(frame, T)
    np.testing.assert_array_equal(first.value, second.value)
    # Where the view is exact, the count at the line beside an edge still is whole pixels.
    exact = view.runs(view.frame(T), T)
    assert np.abs(exact.value).max() > 0.1 * OFFSET_PX


def test_outline_that_is_further_off_than_any_doubt_tells_no_more_than_that(
    camera: PinholeCamera,
) -> None:
    view = View(sheet(2.0, 2.0), camera)
    T = make_transform(exp_rotation(np.array([0.1, 0.1, 0.2])) @ FACING, np.array([0, 0, 20.0]))
    off = np.array([0.15, 0.15, 0.0, 0.0, 0.0, 0.0])  # four pixels
    assert len(view.runs(view.frame(T), T)) == 8
    runs = view.runs(view.frame(moved(T, off)), T)
    means = is_mean(runs)
    assert np.all(runs.variance[means] > np.maximum(runs.value[means] ** 2, 2.0**2))


# Edges that show nothing.


def test_edges_hidden_behind_another_part_give_no_sample(camera: PinholeCamera) -> None:
    small, large = sheet(1.0, 1.0), sheet(3.0, 3.0, at(0.0, 0.0, 2.0))
    T = make_transform(exp_rotation(np.array([0.1, -0.2, 0.3])) @ FACING, np.array([0, 0, 20.0]))
    alone, both = View(small, camera), View(join(small, large), camera)
    frame = both.frame(T)
    for k in range(4):
        assert len(alone.runs(alone.frame(T), T, edges=one_edge(alone.edges, k))) == 2
        assert len(both.runs(frame, T, edges=one_edge(both.edges, k))) == 0
        assert len(both.runs(frame, T, edges=one_edge(both.edges, 4 + k))) == 2


def test_half_hidden_edges_are_measured_where_they_are_seen(camera: PinholeCamera) -> None:
    lower, upper = sheet(3.0, 3.0), sheet(1.5, 6.0, at(0.0, 0.0, 2.0))
    view, alone = View(join(lower, upper), camera), View(lower, camera)
    T = make_transform(exp_rotation(np.array([0.0, 0.0, 0.1])) @ FACING, np.array([0, 0, 20.0]))
    error = np.array([1e-3, -1e-3, 5e-4, 1e-4, 2e-4, -1e-4])
    frame = view.frame(moved(T, error))
    for k in range(4):
        runs = view.runs(frame, T, edges=one_edge(view.edges, k))
        whole = alone.runs(alone.frame(T), T, edges=one_edge(alone.edges, k))
        # The strip lies across two of the edges and cuts them in two.
        assert len(runs) in (2, 4)
        assert np.all(np.abs(runs.value - runs.jacobian @ error) < 3.0 * np.sqrt(runs.variance))
        assert len(whole) == 2
        if len(runs) == 4:
            turns = np.sort(runs.jacobian[:2, 5])
            assert turns[0] < whole.jacobian[0, 5] < turns[1]
    assert sum(len(view.runs(frame, T, edges=one_edge(view.edges, k))) for k in range(4)) == 12


def test_border_of_the_image_is_no_outline(camera: PinholeCamera, random_pose: DrawPose) -> None:
    filling = View(sheet(50.0, 50.0), camera)
    T = make_transform(FACING, np.array([0.0, 0.0, 20.0]))
    assert (filling.frame(T) > 0.0).all()
    assert len(filling.runs(filling.frame(T), T)) == 0

    # Cut by the right border: its right edge is out of view, and the others are cut.
    cut = View(sheet(4.0, 4.0), camera)
    T = make_transform(exp_rotation(np.array([0.0, 0.0, 0.1])) @ FACING, np.array([4.0, 0, 20.0]))
    seen = [len(cut.runs(cut.frame(T), T, edges=one_edge(cut.edges, k))) for k in range(4)]
    assert sorted(seen) == [0, 2, 2, 2]

    def draw(rng: np.random.Generator) -> FloatArray:
        T = random_pose(rng, 18.0, 22.0)
        T[:2, 3] = 4.3 * np.sign(T[:2, 3])
        return T

    sampled(View(BOX, camera), draw, (0.01, 2e-3), 60).check(0.01, 0.05)


def test_edges_behind_the_camera_give_no_sample(camera: PinholeCamera) -> None:
    front = View(BOX, camera)
    behind = BOX.copy()
    behind.apply_translation([0.0, 0.0, 36.0])
    both = View(join(BOX, behind), camera)
    T = make_transform(exp_rotation(np.array([0.1, -0.2, 0.3])) @ FACING, np.array([0, 0, 18.0]))
    frame = front.frame(T)
    np.testing.assert_array_equal(both.frame(T), frame)
    for k in range(24):
        runs = both.runs(frame, T, edges=one_edge(both.edges, k))
        if k >= 12:
            assert len(runs) == 0
        else:
            alone = front.runs(frame, T, edges=one_edge(front.edges, k))
            np.testing.assert_allclose(runs.value, alone.value, atol=1e-12)

    # A beam that passes the camera: what its long edges project to is no line in the image.
    beam = View(trimesh.creation.box((1.0, 1.0, 60.0)), camera)
    T = make_transform(np.eye(3), np.array([3.0, 0.4, 5.0]))
    frame = beam.frame(T)
    assert (frame > 0.0).any()
    for k in range(12):
        if np.ptp(beam.edges.vertices[beam.edges.ends[k], 2]) > 0.0:
            assert len(beam.runs(frame, T, edges=one_edge(beam.edges, k))) == 0


def test_target_out_of_view_has_no_outline(camera: PinholeCamera) -> None:
    view = View(BOX, camera)
    for position in ([60.0, 0.0, 20.0], [0.0, 0.0, -20.0]):
        T = make_transform(np.eye(3), np.array(position))
        runs = view.runs(view.frame(T), T)
        assert len(runs) == 0
        assert runs.jacobian.shape == (0, 6)


@pytest.mark.parametrize("size", [256, 257])
def test_faces_that_are_edge_on_raise_no_warning(size: int) -> None:
    # With a pixel on the optical axis, rays lie in the planes of a box that is seen straight.
    camera = PinholeCamera.from_field_of_view(size, size, np.deg2rad(25.0))
    view = View(BOX, camera)
    for x in (0.0, 1.0, -1.0):
        for y in (0.0, 0.75):
            T = make_transform(np.eye(3), np.array([x, y, 20.0]))
            runs = view.runs(view.frame(T), T)
            assert len(runs) >= 4
            assert np.isfinite(runs.value).all()
