"""What the pixel grid does to counts of pixels along an edge: their mean and tilt have errors whose
variances follow in closed form from how the edge crosses the grid."""

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray

_HARMONICS = 24


def grid_variances(
    n: IntArray, slope: FloatArray, distance_px: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Variances (k,) of the mean (px^2) and the tilt (px^2 per crossing^2) of counts along edges.

    The last pixel inside an edge at crossing i lies ``e_i = frac(c + i s) - 1/2`` off it, a
    sawtooth with autocovariance C(x) = B2(frac x) / 2. The line d away that pixels are counted at
    has the same sawtooth at other phases, so the counts err by ``e_i(c + d) - e_i(c)``, with
    autocovariance ``2 C(x) - C(x + d) - C(x - d)``.

    Args:
        n: (k,) crossings of each edge.
        slope: (k,) s, pixels per crossing.
        distance_px: (k,) d, the mean distance of that line from the edge; at most half a pixel
            counts.
    """
    lag = np.arange(int(n.max()))
    phase = lag * slope[:, None]
    d = np.minimum(distance_px, 0.5)[:, None]
    covariance = 2.0 * _sawtooth(phase) - _sawtooth(phase + d) - _sawtooth(phase - d)
    covariance[:, 1:] *= 2.0
    # How many pairs of crossings lie so far apart, and the sum of the products of their positions.
    pairs = np.maximum(n[:, None] - lag, 0).astype(np.float64)
    c = 0.5 * (n[:, None] - 1.0)
    products = pairs * (pairs - 1.0) * ((2.0 * pairs - 1.0) / 6.0 + 0.5 * lag - c)
    products += pairs * c * (c - lag)
    mean = np.einsum("ij,ij->i", covariance, pairs) / n**2
    tilt = (
        np.einsum("ij,ij->i", covariance, products) / np.maximum(n * (n**2 - 1.0) / 12.0, 0.5) ** 2
    )
    return np.maximum(mean, 0.0), np.maximum(tilt, 0.0)


def _sawtooth(phase: FloatArray) -> FloatArray:
    x = phase - np.floor(phase)
    return np.asarray(0.5 * (x * x - x + 1.0 / 6.0))


def bent_grid_variances(
    minor_px: FloatArray,
    weights: tuple[FloatArray, FloatArray],
    starts: IntArray,
    distance_px: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Variances (k,) of two weighted sums of the counts along curved edges; for the mean and the
    tilt of straight ones see `grid_variances`, whose notation this has.

    The sawtooth's autocovariance is ``C(x) = sum_j cos(2 pi j x) / (2 pi^2 j^2)``, so a sum of
    counts with weights w at places m has the variance ``sum_j (1 - cos 2 pi j d) |W_j|^2 /
    (pi^2 j^2)`` with ``W_j = sum w exp(2 pi i j m)``. Along a curve the high harmonics of different
    crossings are independent: they are taken together.

    Args:
        minor_px: (n,) where the edges are at each crossing, run after run.
        weights: (n,) each, of the two sums.
        starts: (k,) first crossing of each run.
        distance_px: (k,) d.
    """
    harmonic = np.arange(1, _HARMONICS + 1)
    wave = np.exp(2.0j * np.pi * (minor_px - np.floor(minor_px)))
    powers = np.cumprod(np.broadcast_to(wave[:, None], (len(wave), _HARMONICS)), axis=1)
    d = np.minimum(distance_px, 0.5)[:, None]
    share = (1.0 - np.cos(2.0 * np.pi * harmonic * d)) / (np.pi * harmonic) ** 2
    # All harmonics together are those of a single count, d (1 - d).
    rest = np.maximum(d[:, 0] * (1.0 - d[:, 0]) - share.sum(axis=1), 0.0)
    found = []
    for weight in weights:
        spectrum = np.abs(np.add.reduceat(weight[:, None] * powers, starts)) ** 2
        alone = np.add.reduceat(weight**2, starts)
        found.append(np.einsum("ij,ij->i", spectrum, share) + rest * alone)
    return found[0], found[1]
