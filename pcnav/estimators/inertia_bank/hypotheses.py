"""Hypotheses in log space: likelihoods, weights, and one estimate of many filters."""

from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from pcnav.config.inertia_bank import Likelihood
from pcnav.core.arrays import FloatArray, IntArray, picked
from pcnav.estimators.inertia_bank.relative_state import RelativeStates
from pcnav.filtering.batched_filter import BatchedUpdate

_MEAN_PASSES = 10
_MEAN_TOLERANCE = 1e-12
_LOG_TWO_PI = float(np.log(2.0 * np.pi))


def log_likelihood(update: BatchedUpdate, kind: Likelihood, noise: FloatArray) -> FloatArray:
    """(B,) logarithm of what each filter's innovation says for it, noise (m, s, s).

    ``printed``: Segal 2011 (11)-(12), innovations against the measurement noise alone, as if the
    prediction were exact. ``innovation``: against their own covariance ``H P H^T + R``, the density
    that (8) asks for, to first order; the two agree where the prediction's covariance vanishes.
    """
    constant = update.joint_dof * _LOG_TWO_PI
    if kind is Likelihood.PRINTED:
        determinant = update.accepted @ np.linalg.slogdet(noise)[1]
        return np.asarray(-0.5 * (constant + determinant + update.noise_squares))
    return np.asarray(-0.5 * (constant + update.log_determinant + update.joint_nis))


def normalised(log_posterior: FloatArray) -> FloatArray:
    """(..., h) probabilities of unnormalised logarithms: never a zero sum, however small."""
    return np.asarray(np.exp(log_posterior - logsumexp(log_posterior, axis=-1, keepdims=True)))


@dataclass(frozen=True)
class Mixture:
    """A mixture of filters as one estimate."""

    states: RelativeStates
    """(R,)"""
    covariance: FloatArray
    """(R, n + k, n + k) of the states' errors and of the k parameters."""
    parameters: FloatArray
    """(R, k) mean."""


def moment_matched(
    states: RelativeStates, covariance: FloatArray, weights: FloatArray, parameters: FloatArray
) -> Mixture:
    """Mean and covariance of mixtures of h filters each, over R runs.

    Args:
        states: (R h,) run after run.
        covariance: (R h, n, n) of their errors.
        weights: (R, h), each row of sum 1.
        parameters: (R, h, k) what each filter holds fixed, such as inertia ratios.

    The mean is the one on the manifold: the state from which the weighted errors to all states
    vanish. Each covariance is carried to it by the inverse of the retraction's Jacobian, and the
    spread of the filters adds (Bar-Shalom, Li and Kirubarajan 2001, section 1.4.16).
    """
    runs, h = weights.shape
    first = np.arange(runs, dtype=np.intp) * h
    mean = picked(states, first + np.argmax(weights, axis=1))
    every: IntArray = np.repeat(np.arange(runs, dtype=np.intp), h)
    errors = picked(mean, every).local(states)
    for _ in range(_MEAN_PASSES):
        shift = np.einsum("rh,rhn->rn", weights, errors.reshape(runs, h, -1))
        mean = mean.retract(shift)
        errors = picked(mean, every).local(states)
        if np.max(np.abs(shift), initial=0.0) < _MEAN_TOLERANCE:
            break
    inverse = np.linalg.inv(picked(mean, every).retraction_block(errors))
    carried, curved = covariance.copy(), mean.curved
    carried[:, curved] = inverse @ carried[:, curved]
    carried[..., curved] = carried[..., curved] @ np.swapaxes(inverse, -1, -2)
    average = np.einsum("rh,rhk->rk", weights, parameters)
    apart = np.concatenate([errors.reshape(runs, h, -1), parameters - average[:, None]], axis=-1)
    n, size = errors.shape[1], apart.shape[2]
    matched = np.einsum("rh,rhi,rhj->rij", weights, apart, apart)
    matched[:, :n, :n] += np.einsum("rh,rhij->rij", weights, carried.reshape(runs, h, n, n))
    assert matched.shape == (runs, size, size)
    return Mixture(mean, np.asarray(matched), np.asarray(average))
