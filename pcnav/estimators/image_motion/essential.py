"""The essential matrix: eight-point method, decomposition, cheirality, Sampson error; batched.

Points are normalised image coordinates (..., n, 2): a point of the target is seen along
``(x, y, 1)`` in camera axes. Between a first and a second view the target's points move as
``p_second = R p_first + t`` (Appl. Sci. 2022 (8)): R is ``R_second_first``, t is known up to its
length. ``E = [t]x R`` obeys ``x_second^T E x_first = 0`` (11).
"""

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import skew

_QUARTER_TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def normalised(camera: PinholeCamera, pixels: FloatArray) -> FloatArray:
    """(..., 2) normalised coordinates of pixels (..., 2): (2) inverted."""
    return (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]


def homogeneous(x: FloatArray) -> FloatArray:
    """(..., 3) rays with z = 1 of normalised coordinates (..., 2)."""
    return np.concatenate([x, np.ones((*x.shape[:-1], 1))], axis=-1)


def eight_point(first: FloatArray, second: FloatArray) -> FloatArray:
    """(..., 3, 3) essential matrices of matches (..., n, 2), n >= 8, all of them taken as right.

    Hartley's normalisation of both images, the least-squares null vector, and the nearest matrix
    with singular values (1, 1, 0).
    """
    T1, T2 = _conditioning(first), _conditioning(second)
    a = homogeneous(first) @ np.swapaxes(T1, -1, -2)
    b = homogeneous(second) @ np.swapaxes(T2, -1, -2)
    rows = (b[..., :, None] * a[..., None, :]).reshape(*a.shape[:-1], 9)
    _, vectors = np.linalg.eigh(np.swapaxes(rows, -1, -2) @ rows)
    raw = vectors[..., 0].reshape(*a.shape[:-2], 3, 3)
    return nearest_essential(np.swapaxes(T2, -1, -2) @ raw @ T1)


def _conditioning(x: FloatArray) -> FloatArray:
    """(..., 3, 3) similarity that gives points zero mean and a mean squared length of 2."""
    mean = x.mean(axis=-2)
    spread = np.sqrt(np.mean(np.sum((x - mean[..., None, :]) ** 2, axis=-1), axis=-1) / 2.0)
    scale = 1.0 / np.where(spread > 0.0, spread, 1.0)
    T = np.zeros((*x.shape[:-2], 3, 3))
    T[..., 0, 0] = T[..., 1, 1] = scale
    T[..., :2, 2] = -scale[..., None] * mean
    T[..., 2, 2] = 1.0
    return T


def nearest_essential(E: FloatArray) -> FloatArray:
    """(..., 3, 3) the nearest matrix (up to scale) with singular values 1, 1, 0."""
    U, _, Vt = np.linalg.svd(E)
    return np.asarray((U * [1.0, 1.0, 0.0]) @ Vt)


def essential_of(R: FloatArray, t: FloatArray) -> FloatArray:
    """``[t]x R`` of (..., 3, 3) and (..., 3)."""
    return np.asarray(skew(t) @ R)


