"""The principal frame of a target made unique: (17) of Hu 2024."""

from itertools import permutations, product

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.estimators.features.photogrammetric_frame import photogrammetric_axes


def _choices() -> FloatArray:
    found = [
        np.diag(signs) @ np.eye(3)[:, list(order)]
        for order in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
    ]
    return np.stack([choice for choice in found if np.linalg.det(choice) > 0.0])


PRINCIPAL_CHOICES = _choices()
"""(24, 3, 3) R_body_new from a principal frame to all of them; the first is the identity."""


def principal_axes(inertia: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Moments (..., 3) falling and axes R_g_t (..., 3, 3) of inertia matrices (..., 3, 3) (17).

    The first axis makes an acute angle with the x axis of the given frame, as in print. Print stops
    there, and two frames are left, half a turn about that axis apart; the second axis is therefore
    chosen to make an acute angle with the y axis of the given frame.
    """
    values, vectors = np.linalg.eigh(inertia)
    moments, axes = values[..., ::-1], vectors[..., ::-1]
    x = axes[..., 0] * _sign(axes[..., 0, 0])[..., None]
    y = axes[..., 1] * _sign(axes[..., 1, 1])[..., None]
    return moments, np.stack([x, y, np.cross(x, y)], axis=-1)


def _sign(values: FloatArray) -> FloatArray:
    return np.where(values < 0.0, -1.0, 1.0)


def clearest_order(corners: FloatArray, inertia: FloatArray) -> tuple[int, int, int]:
    """The order of three points (3, 3), map axes, whose frame (6) makes the signs clearest.

    An axis of that frame at right angles to a principal axis would leave its sign to the noise.
    Swapping the first two points reverses two axes of the frame and leaves the margins what they
    are. So of either pair of orders the one is taken that begins with the point farther from the
    third: that depends on the triangle alone, not on the numbering of the points nor on rounding.
    """
    sides = np.linalg.norm(corners[:, None] - corners, axis=-1)
    # Without the last point the farthest comes first; the last itself is at distance 0.
    orders = np.argsort(-sides, axis=1)
    R_map_g = photogrammetric_axes(corners[orders])
    _, axes = principal_axes(np.swapaxes(R_map_g, -1, -2) @ inertia @ R_map_g)
    first, second, third = orders[np.minimum(axes[:, 0, 0], axes[:, 1, 1]).argmax()].tolist()
    return first, second, third


def clearest_triple(points: FloatArray) -> tuple[int, int, int]:
    """The three points (of (n, 3), principal axes, largest moment first) that sign them clearest.

    In the order that does; of triangles half as high as the highest, for a flat one has no frame.
    """
    triples = np.array(list(permutations(range(len(points)), 3)))
    corners = points[triples]
    sides = corners - np.roll(corners, 1, axis=1)
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=-1)
    height = area / np.linalg.norm(sides, axis=-1).max(axis=1)
    high = np.flatnonzero(height >= 0.5 * height.max())
    frames = photogrammetric_axes(corners[high])
    margins = np.minimum(np.abs(frames[:, 0, 0]), np.abs(frames[:, 1, 1]))
    i, j, k = triples[high[int(margins.argmax())]].tolist()
    return i, j, k


def free_axes(inertia: FloatArray) -> FloatArray:
    """(3, 3) R_g_t as the eigen-decomposition hands it out: any order and signs, right-handed."""
    _, axes = np.linalg.eigh(inertia)
    return np.asarray(axes * np.array([1.0, 1.0, np.linalg.det(axes)]))
