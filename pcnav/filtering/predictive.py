"""How probable measurements are before they are taken in: what models are compared by."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.filtering.error_state import Measurement, S, Stack


@dataclass(frozen=True)
class Prediction:
    """Measurements of one time against a prediction of the state."""

    innovation: FloatArray
    """(m,) measured minus predicted."""
    jacobian: FloatArray
    """(m, n) of what is predicted, by the state's error."""
    noise: FloatArray
    """(m, m) covariance of the measurements."""

    def spread(self, covariance: FloatArray) -> FloatArray:
        """(m, m) covariance of the innovation, from that of the state (n, n)."""
        return np.asarray(self.jacobian @ covariance @ self.jacobian.T + self.noise)

    def surprise(self, covariance: FloatArray) -> "Surprise":
        """Under a covariance (n, n) of the state."""
        spread = self.spread(covariance)
        root = np.linalg.cholesky(spread)
        whitened = np.linalg.solve(root, self.innovation)
        log_det = 2.0 * float(np.sum(np.log(np.diag(root))))
        return Surprise(float(whitened @ whitened), log_det, len(whitened))


@dataclass(frozen=True)
class Surprise:
    """What the probability density of an innovation is made of."""

    nis: float
    """Normalised innovation squared."""
    log_det: float
    """Logarithm of the determinant of its covariance."""
    dof: int


def predicted(state: S, measurements: Sequence[Measurement[S]]) -> Prediction:
    """Measurements, at least one, against a state."""
    joint = measurements[0] if len(measurements) == 1 else Stack(measurements)
    return Prediction(joint.residual(state), joint.jacobian(state), joint.covariance)


def log_densities(innovation: FloatArray, spreads: FloatArray) -> FloatArray:
    """(...) Gaussian log densities of one innovation (m,) under covariances (..., m, m).

    Up to the constant ``m log(2 pi) / 2``.
    """
    roots = np.linalg.cholesky(spreads)
    whitened = np.linalg.solve(roots, innovation[:, None])[..., 0]
    log_det = 2.0 * np.sum(np.log(np.diagonal(roots, axis1=-2, axis2=-1)), axis=-1)
    return np.asarray(-0.5 * (np.sum(whitened**2, axis=-1) + log_det))
