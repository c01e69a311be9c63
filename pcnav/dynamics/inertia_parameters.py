"""The inertia of a rigid body over its trace: what a filter errs in, and what a body can have.

Rotation without torque does not show the scale of the inertia, so five numbers are left. Here they
are entries of ``N = 3 I / tr(I)``. Which of them a body can have follows from the second moments of
its density, ``S = 1/2 tr(I) 1 - I``, over their sum:

    S / tr(S) = 1 - 2/3 N,    without negative eigenvalues

(the rotational part of the pseudo-inertia; Wensing, Kim and Slotine 2018, Rucker and Wensing 2022).
The eigenvalues are the shares of the principal axes in the second moments. One of them vanishes
where the principal moments meet the triangle inequality with equality: in a sheet.

Why not parameters every choice of which is a body, such as the log-Cholesky factors of S (Rucker
and Wensing 2022): Euler's equations are linear in I, so what frames tell of it are planes in the
space of inertia matrices, thin where they were measured. A filter keeps them as planes in the space
of its parameters. N is I but for a scale, and planes they stay. A logarithm bends them, and an
estimate that moves along such a plane ends many of its thicknesses away from it, with a covariance
that does not know. So N moves freely, and `inside` brings back what leaves the bodies.
"""

import numpy as np
from scipy.optimize import nnls

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.rigid_body import symmetric_units

MIN_SHARE = 1e-3
"""Second moment along the thinnest axis, over the sum of the three, that an estimate is left: that
of a square plate 22 times as wide as thick."""

