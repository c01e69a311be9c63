"""Attitude from points, inertia from attitudes and the unique principal frame."""

from itertools import permutations

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from pcnav.core.spatial import exp_rotation, log_rotation
from pcnav.core.stereo import StereoRig
from pcnav.dynamics.inertia_parameters import parameters_from_ratios
from pcnav.dynamics.rigid_body import ratios_from_inertia
from pcnav.estimators.attitude_inertia.rotation_fit import fit_rotation_arc
from pcnav.estimators.attitude_inertia.rotation_model import RotationState
from pcnav.estimators.features.photogrammetric_frame import (
    align,
    best_triple,
    consensus,
    photogrammetric_axes,
)
from pcnav.estimators.principal_axes.inertia_identification import (
    angular_rate,
    batch_least_squares,
    errors_in_variables,
)
from pcnav.estimators.principal_axes.principal_frame import (
    PRINCIPAL_CHOICES,
    clearest_order,
    free_axes,
    principal_axes,
)
from pcnav.simulation.motion import rotate_torque_free

R_PRINCIPAL_G = exp_rotation(np.array([0.3, -0.5, 0.8]))
INERTIA_G = R_PRINCIPAL_G.T @ np.diag([8.0, 5.0, 4.0]) @ R_PRINCIPAL_G
RATIOS = ratios_from_inertia(INERTIA_G)


def arc(duration_s=20.0, rate_hz=10.0):
    times = np.arange(round(duration_s * rate_hz)) / rate_hz
    omega = R_PRINCIPAL_G.T @ np.array([0.1, 0.1, 0.1])
    attitudes, rates = rotate_torque_free(exp_rotation(np.ones(3)), omega, INERTIA_G, times)
    return times, attitudes, rates


def noisy(attitudes, sd_rad, rng, runs):
    errors = sd_rad * rng.standard_normal((runs, len(attitudes), 3))
    return attitudes @ exp_rotation(errors)


# Points


def test_three_points_define_a_right_handed_frame():
    rng = np.random.default_rng(0)
    points = rng.normal(size=(5, 3, 3))
    axes = photogrammetric_axes(points)
    np.testing.assert_allclose(
        axes @ np.swapaxes(axes, 1, 2), np.tile(np.eye(3), (5, 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(axes), 1.0)
    # It turns with the points.
    R = exp_rotation(np.array([0.2, 1.0, -0.4]))
    np.testing.assert_allclose(photogrammetric_axes(points @ R.T + 3.0), R @ axes, atol=1e-12)


def test_the_best_triple_is_the_widest():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0.01, 0], [0, 3, 0], [0.1, 0.1, 0]])
    assert best_triple(points) == (0, 2, 3)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.eye(3)[:2], "2 points: expected at least 3"),
        (np.outer(np.arange(4.0), [1.0, 2.0, 3.0]), "4 points on a line"),
        (np.ones((3, 3)), "3 points on a line"),
    ],
)
def test_points_that_define_no_frame(points, message):
    with pytest.raises(ValueError, match=message):
        best_triple(points)


def test_equal_weights_give_what_scipy_finds():
    rng = np.random.default_rng(1)
    p_b = rng.normal(size=(6, 3))
    p_a = p_b @ exp_rotation(rng.normal(size=3)).T + 0.05 * rng.normal(size=(6, 3)) + 2.0
    fit = align(p_a, p_b, np.tile(np.eye(3), (6, 1, 1)))
    oracle, _ = Rotation.align_vectors(p_a - p_a.mean(0), p_b - p_b.mean(0))
    np.testing.assert_allclose(fit.R_a_b, oracle.as_matrix(), atol=1e-9)


