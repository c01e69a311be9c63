"""The chi-square distribution, from special functions: importing scipy.stats takes 0.3 s."""

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc, chdtri, gammaincinv

from pcnav.core.arrays import FloatArray


def quantile(probability: npt.ArrayLike, degrees: npt.ArrayLike) -> FloatArray:
    """What a chi-square variable stays below with a probability, element by element."""
    return np.asarray(2.0 * gammaincinv(0.5 * _floats(degrees), _floats(probability)))


def upper_quantile(probability: npt.ArrayLike, degrees: npt.ArrayLike) -> FloatArray:
    """What a chi-square variable exceeds with a probability; precise for tiny ones."""
    return np.asarray(chdtri(_floats(degrees), _floats(probability)))


def exceeds(value: npt.ArrayLike, degrees: npt.ArrayLike) -> FloatArray:
    """The probability that a chi-square variable exceeds a value, element by element."""
    return np.asarray(chdtrc(_floats(degrees), _floats(value)))


def _floats(values: npt.ArrayLike) -> FloatArray:
    return np.asarray(values, dtype=np.float64)
