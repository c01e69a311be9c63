"""How good a run is: errors against the truth, and whether its covariances tell it so.

Every number keeps its unit. Statistics of a norm are taken over the frames that have both an
estimate and a truth.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.statistics import chi_square_bounds as chi_square_bounds
from pcnav.dynamics.blocks import (
    ATTITUDE,
    CENTRE,
    MASS_CENTRE_LAYOUT,
    POSITION,
    RATE,
    RATIOS,
    VELOCITY,
    Block,
)
from pcnav.dynamics.inertia_parameters import parameters_from_ratios, ratios_jacobian
from pcnav.dynamics.trajectory import Trajectory
from pcnav.estimators.registry import ESTIMATORS
from pcnav.evaluation.errors import Errors, errors
from pcnav.runs.run import Run

PERCENTILES = (50, 70, 90, 95, 99)
BLOCKS = {block.name: MASS_CENTRE_LAYOUT.slice_of(block) for block in MASS_CENTRE_LAYOUT.blocks}
BLOCKS |= {"all": slice(0, MASS_CENTRE_LAYOUT.size)}
"""Blocks of the error state of a target with a model, whose NEES is told apart."""

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
    are correlated from frame to frame, as of a single one."""
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
    errors: Errors | None = None
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


@dataclass(frozen=True)
class Quantity:
    """What errors are told of: the one list that reports, tables and metrics.json share."""

    key: str
    title: str
    unit: str
    """In which people read it."""
    of: Callable[[Errors], FloatArray | None]
    """(n, k) errors in that unit; None of a run that does not estimate it."""


def _pose_attitude(compared: Errors) -> FloatArray | None:
    """That of the pose; of a truth without camera poses, or a run without, that of the body."""
    theta = compared.theta_model_rad
    if ATTITUDE.name in compared.state:
        theta = np.where(compared.has_pose[:, None], theta, compared[ATTITUDE])
    if compared.defines_axes is not None:
        # Where the axes are defined there is no error by construction: it would flatter the run.
        theta = np.where(compared.defines_axes[:, None], np.nan, theta)
    return np.rad2deg(theta)


def _points(compared: Errors) -> FloatArray | None:
    rms = compared.points_rms_m
    return None if rms is None else rms[:, None]


def _of_block(block: Block) -> Quantity:
    def of(compared: Errors) -> FloatArray | None:
        found = compared.state.get(block.name)
        return None if found is None else block.to_shown * found

    return Quantity(block.quantity, block.title, block.shown_unit, of)


QUANTITIES = (
    Quantity("position_cam", "model origin in cam", "m", lambda compared: compared.p_cam_m),
    Quantity("attitude", "attitude", "deg", _pose_attitude),
    *(_of_block(block) for block in (POSITION, VELOCITY, RATE, CENTRE, RATIOS)),
    Quantity("features", "features, RMS of a frame", "m", _points),
)


def evaluate(
    run: Run,
    truth: Trajectory | None,
    *,
    symmetry_transforms: FloatArray | None = None,
    true_points: Mapping[int, FloatArray] | None = None,
) -> Metrics:
    """Numbers of a run; without a truth only what the run says of itself.

    For the arguments see `errors`. The NEES needs a run read with its covariances. Raises
    `InputError` when the truth shares no time with it.
    """
    of_run = run_metrics(run)
    if truth is None:
        return of_run
    found = errors(run, truth, symmetry_transforms=symmetry_transforms, true_points=true_points)
    compared = found.has_pose
    if run.trajectory.layout.blocks:
        compared = compared | found.has(*run.trajectory.layout.blocks)
    return replace(
        of_run,
        frames_compared=int(compared.sum()),
        symmetry=found.symmetry,
        quantities=quantity_errors(run.time_s, found),
        nees=nees_consistency(run, found),
        errors=found,
    )


def run_metrics(run: Run) -> Metrics:
    """What a run says of itself, without a truth."""
    time_s, n = run.time_s, len(run)
    known = np.flatnonzero(run.has_estimate)
    return Metrics(
        frames=n,
        frames_with_estimate=len(known),
        duration_s=float(np.ptp(time_s)) if n else 0.0,
        first_estimate_after_s=float(time_s[known[0]] - time_s[0]) if known.size else math.nan,
        status_share={status: count / n for status, count in Counter(run.status).most_common()},
        nis=nis_consistency(run),
        frames_compared=0,
        symmetry=0,
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
    layout, covariance = run.trajectory.layout, run.trajectory.covariance
    frames = np.flatnonzero(compared.has(*layout.blocks))
    if covariance is None or not layout.blocks or not frames.size:
        return {}
    state = np.hstack([compared[block] for block in layout.blocks])[frames]
    entry = ESTIMATORS.get(run.estimator)
    P = covariance[frames]
    if entry is not None and entry.judged_over_trace:
        ratios = run.trajectory[RATIOS][frames]
        state, P = _over_trace(state, P, ratios, layout.slice_of(RATIOS))
    free = ~(np.diagonal(P, axis1=1, axis2=2) == 0.0).any(axis=0)
    parts = {block.name: layout.slice_of(block) for block in layout.blocks}
    if len(parts) > 1:
        parts["all"] = slice(0, layout.size)
    found = {}
    for name, part in parts.items():
        chosen = np.arange(layout.size)[part][free[part]]
        if chosen.size:
            squared = np.full(len(run), np.nan)
            squared[frames] = squared_normalised_errors(
                state[:, chosen], P[:, chosen[:, None], chosen]
            )
            found[name] = squared, chosen.size
    return found


def _over_trace(
    state: FloatArray, covariance: FloatArray, ratios: FloatArray, part: slice
) -> tuple[FloatArray, FloatArray]:
    """Errors (n, k) and covariances (n, k, k) with those of ratios (n, 5) turned into those of the
    inertia's entries over its trace."""
    state, covariance = state.copy(), covariance.copy()
    for k, own in enumerate(ratios):
        parameters = parameters_from_ratios(own)
        state[k, part] = parameters_from_ratios(own + state[k, part]) - parameters
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


def quantity_errors(time_s: FloatArray, compared: Errors) -> tuple[QuantityErrors, ...]:
    """Statistics by quantity; one without any error is left out."""
    elapsed = (time_s - time_s[0]) / max(float(np.ptp(time_s)), np.finfo(np.float64).tiny)
    found = []
    for quantity in QUANTITIES:
        vectors = quantity.of(compared)
        norms = np.zeros(0) if vectors is None else np.asarray(np.linalg.norm(vectors, axis=1))
        if np.isfinite(norms).any():
            title = quantity.title
            if quantity.key == "attitude" and compared.defines_axes is not None:
                title = "attitude since the first frame"
            parts = (distribution(norms[elapsed >= start]) for start in (0.0, 1 / 2, 2 / 3))
            found.append(QuantityErrors(quantity.key, title, quantity.unit, *parts))
    return tuple(found)


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
