"""How good a run is: errors against the truth, and whether its covariances tell it so.

Every number keeps its unit. Statistics of a norm are taken over the frames that have both an
estimate and a truth.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import (
    ATTITUDE,
    CENTRE,
    POSITION,
    RATE,
    RATIOS,
    VELOCITY,
    Block,
)
from pcnav.dynamics.trajectory import Trajectory
from pcnav.evaluation.consistency import (
    Consistency,
    finite_or_none,
    nees_consistency,
    nis_consistency,
)
from pcnav.evaluation.errors import Errors, errors
from pcnav.runs.run import Run
from pcnav.target.roundness import Roundness

PERCENTILES = (50, 70, 90, 95, 99)
UNIT_SUFFIX = {"m": "_m", "m/s": "_m_s", "deg": "_deg", "deg/s": "_deg_s", "1": ""}
_PARTS = {"whole": 0.0, "second_half": 1 / 2, "last_third": 2 / 3}
"""Of a run, and the share of its duration at which they begin."""


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

    def to_json(self) -> dict[str, object]:
        """As in metrics.json; null where a number does not exist."""
        return {
            "frames": self.frames,
            "rms": finite_or_none(self.rms),
            **{f"p{percent}": finite_or_none(self.at(percent)) for percent in PERCENTILES},
            "max": finite_or_none(self.maximum),
        }


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

    def to_json(self) -> dict[str, object]:
        """As in metrics.json."""
        parts = {name: getattr(self, name).to_json() for name in _PARTS}
        return {"unit": self.unit, "title": self.title, **parts}


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
            "first_estimate_after_s": finite_or_none(self.first_estimate_after_s),
            "status_share": dict(self.status_share),
            "nis": self.nis.to_json(),
            "frames_compared": self.frames_compared,
            "symmetry": self.symmetry,
            "errors": {
                each.key + UNIT_SUFFIX[each.unit]: each.to_json() for each in self.quantities
            },
            "nees": {block.name: block.to_json() for block in self.nees},
        }


@dataclass(frozen=True)
class Quantity:
    """What errors are told of: the one list that reports, tables and metrics.json share."""

    key: str
    """In metrics.json."""
    title: str
    unit: str
    """In which people read it."""
    of: Callable[[Errors], FloatArray | None]
    """(n, k) errors in that unit; None of a run that does not estimate it."""
    name: str = ""
    """In the tables of a batch, where its metrics are called ``name_rms_unit`` and the like; empty
    of one that they do not have, because it needs the files of a run."""
    short: str = ""
    """Its title there."""
    of_pose: bool = False
    """Whether it depends on which of a symmetric target's equivalent poses is the true one."""


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


def _of_block(block: Block, name: str, short: str) -> Quantity:
    def of(compared: Errors) -> FloatArray | None:
        found = compared.state.get(block.name)
        return None if found is None else block.to_shown * found

    return Quantity(block.quantity, block.title, block.shown_unit, of, name, short)


QUANTITIES = (
    Quantity(
        *("position_cam", "model origin in cam", "m", lambda compared: compared.p_cam_m),
        *("position", "position", True),
    ),
    Quantity("attitude", "attitude", "deg", _pose_attitude, "attitude", "attitude", True),
    _of_block(POSITION, "r_hill", "mass centre in hill"),
    _of_block(VELOCITY, "velocity", "velocity"),
    _of_block(RATE, "rate", "rate"),
    _of_block(CENTRE, "com", "mass centre"),
    _of_block(RATIOS, "inertia_ratio", "inertia ratios"),
    Quantity("features", "features, RMS of a frame", "m", _points),
)


def evaluate(
    run: Run,
    truth: Trajectory | None,
    *,
    symmetry_transforms: FloatArray | None = None,
    roundness: Roundness | None = None,
    true_points: Mapping[int, FloatArray] | None = None,
) -> Metrics:
    """Numbers of a run; without a truth only what the run says of itself.

    For the arguments see `errors`. The NEES needs a run read with its covariances. Raises
    `InputError` when the truth shares no time with it.
    """
    of_run = run_metrics(run)
    if truth is None:
        return of_run
    found = errors(
        run,
        truth,
        symmetry_transforms=symmetry_transforms,
        roundness=roundness,
        true_points=true_points,
    )
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


def quantity_errors(time_s: FloatArray, compared: Errors) -> tuple[QuantityErrors, ...]:
    """Statistics by quantity; one without any error is left out."""
    elapsed = (time_s - time_s[0]) / max(float(np.ptp(time_s)), np.finfo(np.float64).tiny)
    found = []
    for quantity, norms in error_norms(compared):
        title = quantity.title
        if quantity.key == "attitude" and compared.defines_axes is not None:
            title = "attitude since the first frame"
        parts = (distribution(norms[elapsed >= start]) for start in _PARTS.values())
        found.append(QuantityErrors(quantity.key, title, quantity.unit, *parts))
    return tuple(found)


def error_norms(compared: Errors) -> Iterator[tuple[Quantity, FloatArray]]:
    """Norms (n,) of the errors of every quantity; one without any error is left out."""
    for quantity in QUANTITIES:
        vectors = quantity.of(compared)
        norms = np.zeros(0) if vectors is None else np.asarray(np.linalg.norm(vectors, axis=1))
        if np.isfinite(norms).any():
            yield quantity, norms
