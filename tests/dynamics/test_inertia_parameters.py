"""The inertia over its trace against mass distributions, a general optimiser and derivatives."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh
from scipy.optimize import NonlinearConstraint, minimize
from scipy.spatial.transform import Rotation

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.inertia_parameters import (
    MIN_SHARE,
    inside,
    parameter_covariance,
    parameters_from_ratios,
    ratios_from_parameters,
    ratios_jacobian,
    shares,
    thinness,
)
from pcnav.dynamics.rigid_body import inertia_from_ratios, is_physical_inertia, ratios_from_inertia

PLATE = np.array([1.0, 2.0, 0.0, 0.0, 0.0])
"""Ratios of a square sheet: the triangle inequality holds with equality."""


def random_ratios(rng: np.random.Generator) -> FloatArray:
    """Of a few point masses about their mass centre."""
    points = rng.normal(size=(6, 3))
    points -= points.mean(axis=0)
    return ratios_from_inertia(np.sum(points**2) * np.eye(3) - points.T @ points)


def random_covariance(rng: np.random.Generator, size: int = 5) -> FloatArray:
    """Ill-conditioned, as a filter's are: standard deviations over two decades."""
    axes = np.linalg.qr(rng.normal(size=(size, size)))[0]
    return np.asarray(axes * 10.0 ** rng.uniform(-5.0, -1.0, size) @ axes.T)


def derivative(function: Callable[[FloatArray], FloatArray], at: FloatArray) -> FloatArray:
    """Numerical, by central differences."""
    steps = 1e-6 * np.eye(len(at))
    columns = [(function(at + step) - function(at - step)) / 2e-6 for step in steps]
    return np.stack(columns, axis=-1)


def test_parameters_and_ratios_undo_one_another_at_any_scale() -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        ratios = random_ratios(rng)
        parameters = parameters_from_ratios(ratios)
        np.testing.assert_allclose(ratios_from_parameters(parameters), ratios, rtol=1e-12)
        inertia = inertia_from_ratios(ratios)
        scaled = ratios_from_inertia(rng.uniform(1e-3, 1e3) * inertia)
        np.testing.assert_allclose(parameters_from_ratios(scaled), parameters, rtol=1e-12)
        # The entries of the inertia matrix over its mean moment.
        over_mean = 3.0 * inertia / np.trace(inertia)
        entries = over_mean[[1, 2, 0, 0, 1], [1, 2, 1, 2, 2]]
        np.testing.assert_allclose(parameters, entries, rtol=1e-12)


def test_jacobians_are_the_numerical_ones() -> None:
    rng = np.random.default_rng(2)
    for _ in range(20):
        parameters = parameters_from_ratios(random_ratios(rng))
        numerical = derivative(ratios_from_parameters, parameters)
        scale = np.abs(numerical).max()
        np.testing.assert_allclose(ratios_jacobian(parameters), numerical, atol=1e-8 * scale)
        numerical = derivative(lambda p: shares(p)[0], parameters)
        np.testing.assert_allclose(shares(parameters)[1], numerical, atol=1e-7)


def test_shares_of_a_box_are_those_of_its_squared_sides() -> None:
    sides = np.array([0.7, 1.1, 2.3])
    turned = trimesh.creation.box(sides)
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0.4, -1.1, 0.6]).as_matrix()
    turned.apply_transform(turn)
    ratios = ratios_from_inertia(np.asarray(turned.moment_inertia))
    found, _ = shares(parameters_from_ratios(ratios))
    np.testing.assert_allclose(found, sides**2 / np.sum(sides**2), rtol=1e-10)


def test_a_negative_share_is_no_body() -> None:
    rng = np.random.default_rng(3)
    physical = []
    for _ in range(300):
        half = rng.normal(size=(3, 3))
        inertia = half + half.T + 4.0 * np.eye(3)
        if inertia[0, 0] <= 0.0 or np.linalg.eigvalsh(inertia)[0] <= 0.0:
            continue
        parameters = parameters_from_ratios(ratios_from_inertia(inertia))
        physical.append(is_physical_inertia(inertia))
        assert (shares(parameters)[0][0] >= 0.0) == physical[-1]
    assert 30 < sum(physical) < len(physical) - 30


@pytest.mark.parametrize("size", [0.1, 1.0, 10.0, 1000.0])
def test_whatever_is_brought_inside_is_a_body(size: float) -> None:
    rng = np.random.default_rng(4)
    outside = 0
    for _ in range(60):
        parameters = parameters_from_ratios(random_ratios(rng)) + size * rng.normal(size=5)
        outside += bool(shares(parameters)[0][0] < 0.0)
        _, moved = inside(parameters, random_covariance(rng))
        assert shares(moved)[0][0] >= 0.499 * MIN_SHARE
        assert is_physical_inertia(inertia_from_ratios(ratios_from_parameters(moved)))
    assert outside > 10


def test_a_body_stays_as_it_is() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        parameters = parameters_from_ratios(random_ratios(rng))
        push, moved = inside(parameters, random_covariance(rng))
        assert not push.any()
        np.testing.assert_array_equal(moved, parameters)


