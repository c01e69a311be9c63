"""Simpler motions that may explain two views as well as an essential matrix does.

Where one of them does, the essential matrix is not determined: a repeated frame, a rotation of
the camera alone (no parallax), and points of one plane (a homography).
"""

from dataclasses import dataclass

import numpy as np

from pcnav.core import chi_square
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import exp_rotation, nearest_rotation, skew
from pcnav.estimators.image_motion.essential import homogeneous, in_front

_SAMPLES = 60
_SAMPLE_SEED = 20221209
_REFITS = 4
_CONFIDENCE = 0.999
_SHARE_TOLERATED = 0.1
"""Share of the matches that may disagree with the simpler motion: wrong ones among them can lie on
the epipolar lines by chance, and must not vouch for the essential matrix."""
_GATE = 4.0
"""Standard deviations beyond which a match disagrees."""


@dataclass(frozen=True)
class Simpler:
    """How well a simpler motion explains the matches."""

    explains: bool
    agreeing: BoolArray
    """(n,)"""


def judge(residuals: FloatArray, sigma: float, parameters: int) -> Simpler:
    """Whether residuals (n, 2) of normalised displacement are noise.

    Both views are noisy, so a residual has the standard deviation sqrt(2) sigma per axis.
    """
    squared = np.sum(residuals**2, axis=-1) / (2.0 * sigma**2)
    agreeing = squared < _GATE**2 + 1.0
    count = int(agreeing.sum())
    degrees = 2 * count - parameters
    few_others = len(squared) - count <= max(1, int(_SHARE_TOLERATED * len(squared)))
    explains = (
        few_others
        and degrees > 0
        and float(squared[agreeing].sum()) <= float(chi_square.quantile(_CONFIDENCE, degrees))
    )
    return Simpler(bool(explains), agreeing)


def at_rest(first: FloatArray, second: FloatArray, sigma: float) -> Simpler:
    """Whether nothing moved in the image: a repeated frame, or a target at rest."""
    return judge(second - first, sigma, 0)


def rotation_alone(
    first: FloatArray, second: FloatArray, sigma: float
) -> tuple[FloatArray, Simpler]:
    """R (3, 3) of a camera that only turned, and whether it explains the matches."""
    a, b = homogeneous(first), homogeneous(second)
    agreeing = np.ones(len(a), dtype=np.bool_)
    R, judged = np.eye(3), judge(second - first, sigma, 3)
    for _ in range(_REFITS):
        R = _fitted_rotation(a[agreeing], b[agreeing])
        moved = a @ R.T
        judged = judge(second - moved[:, :2] / moved[:, 2:], sigma, 3)
        if judged.agreeing.sum() < 3 or np.array_equal(judged.agreeing, agreeing):
            break
        agreeing = judged.agreeing
    return R, judged


def _fitted_rotation(a: FloatArray, b: FloatArray) -> FloatArray:
    """(3, 3) least-squares rotation of rays onto rays, a few Gauss-Newton steps from Kabsch's."""
    unit_a, unit_b = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (a, b))
    R = nearest_rotation(unit_b.T @ unit_a)
    for _ in range(2):
        moved = a @ R.T
        z = moved[:, 2:]
        by_ray = np.zeros((len(a), 2, 3))
        by_ray[:, 0, 0] = by_ray[:, 1, 1] = 1.0 / z[:, 0]
        by_ray[:, :, 2] = -moved[:, :2] / z**2
        jacobian = (by_ray @ -skew(moved)).reshape(-1, 3)
        residual = (b[:, :2] - moved[:, :2] / z).ravel()
        step = np.asarray(np.linalg.lstsq(jacobian, residual, rcond=None)[0], np.float64)
        R = exp_rotation(step) @ R
    return R


