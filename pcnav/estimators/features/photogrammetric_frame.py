"""Attitude from points: the photogrammetric frame (6)-(7) of Hu 2024 and the fit of all points."""

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.spatial import exp_rotation, nearest_rotation, skew
from pcnav.filtering.error_state import innovation_gate

_FIT_STEPS = 3
_MIN_HEIGHT = 1e-3
"""Height of a triangle over its longest side below which its points are called collinear."""
_ALL_TRIPLES_TO = 10
_SAMPLED_TRIPLES = 120


def photogrammetric_axes(points: FloatArray) -> FloatArray:
    """(..., 3, 3) axes R_a_g of the frame of three points (..., 3, 3) given in frame a: (6).

    One point per row. The first axis runs from the first to the second, the third is normal to all.
    """
    first = points[..., 1, :] - points[..., 0, :]
    c1 = first / np.linalg.norm(first, axis=-1, keepdims=True)
    normal = np.cross(first, points[..., 2, :] - points[..., 0, :])
    c3 = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.stack([c1, np.cross(c3, c1), c3], axis=-1)


def best_triple(points: FloatArray) -> tuple[int, int, int]:
    """The three points (of (n, 3)) that span the largest triangle height, hence the best frame.

    Raises `ValueError` for fewer than three points, and when all lie on a line.
    """
    if len(points) < 3:
        raise ValueError(f"{len(points)} points: expected at least 3 to define a frame")
    triples = np.array(list(combinations(range(len(points)), 3)))
    corners = points[triples]
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.linalg.norm(sides, axis=-1).max(axis=1)
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=-1)
    height = np.divide(area, longest, out=np.zeros_like(area), where=longest > 0.0)
    best = int(height.argmax())
    if not height[best] > _MIN_HEIGHT * longest[best]:
        raise ValueError(f"{len(points)} points on a line: expected some that are not")
    i, j, k = triples[best].tolist()
    return i, j, k


@dataclass(frozen=True)
class Alignment:
    """The motions ``p_a = R_a_b p_b + t_a`` that align points, over leading dimensions."""

    R_a_b: FloatArray
    """(..., 3, 3)"""
    t_a: FloatArray
    """(..., 3) m."""
    covariance: FloatArray
    """(..., 6, 6) of the rotation error (axes of a, ``exp(phi) R``, rad) and of t (m)."""
    chi_square: FloatArray
    """(...,) weighted squared residual of the fit."""


def align(
    p_a: FloatArray, p_b: FloatArray, noise_a: FloatArray, noise_b: FloatArray | None = None
) -> Alignment:
    """Weighted fit of points (..., n, 3) with covariances (..., n, 3, 3), both in their own axes.

    Starts from the unweighted fit by singular values (Kabsch 1976), then Gauss-Newton with the full
    covariances: stereo points are far better known across the line of sight than along it. Needs
    at least three points that are not on a line.
    """
    R, t = kabsch(p_a, p_b)
    for _ in range(_FIT_STEPS):
        noise = noise_a
        if noise_b is not None:
            noise = noise_a + R[..., None, :, :] @ noise_b @ np.swapaxes(R, -1, -2)[..., None, :, :]
        weight = np.linalg.inv(noise)
        turned = p_b @ np.swapaxes(R, -1, -2)
        residual = p_a - turned - t[..., None, :]
        by = np.concatenate(
            [-skew(turned), np.broadcast_to(np.eye(3), (*turned.shape[:-1], 3, 3))], axis=-1
        )
        weighted = np.swapaxes(by, -1, -2) @ weight
        information = (weighted @ by).sum(axis=-3)
        gradient = (weighted @ residual[..., None])[..., 0].sum(axis=-2)
        chi_square = (residual[..., None, :] @ weight @ residual[..., None])[..., 0, 0].sum(axis=-1)
        step = np.linalg.solve(information, gradient[..., None])[..., 0]
        R = exp_rotation(step[..., :3]) @ R
        t = t + step[..., 3:]
    return Alignment(R, t, np.linalg.inv(information), chi_square)


