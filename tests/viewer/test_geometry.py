"""Ellipsoids, cones and axes against what they stand for."""

from types import SimpleNamespace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import chi2
from viser.transforms import SO3

from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.rigid_body import inertia_from_ratios
from pcnav.viewer.glyphs import (
    attitude_cone_scale,
    momentum_direction,
    path_segments,
    principal_axes_model,
    seen_magnification,
    sigma_ellipsoid,
    unit_cone,
)
from pcnav.viewer.render_options import place, wxyz_of

_SEEDS = st.integers(0, 2**32 - 1)


def test_viser_is_given_quaternions_scalar_first() -> None:
    """By hand, and by viser's own class of rotations."""
    turn = exp_rotation(np.array([0.0, 0.0, np.pi / 2.0]))
    half = np.sqrt(0.5)
    assert np.allclose(wxyz_of(turn), (half, 0.0, 0.0, half))
    R = exp_rotation(np.array([0.3, -0.7, 1.1]))
    node = SimpleNamespace()
    place(node, make_transform(R, np.array([1.0, 2.0, 3.0])))  # type: ignore[arg-type]
    assert np.allclose(SO3(np.array(node.wxyz)).as_matrix(), R)
    assert np.allclose(node.position, (1.0, 2.0, 3.0))


def covariance(seed: int) -> np.ndarray:
    A = np.random.default_rng(seed).normal(size=(3, 3))
    return A @ A.T + 1e-3 * np.eye(3)


@given(_SEEDS)
def test_points_of_the_ellipsoid_are_so_many_sigma_away(seed: int) -> None:
    P = covariance(seed)
    found = sigma_ellipsoid(P)
    sphere = np.random.default_rng(seed + 1).normal(size=(20, 3))
    sphere /= np.linalg.norm(sphere, axis=1, keepdims=True)
    points = sphere * found.radii @ found.R.T
    mahalanobis = np.sqrt(np.einsum("ni,ij,nj->n", points, np.linalg.inv(P), points))
    assert np.allclose(mahalanobis, 3.0, rtol=1e-6)
    assert np.isclose(np.linalg.det(found.R), 1.0)


def test_the_ellipsoid_holds_as_many_draws_as_chi_square_says() -> None:
    P = covariance(7)
    found = sigma_ellipsoid(P)
    draws = np.random.default_rng(8).multivariate_normal(np.zeros(3), P, size=20_000)
    inside = np.linalg.norm(draws @ found.R / found.radii, axis=1) <= 1.0
    assert abs(inside.mean() - chi2.cdf(9.0, 3)) < 0.005


def test_the_cone_holds_turned_axes() -> None:
    """The tip of z, turned by draws within 3 sigma about one axis, stays within the cone."""
    sd = np.array([0.02, 0.05, 0.01])
    scale = attitude_cone_scale(sd, length_m=2.0, magnified=1.0)
    # A turn by 3 sigma about x tilts z along -y; about y along x.
    assert np.isclose(scale[1] / scale[2], np.tan(3.0 * sd[0]))
    assert np.isclose(scale[0] / scale[2], np.tan(3.0 * sd[1]))
    vertices, faces = unit_cone()
    assert faces.max() == len(vertices) - 1
    assert np.allclose(np.linalg.norm(vertices[1:, :2], axis=1), 1.0)


def test_a_wide_doubt_is_a_wide_cone_and_no_fault() -> None:
    assert np.isfinite(attitude_cone_scale(np.full(3, 10.0), 1.0, 1000.0)).all()


@given(_SEEDS)
def test_principal_axes_make_the_inertia_diagonal(seed: int) -> None:
    rng = np.random.default_rng(seed)
    ratios = np.array([1.0, 1.2, 0.0, 0.0, 0.0]) + 0.1 * rng.normal(size=5)
    R = principal_axes_model(ratios)
    diagonal = R.T @ inertia_from_ratios(ratios) @ R
    assert np.allclose(diagonal - np.diag(np.diag(diagonal)), 0.0, atol=1e-9)
    assert np.all(np.diff(np.diag(diagonal)) <= 1e-12)
    assert np.isclose(np.linalg.det(R), 1.0)


def test_momentum_of_a_sphere_is_along_its_rate() -> None:
    omega = np.array([1.0, -2.0, 0.5])
    along = momentum_direction(np.array([1.0, 1.0, 0.0, 0.0, 0.0]), omega)
    assert np.allclose(along, omega / np.linalg.norm(omega))
    assert np.array_equal(momentum_direction(np.ones(5), np.zeros(3)), np.zeros(3))


def test_a_path_keeps_its_ends() -> None:
    points = np.random.default_rng(3).normal(size=(5003, 3))
    segments = path_segments(points, most=100)
    assert len(segments) <= 102
    assert np.array_equal(segments[0, 0], points[0])
    assert np.array_equal(segments[-1, 1], points[-1])
    assert np.array_equal(segments[1:, 0], segments[:-1, 1])
    assert path_segments(points[:1]).shape == (0, 2, 3)


def test_doubts_are_magnified_by_powers_of_ten_until_they_are_seen() -> None:
    assert seen_magnification(1.0, 10.0) == 1.0
    assert seen_magnification(0.001, 10.0) == 1000.0
    assert seen_magnification(0.0, 10.0) == 1.0
    assert seen_magnification(5.0, 10.0) == 1.0