def test_alignment_states_its_errors():
    rng = np.random.default_rng(2)
    p_b = rng.uniform(-1.5, 1.5, (6, 3))
    noise = np.tile(np.diag([1e-4, 1e-4, 4e-2]) ** 2 * 25.0, (6, 1, 1))
    root = np.linalg.cholesky(noise)
    R = exp_rotation(np.array([1.0, 0.5, -0.2]))
    errors = (root @ rng.standard_normal((400, 6, 3, 1)))[..., 0]
    fit = align(p_b @ R.T + errors, np.tile(p_b, (400, 1, 1)), np.tile(noise, (400, 1, 1, 1)))
    turn = log_rotation(fit.R_a_b @ R.T)
    error = np.concatenate([turn, fit.t_a], axis=1)
    nees = np.einsum("bi,bi->b", error, np.linalg.solve(fit.covariance, error[..., None])[..., 0])
    assert nees.mean() == pytest.approx(6.0, rel=0.12)
    assert fit.chi_square.mean() == pytest.approx(12.0, rel=0.12)


@pytest.mark.parametrize("points", [6, 16])
def test_consensus_leaves_wrong_pairs_out(points):
    rng = np.random.default_rng(3)
    rig = StereoRig(1.0, 1000.0, (511.5, 511.5), (1024, 1024), 0.05)
    for _ in range(10):
        p_b = np.array([0.0, 0.0, 15.0]) + rng.uniform(-1.5, 1.5, (points, 3))
        R = exp_rotation(0.5 * rng.normal(size=3))
        p_a = (p_b - p_b.mean(0)) @ R.T + p_b.mean(0)
        wrong = rng.choice(points, points // 5, replace=False)
        p_a[wrong] = p_a[np.roll(wrong, 1)] + [0.5, 0.5, 0.0]
        noisy_pixels = [rig.project(p) + 0.05 * rng.normal(size=(points, 4)) for p in (p_a, p_b)]
        (a, noise_a), (b, noise_b) = (rig.triangulate(p) for p in noisy_pixels)
        found = consensus(a, b, noise_a, noise_b, rng)
        assert not found[wrong].any()
        assert found.sum() >= points - len(wrong) - 1


def test_no_consensus_among_three():
    eye = np.tile(np.eye(3), (3, 1, 1))
    assert not consensus(np.eye(3), np.eye(3), eye, eye, np.random.default_rng(0)).any()


# Inertia


def test_rates_are_those_of_the_motion():
    times, attitudes, rates = arc()
    np.testing.assert_allclose(angular_rate(attitudes, times), rates[1:-1], atol=2e-5)


def test_identification_without_noise():
    times, attitudes, rates = arc()
    printed = batch_least_squares(attitudes, rates)
    np.testing.assert_allclose(ratios_from_inertia(printed), RATIOS, atol=1e-8)
    unbiased = errors_in_variables(attitudes, rates, np.tile(np.eye(3), (len(times), 1, 1)))
    np.testing.assert_allclose(ratios_from_inertia(unbiased), RATIOS, atol=1e-6)


def test_noise_biases_only_the_printed_solution():
    rng = np.random.default_rng(5)
    times, attitudes, _ = arc(60.0)
    seen = noisy(attitudes, 3e-3, rng, 60)
    rates, inner = angular_rate(seen, times), seen[:, 1:-1]
    noise = np.broadcast_to(np.eye(3), (*rates.shape, 3))
    truth = np.diag([8.0, 5.0, 4.0]) / (17.0 / 3.0)

    def bias(inertia):
        found = 3.0 * inertia / np.trace(inertia, axis1=1, axis2=2)[:, None, None]
        moments = R_PRINCIPAL_G @ found @ R_PRINCIPAL_G.T
        return np.abs(moments.mean(axis=0) - truth).max()

    printed = bias(batch_least_squares(inner, rates))
    corrected = bias(errors_in_variables(inner, rates, noise))
    assert printed > 0.02
    assert corrected < 0.3 * printed


def test_arc_fit_states_its_errors():
    rng = np.random.default_rng(6)
    times, attitudes, rates = arc(20.0)
    times, attitudes, rates = times[::4], attitudes[::4], rates[::4]
    runs, sd = 100, 1e-3
    seen = noisy(attitudes, sd, rng, runs)
    truth = parameters_from_ratios(RATIOS)
    start = truth + 0.2 * rng.uniform(-1.0, 1.0, (runs, 5))
    noise = np.broadcast_to(sd**2 * np.eye(3), (runs, len(times), 3, 3))
    fit = fit_rotation_arc(times, seen, noise, np.tile(rates[1], (runs, 1)), start)
    assert fit.converged.mean() > 0.95
    error = fit.start.local(RotationState(attitudes[0], rates[0], truth))
    nees = np.einsum("bi,bi->b", error, np.linalg.solve(fit.covariance, error[..., None])[..., 0])
    assert nees.mean() / 11.0 == pytest.approx(1.0, abs=0.2)


def test_an_arc_that_was_begun_absurdly_ends_without_a_fit():
    times, attitudes, rates = arc(20.0)
    times, attitudes = times[::4], attitudes[::4]
    seen = np.broadcast_to(attitudes, (2, *attitudes.shape))
    noise = np.broadcast_to(1e-6 * np.eye(3), (2, len(times), 3, 3))
    start = np.tile(parameters_from_ratios(RATIOS), (2, 1))
    with np.errstate(over="ignore", invalid="ignore"):
        fit = fit_rotation_arc(times, seen, noise, np.stack([rates[1], [1e200] * 3]), start)
    assert fit.converged.tolist() == [True, False]


# The principal frame


def test_the_principal_frame_is_unique():
    rng = np.random.default_rng(7)
    for _ in range(20):
        R = Rotation.random(rng=rng).as_matrix()
        moments, axes = principal_axes(R @ np.diag([4.0, 8.0, 5.0]) @ R.T)
        np.testing.assert_allclose(moments, [8.0, 5.0, 4.0])
        np.testing.assert_allclose(
            axes.T @ R @ np.diag([4.0, 8.0, 5.0]) @ R.T @ axes, np.diag(moments), atol=1e-12
        )
        assert np.linalg.det(axes) == pytest.approx(1.0)
        assert axes[0, 0] >= 0.0 and axes[1, 1] >= 0.0
        free = free_axes(R @ np.diag([4.0, 8.0, 5.0]) @ R.T)
        assert np.linalg.det(free) == pytest.approx(1.0)
        assert (
            np.abs(np.abs(PRINCIPAL_CHOICES) - np.abs(axes.T @ free)).max(axis=(1, 2)).min() < 1e-9
        )


def test_the_clearest_order_depends_on_the_triangle_alone():
    rng = np.random.default_rng(8)
    for _ in range(28):
        corners, R = rng.uniform(-1.5, 1.5, (3, 3)), Rotation.random(rng=rng).as_matrix()
        inertia = R @ np.diag([8.0, 5.0, 4.0]) @ R.T
        chosen = corners[list(clearest_order(corners, inertia))]
        for order in permutations(range(3)):
            # Other numbers, and rounding: of each pair of orders both have the same margins.
            seen = corners[list(order)] * (1.0 + 1e-15 * rng.standard_normal((3, 3)))
            found = seen[list(clearest_order(seen, inertia))]
            np.testing.assert_allclose(found, chosen, atol=1e-12)


def test_there_are_24_choices():
    assert len(PRINCIPAL_CHOICES) == 24
    np.testing.assert_array_equal(PRINCIPAL_CHOICES[0], np.eye(3))
    assert len({tuple(S.ravel()) for S in PRINCIPAL_CHOICES}) == 24


def test_principal_frame_of_a_mesh():
    mesh = trimesh.creation.box([0.6, 1.0, 1.7])
    mesh.apply_transform(trimesh.transformations.random_rotation_matrix(np.array([0.2, 0.5, 0.7])))
    moments, axes = principal_axes(mesh.moment_inertia)
    np.testing.assert_allclose(moments, np.sort(mesh.principal_inertia_components)[::-1])
    # trimesh's rows are the axes, smallest moment first, of either sign.
    cosines = np.abs(axes.T @ mesh.principal_inertia_vectors[::-1].T)
    np.testing.assert_allclose(cosines, np.eye(3), atol=1e-9)
