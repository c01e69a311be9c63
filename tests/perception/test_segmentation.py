"""Segments against the faces the renderer says each pixel shows."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.perception.returns import Window, window_of_returns
from pcnav.perception.segmentation import Segment, Segmenter
from pcnav.recordings.sequence import Frame
from pcnav.target.rendering import RenderedDepth

Shoot = Callable[..., tuple[Frame, RenderedDepth]]
SIGMA = 0.02


def sheet(width: float, length: float, centre: tuple[float, float, float]) -> trimesh.Trimesh:
    x, y = 0.5 * width, 0.5 * length
    corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]]) + centre
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def join(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh = trimesh.util.concatenate(list(parts))
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def plane(T: FloatArray, normal: tuple[float, float, float], offset: float) -> FloatArray:
    """m of the plane ``normal . p = offset`` of the model."""
    n = T[:3, :3] @ np.array(normal)
    return np.asarray(n / (n @ T[:3, 3] + offset))


def segmented(
    frame: Frame, planes: tuple[FloatArray, ...], sigma: float = SIGMA, rounds: int = 2
) -> tuple[Window, list[Segment], IntArray]:
    window = window_of_returns(frame)
    assert window is not None
    segments, labels = Segmenter(window, sigma, 40).segments(planes, rounds)
    assert labels.shape == window.shape
    sizes = [len(segment.pixels) for segment in segments]
    assert sizes == sorted(sizes, reverse=True)
    for index, segment in enumerate(segments):
        np.testing.assert_array_equal(np.flatnonzero(labels == index), np.sort(segment.pixels))
    return window, segments, labels


def test_coplanar_panels_are_two_segments(shoot: Shoot) -> None:
    pair = join(sheet(1.5, 2.0, (0.0, -1.6, 0.0)), sheet(1.5, 1.5, (0.0, 1.4, 0.0)))
    T = make_transform(exp_rotation(np.array([0.4, 0.3, 0.2])), np.array([0.0, 0.0, 20.0]))
    frame, rendered = shoot(pair, T, SIGMA)
    window, segments, labels = segmented(frame, (plane(T, (0.0, 0.0, 1.0), 0.0),))
    assert len(segments) == 2
    truth = rendered.triangle[window.part] // 2  # two triangles a sheet; -1 stays -1
    assert np.mean(labels[truth >= 0] == truth[truth >= 0]) > 0.995
    assert np.all(labels[truth < 0] == -1)
    for segment in segments:
        assert len(segment.cut_pixels) == 0
        assert segment.n_outline > 50


@pytest.mark.parametrize("seed", range(6))
def test_faces_of_a_box_at_a_corner(shoot: Shoot, seed: int) -> None:
    extents = np.array([3.0, 2.5, 2.0])
    box = trimesh.creation.box(extents)
    rng = np.random.default_rng(seed)
    towards = rng.uniform(0.4, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
    z = -towards / np.linalg.norm(towards)
    x = np.cross(z, rng.normal(size=3))
    x /= np.linalg.norm(x)
    T = make_transform(np.stack([x, np.cross(z, x), z]), np.array([0.2, -0.3, 20.0]))
    frame, rendered = shoot(box, T, SIGMA, seed)
    signs = np.sign(towards)
    planes = tuple(
        plane(T, tuple(sign * axis), 0.5 * extent)
        for sign, axis, extent in zip(signs, np.eye(3), extents, strict=True)
    )
    window, segments, labels = segmented(frame, planes)
    assert len(segments) == 3
    triangle = rendered.triangle[window.part]
    shown = triangle >= 0
    axis_of = np.abs(box.face_normals).argmax(axis=1)
    segment_axis = np.array(
        [np.abs(T[:3, :3].T @ segment.fit.normal).argmax() for segment in segments]
    )
    right = segment_axis[labels[shown]] == axis_of[triangle[shown]]
    assert np.all(labels[shown] >= 0)
    assert right.mean() > 0.995
    assert not np.any(labels[~shown] >= 0)
    for segment in segments:  # convex creases are edges of the face, nothing is hidden
        assert len(segment.cut_pixels) < 0.02 * segment.n_outline + 3


def test_dropouts_are_filled(shoot: Shoot) -> None:
    board = sheet(2.5, 3.0, (0.0, 0.0, 0.0))
    T = make_transform(exp_rotation(np.array([0.5, 0.2, 0.3])), np.array([0.0, 0.0, 20.0]))
    frame, rendered = shoot(board, T, SIGMA)
    lost = np.random.default_rng(3).random(frame.depth_m.shape) < 0.1
    frame.depth_m[lost] = 0.0
    window, segments, labels = segmented(frame, (plane(T, (0.0, 0.0, 1.0), 0.0),))
    assert len(segments) == 1
    shown = rendered.triangle[window.part] >= 0
    assert np.mean(labels[shown] == 0) > 0.985
    assert not np.any(labels[~shown] == 0)
    # Filled pixels are part of the face but no returns.
    residual = rendered.depth_m / np.maximum(frame.depth_m, 1.0)
    near = np.abs(residual - 1.0) * 20.0 < 3.5 * SIGMA
    assert len(segments[0].pixels) > 1.09 * near.sum()


def test_an_occluder_cuts_what_it_hides_and_free_edges_are_edges(shoot: Shoot) -> None:
    scene = join(sheet(4.0, 3.0, (0.0, 0.0, 0.0)), sheet(1.0, 5.0, (2.0, 0.0, -1.5)))
    T = make_transform(np.eye(3), np.array([0.0, 0.0, 20.0]))
    frame, rendered = shoot(scene, T, SIGMA)
    planes = (plane(T, (0.0, 0.0, 1.0), 0.0), plane(T, (0.0, 0.0, 1.0), -1.5))
    window, segments, _ = segmented(frame, planes)
    assert len(segments) == 2
    back = max(segments, key=lambda segment: 1.0 / np.linalg.norm(segment.fit.m))
    front = min(segments, key=lambda segment: 1.0 / np.linalg.norm(segment.fit.m))
    assert len(front.cut_pixels) == 0
    behind = rendered.triangle[window.part] < 2
    shown: BoolArray = (rendered.triangle[window.part] >= 0) & behind
    side = np.flatnonzero(shown.any(axis=1)).size  # the rows along which it is hidden
    assert side <= len(back.cut_pixels) <= side + 2
    u, _ = window.pixel(back.cut_pixels).T
    assert np.all(u > np.nonzero(shown)[1].max() + window.left)


def test_a_face_behind_a_gap_seen_only_by_returns_of_no_plane_is_cut_too(shoot: Shoot) -> None:
    # What hides the face need not be a plane: a sphere in front of it.
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.6)
    ball.apply_translation([0.0, 0.0, -2.0])
    scene = join(sheet(4.0, 3.0, (0.0, 0.0, 0.0)), ball)
    T = make_transform(np.eye(3), np.array([0.0, 0.0, 20.0]))
    frame, _ = shoot(scene, T, SIGMA)
    _, segments, _ = segmented(frame, (plane(T, (0.0, 0.0, 1.0), 0.0),))
    assert len(segments[0].cut_pixels) > 30


def test_the_image_border_cuts(shoot: Shoot) -> None:
    board = sheet(3.0, 2.0, (0.0, 0.0, 0.0))
    T = make_transform(np.eye(3), np.array([4.0, 0.0, 20.0]))  # the view is 4.4 m wide there
    frame, rendered = shoot(board, T, SIGMA)
    window, segments, _ = segmented(frame, (plane(T, (0.0, 0.0, 1.0), 0.0),))
    last_column = rendered.triangle[:, -1] >= 0
    assert last_column.sum() > 20
    u, v = window.pixel(segments[0].cut_pixels).T
    np.testing.assert_array_equal(u, 255)
    np.testing.assert_array_equal(np.sort(v), np.flatnonzero(last_column))


def test_no_plane_no_segment(shoot: Shoot) -> None:
    board = sheet(3.0, 2.0, (0.0, 0.0, 0.0))
    T = make_transform(np.eye(3), np.array([0.0, 0.0, 20.0]))
    frame, _ = shoot(board, T, SIGMA)
    _, segments, labels = segmented(frame, ())
    assert segments == [] and np.all(labels == -1)
    elsewhere = (np.array([0.0, 0.0, 1.0 / 15.0]),)
    _, segments, labels = segmented(frame, elsewhere)
    assert segments == [] and np.all(labels == -1)
    edge_on = (np.array([1.0, 0.0, 1e-4]),)
    _, segments, labels = segmented(frame, edge_on)
    assert segments == [] and np.all(labels == -1)


def test_planes_a_little_off_are_refitted(shoot: Shoot) -> None:
    board = sheet(3.0, 2.0, (0.0, 0.0, 0.0))
    T = make_transform(exp_rotation(np.array([0.6, 0.1, 0.0])), np.array([0.0, 0.0, 20.0]))
    frame, _ = shoot(board, T, SIGMA)
    m = plane(T, (0.0, 0.0, 1.0), 0.0)
    _, segments, _ = segmented(frame, (m * 1.001,))
    assert len(segments) == 1
    error = segments[0].fit.m - m
    assert error @ np.linalg.solve(segments[0].fit.covariance, error) < 16.3  # chi2(3), 99.9 %
