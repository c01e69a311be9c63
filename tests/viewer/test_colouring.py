"""Colours against an independent account of what each return shows."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pcnav.core.camera import pixel_rays
from pcnav.core.spatial import invert_transform, transform_points
from pcnav.viewer import frames
from pcnav.viewer.colouring import (
    EXPLAINED_SIGMA,
    face_names,
    label_colours,
    nice_ceiling,
    range_residual,
    residual_colours,
)
from pcnav.viewer.frames import ColourBy, FrameStore, Shot
from pcnav.viewer.layers import read_ahead, shot_of
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.palette import BESIDE, LABELS, RESIDUAL_STOPS, UNEXPLAINED
from tests.viewer.conftest import FRAMES

LAST = FRAMES - 1


def test_returns_of_a_rectangle_lie_in_it(loaded: LoadedRun) -> None:
    """Points said to show a rectangle are carried into its frame: within its sides, near z = 0."""
    shot = shot_of(loaded, LAST)
    assert shot is not None and shot.rectangles is not None
    assert loaded.target is not None and loaded.frames is not None
    p_cam = pixel_rays(shot.frame.camera)[shot.shown] * shot.frame.depth_m[shot.shown][:, None]
    np.testing.assert_allclose(p_cam, shot.points, atol=1e-5)
    T_model_cam = invert_transform(loaded.T_cam_model[LAST])
    shown = np.unique(shot.rectangles[shot.rectangles >= 0])
    assert len(shown) >= 3
    for number in shown:
        rectangle = loaded.target.rectangles[number]
        p_model = transform_points(T_model_cam, p_cam[shot.rectangles == number])
        p_rect = transform_points(invert_transform(rectangle.T_model_rect), p_model)
        half = 0.5 * np.array([rectangle.width_m, rectangle.length_m])
        assert np.all(np.abs(p_rect[:, :2]) < half + 0.1)
        # The noise is along the ray, never longer than along the normal.
        assert np.abs(p_rect[:, 2]).max() < EXPLAINED_SIGMA * loaded.frames.sigma_m + 1e-3


def test_residuals_are_noise_at_the_estimate(loaded: LoadedRun) -> None:
    shot = shot_of(loaded, LAST)
    assert shot is not None and shot.residual_m is not None and loaded.frames is not None
    known = shot.residual_m[np.isfinite(shot.residual_m)]
    inner = known[np.abs(known) < 5.0 * loaded.frames.sigma_m]
    assert len(inner) > 0.95 * len(known)
    assert 0.7 < inner.std() / loaded.frames.sigma_m < 1.3


def test_a_target_moved_back_is_behind_the_model(loaded: LoadedRun) -> None:
    shot = shot_of(loaded, LAST)
    assert shot is not None and loaded.target is not None
    from pcnav.target.rendering import DepthRenderer

    rendered = DepthRenderer(loaded.target.mesh, shot.frame.camera).render(loaded.T_cam_model[LAST])
    at = np.nonzero(rendered.depth_m > 0.0)
    model_m, faces = rendered.depth_m[at].astype(float), rendered.triangle[at]
    rays = pixel_rays(shot.frame.camera)[at]
    seen = range_residual(model_m + 0.1, rays, model_m, faces)
    assert np.isnan(range_residual(model_m, rays, model_m, np.full_like(faces, -1))).all()
    # Along the ray it is a little more than along the axis.
    assert seen.min() > 0.0999 and seen.max() < 0.105


def test_what_the_target_cannot_reach_is_grey(loaded: LoadedRun) -> None:
    shot = shot_of(loaded, LAST)
    assert shot is not None and shot.beside is not None
    assert loaded.frames is not None and loaded.target is not None
    assert not shot.beside.any()
    T = loaded.T_cam_model[LAST].copy()
    # The middle of the returns: those on one side are farther than the target reaches.
    T[0, 3] += 0.7 * loaded.target.diameter_m
    apart = loaded.frames.get(LAST, shot.frame.time_s, T)
    assert apart is not None and apart.beside is not None
    middle = transform_points(T, np.asarray(loaded.target.mesh.bounds).mean(axis=0)[None])[0]
    distance = np.linalg.norm(apart.points - middle, axis=1) / loaded.target.diameter_m
    colours = apart.colours(ColourBy.PLANE, 0.1)
    grey = (colours == BESIDE).all(axis=1)
    assert grey[distance > 0.58].all() and (distance > 0.58).any()
    assert not grey[distance < 0.55].any() and (distance < 0.55).any()


def test_frames_without_an_estimate_show_planes_of_their_own(loaded: LoadedRun) -> None:
    assert not loaded.run.has_estimate[0]
    shot = shot_of(loaded, 0)
    assert shot is not None and shot.rectangles is None and shot.residual_m is None
    assert len(np.unique(shot.planes[shot.planes >= 0])) >= 2
    for by in ColourBy:
        assert shot.colours(by, 0.1).shape[-1] == 3


def test_planes_of_a_large_frame_are_found_in_some_of_its_returns(
    loaded: LoadedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert loaded.frames is not None and loaded.target is not None
    assert loaded.run.pipeline is not None
    table, time_s = loaded.run.pipeline.perception, float(loaded.run.time_s[0])
    whole = shot_of(loaded, 0)
    assert whole is not None
    monkeypatch.setattr(frames, "MAX_POINTS", len(whole.points) // 3)
    store = FrameStore(loaded.frames.recording, loaded.target, table, 0)
    found = store.get(0, time_s, None, 10**9)
    assert found is not None and found.stride == 1 and found.planes.shape == whole.planes.shape
    for plane in np.unique(whole.planes[whole.planes >= 0])[:2]:
        labels, n = np.unique(found.planes[whole.planes == plane], return_counts=True)
        # Numbers may differ, and at the rim a neighbour stands for a return.
        assert n.max() > 0.7 * n.sum() and labels[n.argmax()] >= 0


def test_flat_parts_of_the_mesh_are_told_apart(loaded: LoadedRun) -> None:
    assert loaded.target is not None
    mesh = loaded.target.mesh
    names = face_names(mesh, loaded.target.rectangles)
    # All small ones share the last number.
    for number in range(len(LABELS) - 1):
        normals = mesh.face_normals[names.plane == number]
        assert np.allclose(normals @ normals[0], 1.0, atol=1e-6)
    assert {int(k) for k in np.unique(names.rectangle)} - {-1} == set(
        range(len(loaded.target.rectangles))
    )


def test_colours_of_residuals_are_their_stops() -> None:
    scale = 0.05
    ends = residual_colours(np.array([-1.0, 0.0, 1.0, np.nan]), scale)
    assert [tuple(int(value) for value in colour) for colour in ends] == [
        *RESIDUAL_STOPS,
        UNEXPLAINED,
    ]
    left, right = residual_colours(np.array([-0.02, 0.02]), scale)
    assert left[2] > left[0] and right[0] > right[2]


def test_labels_have_colours_and_the_unexplained_its_own() -> None:
    colours = label_colours(np.array([[-1, 0], [1, 12]]))
    assert tuple(int(value) for value in colours[0, 0]) == UNEXPLAINED
    assert not np.array_equal(colours[0, 1], colours[1, 0])


def test_scales_end_at_round_numbers() -> None:
    assert [nice_ceiling(v) for v in (0.06, 0.0601, 1.0, 0.9)] == [0.075, 0.075, 1.0, 1.0]


def test_fewer_points_keep_points_and_pixels_together_and_say_how_many(loaded: LoadedRun) -> None:
    whole, thin = shot_of(loaded, LAST), shot_of(loaded, LAST, 100)
    assert whole is not None and thin is not None
    assert 50 < len(thin.points) <= 100 < len(whole.points)
    assert thin.n_returns == len(whole.points) == whole.n_returns
    rows, columns = (thin.stride * each for each in thin.shown)
    depth_m = whole.frame.depth_m[rows, columns]
    rays = pixel_rays(whole.frame.camera)[rows, columns]
    assert np.allclose(thin.points, rays * depth_m[:, None], atol=1e-5)
    assert thin.colours(ColourBy.PLANE, 0.1).shape == thin.points.shape
    # Where both show a pixel they say the same of it.
    assert whole.residual_m is not None and thin.residual_m is not None
    np.testing.assert_allclose(
        thin.residual_m, _image(whole, whole.residual_m)[rows, columns], atol=1e-4
    )
    assert np.mean(thin.planes == _image(whole, whole.planes)[rows, columns]) > 0.98


def _image(shot: Shot, values: np.ndarray) -> np.ndarray:
    """(height, width) values of the returns, where they are in the image."""
    image = np.full(shot.frame.depth_m.shape, np.nan)
    image[shot.shown] = values
    return image


def test_only_the_returns_are_compared_and_as_the_whole_image_would_be(loaded: LoadedRun) -> None:
    shot = shot_of(loaded, LAST)
    assert shot is not None and shot.residual_m is not None and loaded.target is not None
    from pcnav.target.rendering import DepthRenderer

    rendered = DepthRenderer(loaded.target.mesh, shot.frame.camera).render(loaded.T_cam_model[LAST])
    hit = rendered.triangle[shot.shown] >= 0
    assert (np.isfinite(shot.residual_m) == hit).all() and hit.sum() > 500
    apart = shot.frame.depth_m[shot.shown] - rendered.depth_m[shot.shown].astype(float)
    expected = apart * np.linalg.norm(pixel_rays(shot.frame.camera)[shot.shown], axis=1)
    np.testing.assert_allclose(shot.residual_m[hit], expected[hit], atol=1e-5)


def test_small_faces_share_a_colour_and_none_comes_twice() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=1)
    plane = face_names(mesh, ()).plane
    own = np.bincount(plane)
    assert plane.max() == len(LABELS) - 1
    assert (own[:-1] == 1).all() and own[-1] == len(mesh.faces) - len(LABELS) + 1
    assert (label_colours(plane)[plane == 3] == LABELS[3]).all()


def test_frames_are_kept_within_a_budget_of_bytes(
    loaded: LoadedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert loaded.frames is not None and loaded.target is not None
    assert loaded.run.pipeline is not None
    table = loaded.run.pipeline.perception
    store = FrameStore(loaded.frames.recording, loaded.target, table, 0)
    one = store.get(LAST, float(loaded.run.time_s[LAST]), loaded.pose(LAST))
    assert one is not None
    # A depth of 32 bits a pixel; a return is a point of 12 bytes and its place, 16 bits of a label
    # twice, a residual of 32.
    pixels, points = one.frame.depth_m.size, len(one.points)
    assert one.n_bytes == pixels * 4 + points * (12 + 2 * 2 + 2 * 2 + 4 + 1)
    monkeypatch.setattr(frames, "_MAX_KEPT_BYTES", 3 * one.n_bytes + 10)
    for frame in range(LAST, 3, -1):
        store.get(frame, float(loaded.run.time_s[frame]), loaded.pose(frame))
        held = [each.n_bytes for each in store._kept.values() if each is not None]
        assert sum(held) == store._kept_bytes <= 3 * one.n_bytes + 10


def test_a_frame_read_ahead_is_there_when_asked_for(loaded: LoadedRun) -> None:
    assert loaded.frames is not None and loaded.target is not None
    assert loaded.run.pipeline is not None
    recording, table = loaded.frames.recording, loaded.run.pipeline.perception
    store = FrameStore(recording, loaded.target, table, 0)
    read_ahead(replace(loaded, frames=store), LAST, 1000)
    assert store._ahead is not None
    ahead = store._ahead.result(10.0)
    assert ahead is not None
    assert shot_of(replace(loaded, frames=store), LAST, 1000) is ahead