def kabsch(p_a: FloatArray, p_b: FloatArray) -> tuple[FloatArray, FloatArray]:
    """R_a_b (..., 3, 3) and t_a (..., 3) of the unweighted fit of points (..., n, 3)."""
    mean_a, mean_b = p_a.mean(axis=-2), p_b.mean(axis=-2)
    spread = np.swapaxes(p_a - mean_a[..., None, :], -1, -2) @ (p_b - mean_b[..., None, :])
    R = nearest_rotation(spread)
    return R, mean_a - (R @ mean_b[..., None])[..., 0]


def consensus(
    p_a: FloatArray,
    p_b: FloatArray,
    noise_a: FloatArray,
    noise_b: FloatArray,
    rng: np.random.Generator,
    probability: float = 0.999,
) -> BoolArray:
    """(n,) which pairs of points (n, 3) move as one rigid body between frames b and a.

    Of the motions that triples of pairs define, the one that most other pairs follow within their
    covariances (RANSAC, Fischler and Bolles 1981; exhaustive for few points). A consensus needs
    four pairs; without one nothing is returned as following.
    """
    n = len(p_a)
    following = np.zeros(n, dtype=np.bool_)
    if n < 4:
        return following
    triples = _well_shaped(_triples(n, rng), p_a, p_b)
    if not len(triples):
        return following
    fits = align(p_a[triples], p_b[triples], noise_a[triples], noise_b[triples])
    apart = _distances(p_a, p_b, noise_a, noise_b, fits)
    follow = apart < innovation_gate(probability, 3)
    # Ties go to the motion that its followers fit best.
    votes = follow.sum(axis=1) - 1e-3 * np.where(follow, apart, 0.0).sum(axis=1) / n
    best = follow[int(votes.argmax())]
    for _ in range(2):
        if best.sum() < 4:
            return following
        fit = align(p_a[best], p_b[best], noise_a[best], noise_b[best])
        best = _distances(p_a, p_b, noise_a, noise_b, fit) < innovation_gate(probability, 3)
    return best if best.sum() >= 4 else following


def _triples(n: int, rng: np.random.Generator) -> IntArray:
    if n <= _ALL_TRIPLES_TO:
        return np.array(list(combinations(range(n), 3)))
    drawn = rng.uniform(size=(_SAMPLED_TRIPLES, n)).argsort(axis=1)[:, :3]
    return np.asarray(drawn, dtype=np.intp)


def _well_shaped(triples: IntArray, p_a: FloatArray, p_b: FloatArray) -> IntArray:
    """Those that are triangles, of about the same sides, in both frames."""
    kept = np.ones(len(triples), dtype=np.bool_)
    for points in (p_a, p_b):
        sides = points[triples] - np.roll(points[triples], 1, axis=1)
        longest = np.linalg.norm(sides, axis=-1).max(axis=1)
        kept &= np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=-1) > 0.05 * longest**2
    return triples[kept]


def _distances(
    p_a: FloatArray, p_b: FloatArray, noise_a: FloatArray, noise_b: FloatArray, fit: Alignment
) -> FloatArray:
    """(..., n) squared Mahalanobis distances of all pairs under motions (...)."""
    R = fit.R_a_b[..., None, :, :]
    turned = (R @ p_b[..., None])[..., 0]
    by = np.concatenate(
        [-skew(turned), np.broadcast_to(np.eye(3), (*turned.shape[:-1], 3, 3))], axis=-1
    )
    noise = noise_a + R @ noise_b @ np.swapaxes(R, -1, -2)
    noise = noise + by @ fit.covariance[..., None, :, :] @ np.swapaxes(by, -1, -2)
    residual = p_a - turned - fit.t_a[..., None, :]
    solved = np.linalg.solve(noise, residual[..., None])[..., 0]
    return np.asarray(np.sum(residual * solved, axis=-1))
