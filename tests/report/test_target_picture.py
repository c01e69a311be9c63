"""The picture of a target, against where things are and what is known of simple bodies."""

import io
from collections import Counter

import numpy as np
import pytest
import trimesh
from PIL import Image

from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.report.target_picture import png_of, start_relies_on, symmetry_axes, target_picture
from pcnav.report.target_view import colour_of, view_from
from pcnav.target.satellite import load_target


def target_of(folder, mesh):
    mesh.export(folder / "target.stl")
    return load_target(folder / "target.stl")


def test_a_view_shows_the_outline_where_the_target_is(tmp_path):
    box = trimesh.creation.box(extents=(1.0, 2.0, 3.0))
    box.apply_translation([5.0, -2.0, 1.0])
    target = target_of(tmp_path, box)
    # From +x the sides of 2 m and 3 m are seen, the longer one upright.
    view = view_from(target, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0]))
    rows, columns = np.nonzero(view.image[..., 3] > 0.0)
    height, width = np.ptp(rows) + 1, np.ptp(columns) + 1
    assert height / width == pytest.approx(1.5, abs=0.02)
    assert len(rows) == height * width
    corners = view.pixels(np.array([[5.5, -3.0, -0.5], [5.5, -1.0, 2.5]]))
    # y points right where x points to the eye and z up; rows count downwards.
    assert np.allclose(corners[0], [columns.min(), rows.max()], atol=1.5)
    assert np.allclose(corners[1], [columns.max(), rows.min()], atol=1.5)
    # The near face hides the far one.
    assert view.shown(np.array([[5.5, -2.0, 1.0], [4.5, -2.0, 1.0]])).tolist() == [True, False]


def test_rectangles_are_tinted_in_their_own_colour(repository):
    target = load_target(repository / "meshes" / "boxsat.obj")
    view = view_from(target, np.array([1.0, 0.75, 0.7]), np.array([0.0, 0.0, 1.0]))
    tinted = 0
    for index, rectangle in enumerate(target.rectangles):
        centre = rectangle.T_model_rect[:3, 3]
        facing = (view.T_cam_model[:3, :3] @ rectangle.T_model_rect[:3, 2])[2] < -0.25
        if not facing or not view.shown(centre[None])[0]:
            continue
        u, v = np.rint(view.pixels(centre)).astype(int)
        colour, expected = view.image[v, u, :3], np.array(colour_of(index))
        # Shading scales a mix of grey and the colour: the strongest channel stays the strongest.
        assert np.argmax(colour) == np.argmax(expected) or np.ptp(expected) < 0.2
        tinted += 1
    assert tinted >= 4


@pytest.mark.study
def test_symmetry_axes_of_simple_bodies(tmp_path):
    cube = symmetry_axes(target_of(tmp_path, trimesh.creation.box(extents=(1.0, 1.0, 1.0))))
    assert Counter(axis.fold for axis in cube) == {2: 6, 3: 4, 4: 3}
    assert [axis.fold for axis in cube[:3]] == [4, 4, 4]
    prism = trimesh.creation.cylinder(radius=1.0, height=0.9, sections=6)
    T = make_transform(exp_rotation(np.array([0.3, -0.5, 0.2])), np.array([4.0, 1.0, -2.0]))
    prism.apply_transform(T)
    six, *twos = symmetry_axes(target_of(tmp_path, prism))
    assert six.fold == 6
    assert abs(float(six.direction_model @ T[:3, 2])) == pytest.approx(1.0, abs=1e-4)
    assert np.allclose(six.point_model, T[:3, 3], atol=1e-3)
    assert [axis.fold for axis in twos] == [2] * 6
    cone = trimesh.creation.cone(radius=1.0, height=2.0, sections=96)
    (axis,) = symmetry_axes(target_of(tmp_path, cone))
    assert axis.fold is None
    assert abs(float(axis.direction_model[2])) == pytest.approx(1.0, abs=1e-3)
    assert symmetry_axes(target_of(tmp_path, trimesh.creation.icosphere(subdivisions=4))) == ()


def test_what_a_start_relies_on_is_said(tmp_path, repository):
    (ball,) = start_relies_on(target_of(tmp_path, trimesh.creation.icosphere(subdivisions=3)))
    assert "no rectangle: sampled views" in ball
    first, *rest = start_relies_on(load_target(repository / "meshes" / "twinwing.obj"))
    assert first.startswith("10 rectangles")
    assert "mistaken for itself turned by 180 deg about (1.00 0.00 0.00)" in rest[0]


@pytest.mark.parametrize("name", ["cubesat6u", "twinwing"])
def test_the_picture_is_a_png_with_something_on_it(repository, name):
    target = load_target(repository / "meshes" / f"{name}.obj")
    figure = target_picture(target)
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert name in texts
    assert any(target.rectangles[0].name in text for text in texts)
    # Numbers of rectangles, model axes and a scale stand in the views.
    assert {"1", "x", "y", "z"} <= set(texts)
    picture = np.array(Image.open(io.BytesIO(png_of(figure))).convert("RGB"))
    coloured = np.ptp(picture.astype(int), axis=2) > 40
    assert 0.01 < coloured.mean() < 0.5
