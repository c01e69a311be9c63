"""Rotations and rigid transforms against scipy, matrix exponentials and numerical derivatives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import (
    exp_rotation,
    invert_transform,
    left_jacobian,
    log_rotation,
    make_transform,
    rotation_angle,
    rotation_fault,
    rotation_from_xyzw,
    skew,
    transform_points,
    xyzw_from_rotation,
)

# Angles where the formulas change branch or lose digits, besides ordinary ones.
ANGLES = st.one_of(
    st.floats(0.0, np.pi - 1e-3),
    st.floats(0.0, 1e-3),
    st.sampled_from([0.0, 1e-12, 1e-8, 0.99e-4, 1e-4, 1.01e-4]),
    st.floats(np.pi - 1e-3, np.pi - 1e-9),
)


@st.composite
def vectors(draw: st.DrawFn) -> FloatArray:
    """A rotation vector with an angle in [0, pi)."""
    axis = np.array(draw(st.tuples(*[st.floats(-1.0, 1.0)] * 3)))
    norm = float(np.linalg.norm(axis))
    axis = np.array([1.0, 0.0, 0.0]) if norm < 1e-3 else axis / norm
    return np.asarray(draw(ANGLES) * axis)


@given(vectors(), vectors())
def test_skew_is_the_cross_product(a: FloatArray, b: FloatArray) -> None:
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), atol=1e-15)
    np.testing.assert_array_equal(skew(a), -skew(a).T)


@given(vectors())
def test_exponential_is_that_of_the_matrix_and_of_scipy(v: FloatArray) -> None:
    np.testing.assert_allclose(exp_rotation(v), expm(skew(v)), atol=2e-14)
    np.testing.assert_allclose(exp_rotation(v), Rotation.from_rotvec(v).as_matrix(), atol=1e-14)


@given(vectors())
def test_logarithm_undoes_the_exponential(v: FloatArray) -> None:
    np.testing.assert_allclose(log_rotation(exp_rotation(v)), v, atol=1e-12)
    assert rotation_angle(exp_rotation(v)) == pytest.approx(np.linalg.norm(v), abs=1e-12)


def test_logarithm_is_that_of_scipy_for_one_matrix_and_for_many() -> None:
    rng = np.random.default_rng(0)
    # One matrix takes another way up to a right angle than beyond it, and than a batch.
    changes = [0.0, 1e-4, 0.5 * np.pi, np.pi]
    near = [a + d for a in changes for d in (0.0, 1e-15, -1e-15, 1e-9, -1e-9, 1e-5, -1e-5)]
    spread = np.linspace(0.0, np.pi, 200).tolist()
    angles = np.array([angle for angle in near + spread if 0.0 <= angle <= np.pi])
    axes = rng.normal(size=(len(angles), 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    rotations = Rotation.from_rotvec(angles[:, None] * axes)
    R, expected = rotations.as_matrix(), rotations.as_rotvec()
    # At a half turn either sense of the axis is right; just beside it the matrix shows which only
    # to its rounding.
    sure = angles < np.pi - 1e-7
    batched = log_rotation(R)
    single = np.array([log_rotation(matrix) for matrix in R])
    for found in (batched, single, log_rotation(R.reshape(-1, 1, 3, 3))[:, 0]):
        np.testing.assert_allclose(found[sure], expected[sure], atol=1e-13, rtol=1e-13)
        np.testing.assert_allclose(np.linalg.norm(found, axis=1), angles, atol=2e-8)
        np.testing.assert_allclose(Rotation.from_rotvec(found).as_matrix(), R, atol=1e-14)
    # A small rotation keeps its digits, not only its size.
    small = 1e-9 * np.array([1.0, -2.0, 0.5])
    np.testing.assert_allclose(log_rotation(exp_rotation(small)), small, rtol=1e-7)
    assert log_rotation(np.eye(3)).tolist() == [0.0, 0.0, 0.0]


def test_logarithm_at_half_turns_about_any_axis() -> None:
    axes = np.vstack([np.eye(3), np.random.default_rng(0).normal(size=(20, 3))])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    vectors_found = log_rotation(2.0 * axes[:, :, None] * axes[:, None, :] - np.eye(3))
    np.testing.assert_allclose(np.linalg.norm(vectors_found, axis=1), np.pi, atol=1e-12)
    np.testing.assert_allclose(np.abs(np.sum(vectors_found * axes, axis=1)), np.pi, atol=1e-12)


@given(vectors(), vectors())
def test_left_jacobian_is_the_numerical_derivative(v: FloatArray, direction: FloatArray) -> None:
    step = 1e-5 * (direction if direction.any() else np.array([0.0, 1.0, 0.0]))
    ahead, behind = exp_rotation(v + step), exp_rotation(v - step)
    numerical = 0.5 * log_rotation(ahead @ behind.T)
    np.testing.assert_allclose(left_jacobian(v) @ step, numerical, atol=1e-13 + 3e-10 * 1e-5)
    numerical_right = 0.5 * log_rotation(behind.T @ ahead)
    np.testing.assert_allclose(left_jacobian(-v) @ step, numerical_right, atol=1e-13 + 3e-15)


@given(vectors())
def test_left_jacobian_is_the_integral_of_the_rotation(v: FloatArray) -> None:
    nodes, weights = np.polynomial.legendre.leggauss(20)
    rotations = Rotation.from_rotvec(0.5 * (nodes[:, None] + 1.0) * v).as_matrix()
    integral = 0.5 * np.einsum("n,nij->ij", weights, rotations)
    # (t - sin t) / t^3 costs digits just above its series' threshold, times t^2 = 1e-8.
    np.testing.assert_allclose(left_jacobian(v), integral, atol=1e-14)
    np.testing.assert_allclose(left_jacobian(-v), left_jacobian(v).T, atol=1e-15)


@given(vectors(), vectors())
def test_inverse_and_product_of_transforms(v: FloatArray, p: FloatArray) -> None:
    T = make_transform(exp_rotation(v), p)
    np.testing.assert_allclose(invert_transform(T) @ T, np.eye(4), atol=1e-14)
    np.testing.assert_allclose(invert_transform(T), np.linalg.inv(T), atol=1e-13)
    points = np.array([[0.3, -2.0, 5.0], [1.0, 0.0, 0.0]])
    homogeneous = np.column_stack([points, np.ones(2)])
    np.testing.assert_allclose(
        transform_points(T, points), (homogeneous @ T.T)[:, :3], rtol=1e-14, atol=1e-14
    )


@given(vectors())
def test_quaternions_are_scalar_last_with_a_scalar_not_negative(v: FloatArray) -> None:
    half = 0.5 * np.linalg.norm(v)
    vector = 0.5 * v * np.sinc(half / np.pi)
    quaternion = xyzw_from_rotation(exp_rotation(v))
    # The closed form; the angle is below pi, so its scalar is positive.
    np.testing.assert_allclose(quaternion, [*vector, np.cos(half)], atol=1e-12)
    np.testing.assert_allclose(rotation_from_xyzw(-2.0 * quaternion), exp_rotation(v), atol=1e-12)


def test_all_functions_batch_over_leading_dimensions() -> None:
    rng = np.random.default_rng(1)
    v, p = rng.normal(size=(2, 4, 3)), rng.normal(size=(2, 4, 3))
    v[0, 0] = 0.0
    points = rng.normal(size=(2, 4, 5, 3))
    R = exp_rotation(v)
    T = make_transform(R, p)
    q = xyzw_from_rotation(R)
    jacobian = left_jacobian(v)
    for i, j in np.ndindex(2, 4):
        np.testing.assert_allclose(R[i, j], expm(skew(v[i, j])), atol=1e-13)
        np.testing.assert_allclose(jacobian[i, j], left_jacobian(v[i, j]), atol=1e-15)
        np.testing.assert_allclose(q[i, j], xyzw_from_rotation(R[i, j]), atol=1e-15)
        np.testing.assert_allclose(invert_transform(T)[i, j], np.linalg.inv(T[i, j]), atol=1e-13)
        moved = points[i, j] @ R[i, j].T + p[i, j]
        np.testing.assert_allclose(transform_points(T, points)[i, j], moved, atol=1e-14)
    assert make_transform(np.eye(3), p).shape == (2, 4, 4, 4)
    assert rotation_angle(R).shape == (2, 4)


def test_what_is_no_rotation_is_told_in_words() -> None:
    R = exp_rotation(np.array([0.4, -1.0, 2.0]))
    assert rotation_fault(R) is None
    assert "reflection" in str(rotation_fault(R @ np.diag([1.0, 1.0, -1.0])))
    assert "orthonormal" in str(rotation_fault(1.001 * R))
    assert "orthonormal" in str(rotation_fault(np.zeros((3, 3))))
    for value in (np.nan, np.inf):
        damaged = R.copy()
        damaged[1, 2] = value
        assert "finite" in str(rotation_fault(damaged))
    rounded = np.round(R, 4)
    assert rotation_fault(rounded) is not None
    assert rotation_fault(rounded, tolerance=1e-3) is None
