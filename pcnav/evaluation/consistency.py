"""Whether covariances tell the size of the errors and of the innovations: NEES and NIS."""

import math
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.statistics import chi_square_bounds
from pcnav.dynamics.blocks import RATIOS
from pcnav.dynamics.inertia_parameters import parameters_from_ratios, ratios_jacobian
from pcnav.estimators.registry import ESTIMATORS
from pcnav.evaluation.errors import Errors
from pcnav.runs.run import Run

_FRAMES_AT_ONCE = 512


@dataclass(frozen=True)
class Consistency:
    """Squared normalised errors against the chi-square distribution they should have."""

    name: str
    frames: int
    degrees: int
    """Degrees of freedom, summed over the frames."""
    mean_per_degree: float
    """Their sum over `degrees`: 1 when the covariance is right, more when it is too small."""
    lower: float
    upper: float
    """95 % bounds of `mean_per_degree`: of innovations as of independent frames, of errors, which
    are correlated from frame to frame, as of a single one."""
    share_inside: float
    """Share of frames within their own two-sided 95 % bounds."""
    unusable_frames: int
    """Frames left out because their covariance is not positive definite."""

    def to_json(self) -> dict[str, object]:
        """As in metrics.json; null where a number does not exist."""
        return {
            "frames": self.frames,
            "degrees_of_freedom": self.degrees,
            "mean_per_degree_of_freedom": finite_or_none(self.mean_per_degree),
            "bounds_95_of_mean": [finite_or_none(self.lower), finite_or_none(self.upper)],
            "share_of_frames_inside_own_95": finite_or_none(self.share_inside),
            "unusable_frames": self.unusable_frames,
        }


def nis_consistency(run: Run) -> Consistency:
    """Normalised innovations squared of a run against their degrees of freedom."""
    used = np.isfinite(run.nis) & (run.nis_dof > 0)
    return consistency("nis", run.nis[used], run.nis_dof[used], independent=True)


def nees_consistency(run: Run, compared: Errors) -> tuple[Consistency, ...]:
    """NEES of every block of the error state and of all of it: see `squared_errors`."""
    frames = compared.has(*run.trajectory.layout.blocks)
    return tuple(
        consistency(name, squared[frames], np.full(np.count_nonzero(frames), degrees))
        for name, (squared, degrees) in squared_errors(run, compared).items()
    )


def squared_errors(run: Run, compared: Errors) -> dict[str, tuple[FloatArray, int]]:
    """Squared normalised errors (n,) and their degrees of freedom by block, all of them last.

    Of what the estimator does not hold fixed: a component without any variance is no estimate. nan
    in frames without a truth. Empty without covariances or full truth.
    """
    layout, P = run.trajectory.layout, run.trajectory.covariance
    frames = compared.has(*layout.blocks)
    if P is None or not layout.blocks or not frames.any():
        return {}
    state = np.hstack([compared[block] for block in layout.blocks])
    entry = ESTIMATORS.get(run.estimator)
    if entry is not None and entry.judged_over_trace:
        state, P = over_trace(state, P, run.trajectory[RATIOS], layout.slice_of(RATIOS))
    free = ~(np.diagonal(P, axis1=1, axis2=2)[frames] == 0.0).any(axis=0)
    parts = {block.name: layout.slice_of(block) for block in layout.blocks}
    if len(parts) > 1:
        parts["all"] = slice(0, layout.size)
    found = {}
    for name, part in parts.items():
        chosen: IntArray = np.flatnonzero(free[part]) + part.start
        if not chosen.size:
            continue
        # A view where all is free: the covariances of a long run are not held twice.
        whole = chosen.size == part.stop - part.start
        block = P[:, part, part] if whole else P[:, chosen[:, None], chosen]
        squared = squared_normalised_errors(state[:, chosen], block)
        found[name] = np.where(frames, squared, np.nan), int(chosen.size)
    return found


def over_trace(
    state: FloatArray, covariance: FloatArray, ratios: FloatArray, part: slice
) -> tuple[FloatArray, FloatArray]:
    """Errors (n, k) and covariances (n, k, k) with those of ratios (n, 5) turned into those of the
    inertia's entries over its trace."""
    state, covariance = state.copy(), covariance.copy()
    for k in np.flatnonzero(np.isfinite(state).all(axis=1)):
        parameters = parameters_from_ratios(ratios[k])
        state[k, part] = parameters_from_ratios(ratios[k] + state[k, part]) - parameters
        change = np.eye(state.shape[1])
        change[part, part] = np.linalg.inv(ratios_jacobian(parameters))
        covariance[k] = change @ covariance[k] @ change.T
    return state, covariance


def squared_normalised_errors(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """(n,) ``e^T P^-1 e`` of errors (n, k) and covariances (n, k, k).

    nan where the covariance is not positive definite to working accuracy.
    """
    # In blocks, so that a long run needs no second copy of its covariances.
    blocks = range(0, max(len(error), 1), _FRAMES_AT_ONCE)
    return np.concatenate(
        [
            _squared(error[k : k + _FRAMES_AT_ONCE], covariance[k : k + _FRAMES_AT_ONCE])
            for k in blocks
        ]
    )


def _squared(error: FloatArray, covariance: FloatArray) -> FloatArray:
    variance = np.diagonal(covariance, axis1=1, axis2=2)
    usable = np.isfinite(covariance).all(axis=(1, 2)) & (variance > 0.0).all(axis=1)
    squared = np.full(len(error), np.nan)
    # Metres, radians per second and ratios differ by many powers of ten: the correlation matrix
    # is what can be judged for definiteness and inverted without loss.
    sd = np.sqrt(variance[usable])
    correlation = covariance[usable] / (sd[:, :, None] * sd[:, None, :])
    eigenvalues, axes = np.linalg.eigh(correlation)
    definite = eigenvalues[:, 0] > error.shape[1] * np.finfo(np.float64).eps
    along_axes = np.einsum("nki,nk->ni", axes, error[usable] / sd)
    with np.errstate(divide="ignore", invalid="ignore"):
        sums = np.sum(along_axes**2 / eigenvalues, axis=1)
    squared[usable] = np.where(definite, sums, np.nan)
    return squared


def consistency(
    name: str, squared: FloatArray, degrees: IntArray, *, independent: bool = False
) -> Consistency:
    """Judge squared normalised errors (n,) of so many degrees of freedom each.

    Innovations are ``independent`` from frame to frame, so that their mean lies near 1. Errors of a
    filter are correlated: at worst all frames of a run are one draw, and so wide are their bounds.
    """
    usable: BoolArray = np.isfinite(squared)
    values, own_degrees = squared[usable], degrees[usable]
    total = int(own_degrees.sum())
    unusable = int((~usable).sum())
    if not total:
        return Consistency(name, 0, 0, math.nan, math.nan, math.nan, math.nan, unusable)
    lower, upper = chi_square_bounds(own_degrees)
    drawn = total if independent else total / len(values)
    mean_lower, mean_upper = chi_square_bounds(drawn)
    return Consistency(
        name=name,
        frames=len(values),
        degrees=total,
        mean_per_degree=float(values.sum() / total),
        lower=float(mean_lower) / drawn,
        upper=float(mean_upper) / drawn,
        share_inside=float(np.mean((values >= lower) & (values <= upper))),
        unusable_frames=unusable,
    )


def finite_or_none(value: float) -> float | None:
    """A number JSON can hold."""
    return value if math.isfinite(value) else None
