"""How good a run is: errors against the truth, and whether its covariances tell it so.

Every number keeps its unit. Statistics of a norm are taken over the frames that have both an
estimate and a truth.
"""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from pcnav.core import chi_square
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.dynamics.state import COM_MODEL, INERTIA_RATIOS, OMEGA_BODY, R_HILL, THETA_BODY, V_HILL
from pcnav.evaluation.track_errors import (
    TrackErrors,
    Truth,
    best_symmetry,
    relabelled,
    track_errors,
)
from pcnav.runs.results import Track

PERCENTILES = (50, 70, 90, 95, 99)
BLOCKS = {
    "r_hill": R_HILL,
    "v_hill": V_HILL,
    "com_model": COM_MODEL,
    "theta_body": THETA_BODY,
    "omega_body": OMEGA_BODY,
    "inertia_ratios": INERTIA_RATIOS,
    "all": slice(0, 20),
}
"""Blocks of the error state whose NEES is told apart."""

_CONFIDENCE = 0.95
_FRAMES_AT_ONCE = 512


@dataclass(frozen=True)
class Distribution:
    """Statistics of an error norm over frames; all nan when there are no frames."""

    frames: int
    rms: float
    percentiles: tuple[float, ...]
    """At `PERCENTILES`."""
    maximum: float

    @property
    def median(self) -> float:
        """The 50 % point."""
        return self.at(50)

    def at(self, percent: int) -> float:
        """The error that this percentage of the frames does not exceed; one of `PERCENTILES`."""
        return self.percentiles[PERCENTILES.index(percent)]


@dataclass(frozen=True)
class QuantityErrors:
    """Errors of one estimated quantity in one unit."""

    key: str
    """Identifier in metrics.json, without the unit."""
    title: str
    """What it is, in words."""
    unit: str
    """m, m/s, deg, deg/s, or 1 for a ratio."""
    whole: Distribution
    second_half: Distribution
    last_third: Distribution
    """Parts of the run's duration."""


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
    hang together, as of a single one."""
    share_inside: float
    """Share of frames within their own two-sided 95 % bounds."""
    unusable_frames: int
    """Frames left out because their covariance is not positive definite."""


@dataclass(frozen=True)
class Metrics:
    """All that a run's report says in numbers; the truth's part is empty without a truth."""

    frames: int
    frames_with_estimate: int
    duration_s: float
    first_estimate_after_s: float
    """From the first frame; nan without any estimate."""
    status_share: dict[str, float]
    """Share of frames per status, most frequent first."""
    nis: Consistency
    frames_compared: int
    """Frames with an estimate and a truth."""
    symmetry: int
    """Which of the target's symmetries the truth was compared under; 0 is the identity."""
    quantities: tuple[QuantityErrors, ...] = ()
    nees: tuple[Consistency, ...] = ()
    errors: TrackErrors | None = None
    """The errors behind the numbers, for figures; not part of metrics.json."""

    def to_json(self) -> dict[str, object]:
        """The content of metrics.json: units in the keys, null where a number does not exist."""
        return {
            "frames": self.frames,
            "frames_with_estimate": self.frames_with_estimate,
            "duration_s": self.duration_s,
            "first_estimate_after_s": _number(self.first_estimate_after_s),
            "status_share": dict(self.status_share),
            "nis": _consistency_json(self.nis),
            "frames_compared": self.frames_compared,
            "symmetry": self.symmetry,
            "errors": {_json_key(each): _quantity_json(each) for each in self.quantities},
            "nees": {block.name: _consistency_json(block) for block in self.nees},
        }


def evaluate(
    track: Track,
    truth: Truth | None,
    symmetry_transforms: FloatArray | None = None,
    tolerance_s: float = 1e-6,
) -> Metrics:
    """Numbers of a run; without a truth only what the run says of itself.

    ``symmetry_transforms`` (n, 4, 4) are motions of the model frame that leave the target
    unchanged: errors are then taken to the equivalent truth nearest to the run. The NEES needs a
    track read with its covariances. Raises `InputError` when the truth shares no time with it.
    """
    symmetry, errors = 0, None
    if truth is not None:
        if symmetry_transforms is not None:
            symmetry = best_symmetry(track, truth, symmetry_transforms, tolerance_s)
            truth = relabelled(truth, symmetry_transforms[symmetry])
        errors = track_errors(track, truth, tolerance_s)
    of_run = run_metrics(track, track.has_estimate, nis_consistency(track))
    if errors is None:
        return of_run
    return replace(
        of_run,
        frames_compared=int((errors.has_pose | errors.has_state).sum()),
        symmetry=symmetry,
        quantities=_quantities(track.time_s, errors),
        nees=nees_consistency(errors, track.covariance),
        errors=errors,
    )


class _Run(Protocol):
    @property
    def time_s(self) -> FloatArray: ...
    @property
    def status(self) -> tuple[str, ...]: ...


def run_metrics(run: _Run, has_estimate: BoolArray, nis: Consistency) -> Metrics:
    """What a run of any kind says of itself, without a truth."""
    time_s, n = run.time_s, len(run.status)
    known = np.flatnonzero(has_estimate)
    return Metrics(
        frames=n,
        frames_with_estimate=len(known),
        duration_s=float(np.ptp(time_s)) if n else 0.0,
        first_estimate_after_s=float(time_s[known[0]] - time_s[0]) if known.size else math.nan,
        status_share={status: count / n for status, count in Counter(run.status).most_common()},
        nis=nis,
        frames_compared=0,
        symmetry=0,
        quantities=(),
        nees=(),
    )