def plane(first: FloatArray, second: FloatArray, sigma: float) -> tuple[FloatArray, Simpler]:
    """The homography (3, 3) of most matches, and whether it explains them.

    Samples of four matches, then refits by the direct linear transformation on those that agree.
    """
    rng = np.random.default_rng(_SAMPLE_SEED)
    picks = np.argsort(rng.random((_SAMPLES, len(first))), axis=1)[:, :4]
    tried = _homographies(first[picks], second[picks])
    residuals = second - _carried(tried, np.broadcast_to(first, (_SAMPLES, *first.shape)))
    squared = np.sum(residuals**2, axis=-1) / (2.0 * sigma**2)
    # The smallest median tolerates half of the matches being wrong.
    median = np.median(np.where(np.isfinite(squared), squared, np.inf), axis=1)
    best = int(np.argmin(median))
    order = np.argsort(squared[best])
    agreeing = np.zeros(len(first), dtype=np.bool_)
    agreeing[order[: max(4, (len(first) + 1) // 2)]] = True
    H, judged = tried[best], Simpler(False, agreeing)
    for _ in range(_REFITS):
        H = _homographies(first[agreeing], second[agreeing])
        judged = judge(second - _carried(H, first), sigma, 8)
        if judged.agreeing.sum() < 4 or np.array_equal(judged.agreeing, agreeing):
            break
        agreeing = judged.agreeing
    return H, judged


def _homographies(first: FloatArray, second: FloatArray) -> FloatArray:
    """(..., 3, 3) of matches (..., n, 2), n >= 4, by the direct linear transformation."""
    centre1, centre2 = first.mean(axis=-2, keepdims=True), second.mean(axis=-2, keepdims=True)
    scale = np.sqrt(np.mean((first - centre1) ** 2, axis=(-2, -1)))
    scale = np.where(scale > 0.0, scale, 1.0)[..., None, None]
    a = homogeneous((first - centre1) / scale)
    u, v = np.moveaxis((second - centre2) / scale, -1, 0)
    zero = np.zeros_like(a)
    rows = np.concatenate(
        [
            np.concatenate([a, zero, -u[..., None] * a], axis=-1),
            np.concatenate([zero, a, -v[..., None] * a], axis=-1),
        ],
        axis=-2,
    )
    _, vectors = np.linalg.eigh(np.swapaxes(rows, -1, -2) @ rows)
    H = vectors[..., 0].reshape(*vectors.shape[:-2], 3, 3)
    back = np.linalg.inv(_similarity(centre1, scale))
    return np.asarray(_similarity(centre2, scale) @ H @ back)


def _similarity(centre: FloatArray, scale: FloatArray) -> FloatArray:
    """(..., 3, 3) that takes conditioned points back: centre (..., 1, 2), scale (..., 1, 1)."""
    T = np.zeros((*centre.shape[:-2], 3, 3))
    T[..., 0, 0] = T[..., 1, 1] = scale[..., 0, 0]
    T[..., :2, 2] = centre[..., 0, :]
    T[..., 2, 2] = 1.0
    return T


def _carried(H: FloatArray, x: FloatArray) -> FloatArray:
    moved = homogeneous(x) @ np.swapaxes(H, -1, -2)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(moved[..., :2] / moved[..., 2:])


def rotations_of_plane(
    H: FloatArray, first: FloatArray, second: FloatArray
) -> tuple[FloatArray, ...]:
    """The rotations (3, 3) that a homography of matches (n, 2) allows: one or two.

    ``H = s (R + t n^T)`` with the middle singular value of the bracket 1 (Faugeras and Lustman
    1988; the closed form of Ma, Soatto, Kosecka and Sastry 2004, section 5.3.3). Of the two pairs
    of solutions those with the plane before the camera are kept.
    """
    H = H / np.linalg.svd(H, compute_uv=False)[1]
    a, b = homogeneous(first), homogeneous(second)
    if np.sum(b * (a @ H.T)) < 0.0:
        H = -H
    _, values, Vt = np.linalg.svd(H)
    s1, s3 = values[0] ** 2, values[2] ** 2
    if s1 - s3 < 1e-12:
        return (nearest_rotation(H),)
    v1, v2, v3 = Vt * np.sign(np.linalg.det(Vt))
    up, down = np.sqrt(max(1.0 - s3, 0.0)), np.sqrt(max(s1 - 1.0, 0.0))
    found = []
    for sign in (1.0, -1.0):
        u = (up * v1 + sign * down * v3) / np.sqrt(s1 - s3)
        U = np.stack([v2, u, np.cross(v2, u)], axis=1)
        W = np.stack([H @ v2, H @ u, np.cross(H @ v2, H @ u)], axis=1)
        R = nearest_rotation(W @ U.T)
        normal = np.cross(v2, u)
        t = (H - R) @ normal
        side = np.sign(np.median(a @ normal))
        length = np.linalg.norm(t)
        if length < 1e-12 or np.mean(in_front(R, side * t / length, first, second)) > 0.5:
            found.append(R)
    return tuple(found)