def decompose(E: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The four motions of an essential matrix: R (..., 4, 3, 3) proper, t (..., 4, 3) unit."""
    U, _, Vt = np.linalg.svd(E)
    U = U * np.sign(np.linalg.det(U))[..., None, None]
    Vt = Vt * np.sign(np.linalg.det(Vt))[..., None, None]
    Ra, Rb = U @ _QUARTER_TURN @ Vt, U @ _QUARTER_TURN.T @ Vt
    t = U[..., :, 2]
    return np.stack([Ra, Ra, Rb, Rb], axis=-3), np.stack([t, -t, t, -t], axis=-2)


def depths(
    R: FloatArray, t: FloatArray, first: FloatArray, second: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Depths (..., n) of points in the first and in the second view, over the length of t.

    Of ``z2 x2 = z1 R x1 + t`` in least squares. Not finite for parallel rays.
    """
    a = homogeneous(first) @ np.swapaxes(R, -1, -2)
    b, t = homogeneous(second), t[..., None, :]
    aa, bb, ab = (np.sum(u * v, axis=-1) for u, v in ((a, a), (b, b), (a, b)))
    at, bt = np.sum(a * t, axis=-1), np.sum(b * t, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = aa * bb - ab * ab
        return (ab * bt - bb * at) / determinant, (aa * bt - ab * at) / determinant


def in_front(R: FloatArray, t: FloatArray, first: FloatArray, second: FloatArray) -> BoolArray:
    """(..., n) whether a point lies before the camera in both views."""
    z1, z2 = depths(R, t, first, second)
    return np.asarray((z1 > 0.0) & (z2 > 0.0))


def pose_of(E: FloatArray, first: FloatArray, second: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The one motion of four that has most points before the camera: R (..., 3, 3), t (..., 3)."""
    R, t = decompose(E)
    counts = in_front(R, t, first[..., None, :, :], second[..., None, :, :]).sum(axis=-1)
    best = np.argmax(counts, axis=-1)[..., None]
    chosen_R = np.take_along_axis(R, best[..., None, None], axis=-3)[..., 0, :, :]
    return chosen_R, np.take_along_axis(t, best[..., None], axis=-2)[..., 0, :]


def direction_given_rotation(
    R: FloatArray, first: FloatArray, second: FloatArray, weights: FloatArray | None = None
) -> FloatArray:
    """(..., 3) unit t that fits best with a rotation, its sign by cheirality.

    Every match demands ``t . (x2 x R x1) = 0``; ``weights`` (..., n) scale the matches.
    """
    a = homogeneous(first) @ np.swapaxes(R, -1, -2)
    normal = np.cross(homogeneous(second), a)
    if weights is not None:
        normal = normal * weights[..., None]
    _, vectors = np.linalg.eigh(np.swapaxes(normal, -1, -2) @ normal)
    t = vectors[..., 0]
    both = np.stack([t, -t], axis=-2)
    front = in_front(R[..., None, :, :], both, first[..., None, :, :], second[..., None, :, :]).sum(
        axis=-1
    )
    return np.where((front[..., 0] >= front[..., 1])[..., None], t, -t)


def sampson(E: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """(..., n) first-order distance of matches to the epipolar constraint.

    With independent noise s on all four coordinates its standard deviation is s.
    """
    lines = homogeneous(first) @ np.swapaxes(E, -1, -2)
    back = homogeneous(second) @ E
    error = np.sum(homogeneous(second) * lines, axis=-1)
    squared = np.sum(lines[..., :2] ** 2, axis=-1) + np.sum(back[..., :2] ** 2, axis=-1)
    return np.asarray(error / np.sqrt(np.maximum(squared, np.finfo(np.float64).tiny)))


def mirrored_rotation(R: FloatArray, first: FloatArray, second: FloatArray) -> FloatArray:
    """The rotation that a distant camera confuses with R: (..., 3, 3).

    A camera far away sees the same when the target's relief and its rotation out of the image
    plane are both reversed. With the rays to the middle of the points along z in both views,
    ``R = Rot_z(a) Rot_y(b) Rot_z(c)``; the mirrored one has -b.
    """
    Q1, Q2 = _to_optical_axis(first), _to_optical_axis(second)
    turned = Q2 @ R @ np.swapaxes(Q1, -1, -2)
    # Rot_z(a) Rot_y(-b) Rot_z(c) is the same matrix with rows and columns x, y against z negated.
    sign = np.array([[1.0, 1.0, -1.0], [1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
    return np.asarray(np.swapaxes(Q2, -1, -2) @ (turned * sign) @ Q1)


def out_of_plane_angle(R: FloatArray, first: FloatArray, second: FloatArray) -> float:
    """Angle (rad) by which R (3, 3) turns the target out of the image plane: b above."""
    turned = _to_optical_axis(second) @ R @ _to_optical_axis(first).T
    return float(np.arctan2(np.hypot(turned[0, 2], turned[1, 2]), turned[2, 2]))


def _to_optical_axis(x: FloatArray) -> FloatArray:
    """(..., 3, 3) the smallest rotation that carries the mean ray onto z."""
    ray = homogeneous(x.mean(axis=-2))
    ray = ray / np.linalg.norm(ray, axis=-1, keepdims=True)
    axis = np.cross(ray, np.array([0.0, 0.0, 1.0]))
    k = skew(axis)
    return np.asarray(np.eye(3) + k + k @ k / (1.0 + ray[..., 2])[..., None, None])