def distribution(norms: FloatArray) -> Distribution:
    """Statistics of error norms (n,), those that are nan left out."""
    known = norms[np.isfinite(norms)]
    if not known.size:
        return Distribution(0, math.nan, (math.nan,) * len(PERCENTILES), math.nan)
    return Distribution(
        frames=len(known),
        rms=float(np.sqrt(np.mean(known**2))),
        percentiles=tuple(np.percentile(known, PERCENTILES).tolist()),
        maximum=float(known.max()),
    )


def nis_consistency(track: Track) -> Consistency:
    """Normalised innovations squared of a track against their degrees of freedom."""
    used = np.isfinite(track.nis) & (track.nis_dof > 0)
    return consistency("nis", track.nis[used], track.nis_dof[used], independent=True)


def nees_consistency(errors: TrackErrors, covariance: FloatArray | None) -> tuple[Consistency, ...]:
    """NEES of every block of the error state; empty without covariances or full truth."""
    frames = errors.has_state
    if covariance is None or not frames.any():
        return ()
    results = []
    for name, block in BLOCKS.items():
        values = squared_normalised_errors(errors.state[:, block], covariance[:, block, block])
        values = values[frames]
        size = np.full(len(values), block.stop - block.start)
        results.append(consistency(name, values, size))
    return tuple(results)


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


def chi_square_bounds(degrees: IntArray | FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """Two-sided 95 % bounds of a chi-square variable, element by element."""
    tail = 0.5 * (1.0 - _CONFIDENCE)
    return chi_square.quantile(tail, degrees), chi_square.quantile(1.0 - tail, degrees)


def consistency(
    name: str, squared: FloatArray, degrees: IntArray, *, independent: bool = False
) -> Consistency:
    """Judge squared normalised errors (n,) of so many degrees of freedom each.

    Innovations are ``independent`` from frame to frame, so that their mean lies near 1. Errors of a
    filter hang together: at worst all frames of a run are one draw, and so wide are their bounds.
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


def quantity_errors(
    time_s: FloatArray, series: Iterable[tuple[str, str, str, FloatArray]]
) -> tuple[QuantityErrors, ...]:
    """Statistics of error vectors (n, k), each with key, title and unit, at times (n,).

    A quantity without any error is left out.
    """
    elapsed = (time_s - time_s[0]) / max(float(np.ptp(time_s)), np.finfo(np.float64).tiny)
    quantities = []
    for key, title, unit, vectors in series:
        norms = np.asarray(np.linalg.norm(vectors, axis=1))
        if np.isfinite(norms).any():
            parts = (distribution(norms[elapsed >= start]) for start in (0.0, 1 / 2, 2 / 3))
            quantities.append(QuantityErrors(key, title, unit, *parts))
    return tuple(quantities)


def _quantities(time_s: FloatArray, errors: TrackErrors) -> tuple[QuantityErrors, ...]:
    """Statistics by quantity; those the truth does not know are left out."""
    # A truth without camera poses still knows the attitude.
    theta = np.where(errors.has_pose[:, None], errors.theta_model_rad, errors.state[:, THETA_BODY])
    series = (
        ("position_cam", "model origin in cam", "m", errors.p_cam_m),
        ("attitude", "attitude", "deg", np.rad2deg(theta)),
        ("r_hill", "mass centre in hill", "m", errors.state[:, R_HILL]),
        ("v_hill", "velocity in hill", "m/s", errors.state[:, V_HILL]),
        ("omega_body", "angular rate", "deg/s", np.rad2deg(errors.state[:, OMEGA_BODY])),
        ("com_model", "mass centre in model", "m", errors.state[:, COM_MODEL]),
        ("inertia_ratios", "inertia ratios", "1", errors.state[:, INERTIA_RATIOS]),
    )
    return quantity_errors(time_s, series)


_UNIT_SUFFIX = {"m": "_m", "m/s": "_m_s", "deg": "_deg", "deg/s": "_deg_s", "1": ""}


def _json_key(quantity: QuantityErrors) -> str:
    return quantity.key + _UNIT_SUFFIX[quantity.unit]


def _quantity_json(quantity: QuantityErrors) -> dict[str, object]:
    return {
        "unit": quantity.unit,
        "title": quantity.title,
        "whole": _distribution_json(quantity.whole),
        "second_half": _distribution_json(quantity.second_half),
        "last_third": _distribution_json(quantity.last_third),
    }


def _distribution_json(values: Distribution) -> dict[str, object]:
    percentiles = zip(PERCENTILES, values.percentiles, strict=True)
    return {
        "frames": values.frames,
        "rms": _number(values.rms),
        **{f"p{percent}": _number(value) for percent, value in percentiles},
        "max": _number(values.maximum),
    }


def _consistency_json(values: Consistency) -> dict[str, object]:
    return {
        "frames": values.frames,
        "degrees_of_freedom": values.degrees,
        "mean_per_degree_of_freedom": _number(values.mean_per_degree),
        "bounds_95_of_mean": [_number(values.lower), _number(values.upper)],
        "share_of_frames_inside_own_95": _number(values.share_inside),
        "unusable_frames": values.unusable_frames,
    }


def _number(value: float) -> float | None:
    """A number JSON can hold."""
    return value if math.isfinite(value) else None