# Entry (i, j) of N that each parameter stands for; N_xx is what is left of the trace.
_ENTRIES = ((1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
BALL = np.array([1.0, 1.0, 0.0, 0.0, 0.0])
"""(5,) parameters of a ball."""
_THIN_SHARE, _THIN_SD = 0.01, 0.005
_ENOUGH = 0.9 * MIN_SHARE
"""The last tenth is not worth another plane."""
_ROUNDING = 1e-9
_MAX_PLANES = 20


INERTIA_UNITS = symmetric_units(_ENTRIES)
INERTIA_UNITS[:2, 0, 0] = -1.0
"""(5, 3, 3) derivative of N by its parameters; its trace stays 3."""
_INERTIA_AT_ZERO = np.diag([3.0, 0.0, 0.0])
_SHARE_UNITS = -2.0 / 3.0 * INERTIA_UNITS
"""(5, 3, 3) derivative of S / tr(S) by each parameter."""
_SHARES_AT_ZERO = np.diag([-1.0, 1.0, 1.0])


def inertia_of(parameters: FloatArray) -> FloatArray:
    """(..., 3, 3) N of its parameters (..., 5)."""
    return np.asarray(_INERTIA_AT_ZERO + np.einsum("...p,pij->...ij", parameters, INERTIA_UNITS))


def parameters_of(inertia: FloatArray) -> FloatArray:
    """(..., 5) parameters of inertia matrices (..., 3, 3) of any scale."""
    scaled = 3.0 * inertia / np.trace(inertia, axis1=-2, axis2=-1)[..., None, None]
    return np.stack([scaled[..., i, j] for i, j in _ENTRIES], axis=-1)


def parameters_from_ratios(ratios: FloatArray) -> FloatArray:
    """(5,) N_yy, N_zz, N_xy, N_xz, N_yz of the ratios Iyy, Izz, Ixy, Ixz, Iyz over Ixx.

    Raises `ValueError` where the trace is not positive.
    """
    trace = 1.0 + ratios[0] + ratios[1]
    if not trace > 0.0:
        raise ValueError(f"inertia ratios {_listed(ratios)}: expected a positive trace")
    return np.asarray(ratios * (3.0 / trace))


def ratios_from_parameters(parameters: FloatArray) -> FloatArray:
    """(5,) ratios Iyy, Izz, Ixy, Ixz, Iyz over Ixx. Raises `ValueError` where Ixx <= 0."""
    return np.asarray(parameters / _n_xx(parameters))


def ratios_jacobian(parameters: FloatArray) -> FloatArray:
    """(5, 5) derivative of `ratios_from_parameters`."""
    n_xx = _n_xx(parameters)
    jacobian = np.eye(5) / n_xx
    # N_xx = 3 - N_yy - N_zz is in the denominator.
    jacobian[:, :2] += (parameters / n_xx**2)[:, None]
    return jacobian


def parameter_covariance(ratios: FloatArray, ratios_sd: FloatArray) -> FloatArray:
    """(5, 5) covariance of the parameters, to first order, of independent errors of the ratios.

    Standard deviations (5,). Raises `ValueError` for ratios that no body can have.
    """
    parameters = parameters_from_ratios(ratios)
    if not shares(parameters)[0][0] > -_ROUNDING:
        raise ValueError(
            f"inertia ratios {_listed(ratios)}: expected those of a body, whose principal moments "
            "are none larger than the other two together"
        )
    root = np.linalg.inv(ratios_jacobian(parameters)) * ratios_sd
    return np.asarray(root @ root.T)


def shares(parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Shares of the principal axes (..., 3), smallest first, and their derivative (..., 3, 5)."""
    values, axes = np.linalg.eigh(_shares(parameters))
    return values, np.einsum("...ik,pij,...jk->...kp", axes, _SHARE_UNITS, axes)


def _least_share(parameters: FloatArray) -> float:
    # Without the derivatives, which take three times as long.
    return float(np.linalg.eigh(_shares(parameters))[0][0])


def thinness(parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
    """What shares (..., 3) lack of a hundredth, over half of that, and its derivative (..., 3, 5).

    As residuals of a fit they hardly keep a body from being thin, and they do keep the fit from
    what is no body.
    """
    values, slopes = shares(parameters)
    lack = np.maximum(_THIN_SHARE - values, 0.0) / _THIN_SD
    return lack, np.where((lack > 0.0)[..., None], -slopes / _THIN_SD, 0.0)


def inside(parameters: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The push f (5,), and the parameters (5,) that it leads to, of a body that is not too thin.

    ``parameters + P f`` is the nearest body to the parameters in the metric of their covariance
    P (5, 5) with no share below `MIN_SHARE`: what is known well stays, the rest gives way
    (Simon 2010, projection of the estimate). The push is zero where nothing is to be done.

    The bodies are a convex set, cut out by the planes ``v^T S v = MIN_SHARE tr(S)`` for all
    directions v. The plane that is violated most is added until none is; the nearest point to a
    few planes' inside is a problem of nonnegative least squares (Lawson and Hanson 1974, LDP).
    """
    push, moved = np.zeros(5), parameters
    if _least_share(parameters) >= _ENOUGH:
        return push, moved
    variances, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(variances, 0.0))
    planes: list[FloatArray] = []
    shortfalls: list[float] = []
    for _ in range(_MAX_PLANES):
        values, slopes = shares(moved)
        scale = float(np.linalg.norm(root.T @ slopes[0]))
        # An inertia that is known exactly cannot give way.
        if values[0] >= _ENOUGH or scale == 0.0:
            break
        planes.append(slopes[0] / scale)
        shortfalls.append((MIN_SHARE - values[0] + slopes[0] @ (moved - parameters)) / scale)
        G, h = np.array(planes), np.array(shortfalls)
        multipliers, _ = nnls(np.vstack([(G @ root).T, h]), np.array([0.0] * 5 + [1.0]))
        push = G.T @ multipliers / (1.0 - h @ multipliers)
        moved = parameters + root @ (root.T @ push)
    return push, _towards_ball(moved)


def _towards_ball(parameters: FloatArray) -> FloatArray:
    """Moved straight towards the inertia of a ball as far as it takes to be a body's.

    What is left to do here is rounding, or an inertia that was given as exactly known.
    """
    least, share = 0.5 * MIN_SHARE, _least_share(parameters)
    if share >= least:
        return parameters
    # The smallest eigenvalue is concave: along the way it is above the straight line.
    part = (least - share) / (1.0 / 3.0 - share)
    return np.asarray(parameters + part * (BALL - parameters))


def _shares(parameters: FloatArray) -> FloatArray:
    """(..., 3, 3) S / tr(S)."""
    return np.asarray(_SHARES_AT_ZERO + np.tensordot(parameters, _SHARE_UNITS, 1))


def _n_xx(parameters: FloatArray) -> float:
    n_xx = float(3.0 - parameters[0] - parameters[1])
    if not n_xx > 0.0:
        raise ValueError(
            f"inertia over its mean moment, {_listed(parameters)}: Ixx is not positive"
        )
    return n_xx


def _listed(values: FloatArray) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"
