"""Frames compared with views of curved, fine and large meshes."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.stats import chi2

from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.perception.render_compare import RenderComparer
from pcnav.recordings.sequence import Frame
from pcnav.target.rendering import RenderedDepth
from pcnav.target.satellite import Target

from .test_render_compare import NONE_LIKELY, PRIOR, SIGMA, moved, total


def test_a_doubtful_pose_is_compared_on_curved_surfaces_too(
    boxsat: Target, camera: PinholeCamera, shoot: Callable[..., tuple[Frame, RenderedDepth]]
) -> None:
    body = trimesh.creation.icosphere(subdivisions=4)
    body.apply_scale([1.5, 2.0, 3.0])
    target = replace(boxsat, mesh=body, rectangles=(), symmetry_transforms=np.eye(4)[None])
    T = make_transform(np.eye(3), np.array([0.0, 0.0, 20.0]))
    frame, clean = shoot(body, T, 0.005)
    coarse = RenderComparer(target, camera, 0.005, stride=4)
    shown = np.count_nonzero(clean.depth_m[::4, ::4])

    def share(doubt: float) -> float:
        found = coarse.compare(frame.depth_m, T, np.eye(6) * doubt**2)
        return sum(face.n_pixels for face in found.faces) / shown

    # Neighbouring pixels lie on facets that differ by more than the noise, but less than the doubt.
    assert share(1e-5) < 0.1
    assert share(0.1) > 0.6


def test_curved_surfaces_tell_as_much_as_they_say(
    boxsat: Target, camera: PinholeCamera, shoot: Callable[..., tuple[Frame, RenderedDepth]]
) -> None:
    """Of poses known to a few hundredths of a pixel; facets of 3 to 5 pixels."""
    body = trimesh.creation.icosphere(subdivisions=4)
    body.apply_scale([1.5, 2.0, 3.0])
    target = replace(boxsat, mesh=body, rectangles=(), symmetry_transforms=np.eye(4)[None])
    comparer = RenderComparer(target, camera, 0.005)
    prior = np.diag(np.repeat([1e-3, 3e-4], 3) ** 2)
    rng, squared, used = np.random.default_rng(5), [], []
    for _ in range(20):
        R = exp_rotation(2.0 * rng.normal(size=3))
        T = make_transform(R, np.array([0.1, -0.2, 20.0]))
        frame, clean = shoot(body, T, 0.005)
        error = np.sqrt(np.diag(prior)) * rng.normal(size=6)
        predicted = moved(T, -error)
        comparison = comparer.compare(frame.depth_m, predicted, prior)
        information, vector = total(comparison)
        J = information + np.linalg.inv(prior)
        wrong = np.linalg.solve(J, vector) - error
        squared.append(wrong @ J @ wrong)
        seen = np.count_nonzero(clean.depth_m)
        used.append(sum(face.n_pixels for face in comparison.faces) / seen)
    assert np.mean(used) > 0.78
    assert chi2.sf(np.sum(squared), 6 * len(squared)) > NONE_LIKELY


def test_shortcuts_of_large_meshes_change_nothing(
    boxsat: Target,
    camera: PinholeCamera,
    shoot: Callable[..., tuple[Frame, RenderedDepth]],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    T = make_transform(exp_rotation(np.array([0.4, -0.7, 0.2])), np.array([0.3, -0.2, 21.0]))
    frame, clean = shoot(boxsat.mesh, T, SIGMA)
    expected = RenderComparer(boxsat, camera, SIGMA).compare(frame.depth_m, T, PRIOR)
    monkeypatch.setattr("pcnav.target.rendering._MANY_FACES", 0)
    monkeypatch.setattr("pcnav.target.rendering._MAX_OUTER", 4)
    monkeypatch.setattr("pcnav.perception.edge_crossings._MANY_EDGES", 0)
    found = RenderComparer(boxsat, camera, SIGMA).compare(frame.depth_m, T, PRIOR)
    assert np.array_equal(found.rendered.triangle, clean.triangle)
    assert np.allclose(found.rendered.depth_m, clean.depth_m, rtol=0.0, atol=1e-9)
    for before, after in zip(total(expected), total(found), strict=True):
        assert np.allclose(before, after, rtol=1e-9)


def test_a_fine_mesh_without_any_long_edge_is_compared_by_ranges(
    boxsat: Target, camera: PinholeCamera, shoot: Callable[..., tuple[Frame, RenderedDepth]]
) -> None:
    body = trimesh.creation.icosphere(subdivisions=5)
    body.apply_scale([1.5, 2.0, 3.0])
    target = replace(boxsat, mesh=body, rectangles=(), symmetry_transforms=np.eye(4)[None])
    T = make_transform(np.eye(3), np.array([0.0, 0.0, 20.0]))
    frame, _ = shoot(body, T, SIGMA)
    found = RenderComparer(target, camera, SIGMA).compare(frame.depth_m, T, np.eye(6) * 0.01)
    assert found.agreement.inlier_ratio > 0.95