def distance_to_the_nearest_body(parameters: FloatArray, root: FloatArray) -> float:
    """By a general optimiser that starts from a ball, in units that make the covariance 1."""
    about = np.linalg.solve(root, parameters)

    def distance(z: FloatArray) -> float:
        return float(np.sum((z - about) ** 2))

    def min_share(z: FloatArray) -> FloatArray:
        return shares(root @ z)[0][:1]

    ball = np.linalg.solve(root, np.array([1.0, 1.0, 0.0, 0.0, 0.0]))
    bodies = NonlinearConstraint(min_share, MIN_SHARE, np.inf)
    return float(minimize(distance, ball, method="SLSQP", constraints=bodies).fun)


def test_the_body_found_is_the_nearest_one() -> None:
    rng = np.random.default_rng(6)
    tried = 0
    while tried < 5:
        parameters = parameters_from_ratios(random_ratios(rng)) + 0.3 * rng.normal(size=5)
        if shares(parameters)[0][0] > -0.02:
            continue
        tried += 1
        covariance = random_covariance(rng)
        push, moved = inside(parameters, covariance)
        np.testing.assert_allclose(parameters + covariance @ push, moved, atol=1e-9)
        ours = float(push @ covariance @ push)
        root = np.asarray(np.linalg.cholesky(covariance), dtype=np.float64)
        theirs = distance_to_the_nearest_body(parameters, root)
        assert ours <= 1.01 * theirs


def test_what_is_known_well_stays_when_the_rest_gives_way() -> None:
    # The difference of the two moments is known, their sum is not.
    parameters = parameters_from_ratios(np.array([0.5, 0.4, 0.0, 0.0, 0.0]))
    known = np.array([1.0, -1.0, 0.0, 0.0, 0.0]) / np.sqrt(2.0)
    covariance = 0.01 * np.eye(5) - (0.01 - 1e-8) * np.outer(known, known)
    _, moved = inside(parameters, covariance)
    assert shares(parameters)[0][0] < 0.0 < shares(moved)[0][0]
    assert abs(known @ (moved - parameters)) < 1e-5
    assert np.linalg.norm(moved - parameters) > 0.01


def test_an_inertia_without_covariance_is_made_a_body_all_the_same() -> None:
    parameters = parameters_from_ratios(np.array([0.5, 0.4, 0.1, 0.0, 0.0]))
    _, moved = inside(parameters, np.zeros((5, 5)))
    assert shares(moved)[0][0] >= 0.499 * MIN_SHARE
    assert np.linalg.norm(moved - parameters) < 0.2


def test_thinness_is_felt_by_thin_bodies_and_by_what_is_none() -> None:
    cube = parameters_from_ratios(np.array([1.0, 1.0, 0.0, 0.0, 0.0]))
    for part in thinness(cube):
        assert not part.any()
    sheet = parameters_from_ratios(PLATE)
    none = parameters_from_ratios(np.array([1.1, 2.4, 0.1, -0.2, 0.1]))
    assert 0.0 < thinness(sheet)[0].max() < thinness(none)[0].max()
    assert thinness(sheet)[0].max() == pytest.approx(2.0)
    numerical = derivative(lambda p: thinness(p)[0], none)
    np.testing.assert_allclose(thinness(none)[1], numerical, atol=1e-5)


def test_covariance_of_the_parameters_is_that_of_ratios_drawn() -> None:
    ratios, sd = np.array([0.8, 1.1, 0.05, -0.1, 0.02]), np.array([1.0, 2.0, 1.5, 0.5, 1.0]) * 1e-3
    rng = np.random.default_rng(7)
    drawn = ratios + sd * rng.standard_normal((4000, 5))
    sampled = np.cov([parameters_from_ratios(each) for each in drawn], rowvar=False)
    stated = parameter_covariance(ratios, sd)
    scale = np.sqrt(np.outer(np.diag(stated), np.diag(stated)))
    np.testing.assert_allclose(sampled / scale, stated / scale, atol=0.08)
    J = ratios_jacobian(parameters_from_ratios(ratios))
    np.testing.assert_allclose(J @ stated @ J.T, np.diag(sd**2), atol=1e-12)


def test_ratios_that_no_body_has_are_refused() -> None:
    sd = np.full(5, 0.1)
    assert np.isfinite(parameter_covariance(PLATE, sd)).all()
    with pytest.raises(ValueError, match=r"inertia ratios \(1, 2\.1, 0, 0, 0\).*larger"):
        parameter_covariance(PLATE + np.array([0.0, 0.1, 0.0, 0.0, 0.0]), sd)
    with pytest.raises(ValueError, match="larger"):
        parameter_covariance(np.array([1.0, 1.0, 1.2, 0.0, 0.0]), sd)
    with pytest.raises(ValueError, match="trace"):
        parameters_from_ratios(np.array([-1.0, -0.5, 0.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match="Ixx"):
        ratios_from_parameters(np.array([2.0, 1.5, 0.0, 0.0, 0.0]))
