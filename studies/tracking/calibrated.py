"""Calibration: cameras, ranges and meshes that are not quite what a recording says of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.sensors import MiscalibrationTable
from pcnav.core import chi_square
from pcnav.core.arrays import FloatArray
from pcnav.core.statistics import mean, percentile
from pcnav.files.text_table import TextTable
from pcnav.simulation.depth import Scene
from pcnav.simulation.miscalibration import Miscalibration

from ..following import JudgedRun, follow
from ..tables import Claim, table_of
from .tumbles import boxsat, tumble

NAME = "calibration"
FRAMES = 40
NEES = (0.8, 1.3)
HELD, ELLIPSOID = 0.99, 0.999
"""Bars: NEES of the pose over its degrees of freedom where the deviations are stated; share of the
frames inside the ellipsoid of so much where nothing is."""
ERRORS = {
    "focal_sd": 0.002,
    "centre_sd_px": 0.5,
    "range_offset_sd_m": 0.005,
    "range_scale_sd": 0.002,
}
"""Of a camera that is said to be calibrated."""
JITTER_S = 0.005
"""Of its time stamps."""
CASES = {"stated": (True,), "not stated": (False,)}


@dataclass(frozen=True)
class CalibrationRun:
    """A run on frames of a camera that errs."""

    is_stated: bool
    seed: int
    run: JudgedRun

    @property
    def nees(self) -> FloatArray:
        """(k,) of the pose, over its degrees of freedom, in the claimed frames."""
        return self.run.pose_nees[self.run.claims] / 6.0

    @property
    def held(self) -> FloatArray:
        """(k,) 1 where the truth is inside the ellipsoid."""
        return np.asarray(6.0 * self.nees < chi_square.quantile(ELLIPSOID, 6), np.float64)


def run_calibration(is_stated: bool, seed: int, frames: int = FRAMES) -> CalibrationRun:
    """One track of boxsat: motion, noise and errors are the seed's.

    Where the deviations are stated, the errors are drawn from them; where nothing is, they are as
    large as `ERRORS`, and the seed says to which side.
    """
    return CalibrationRun(is_stated, seed, _followed(_erring(is_stated, seed, frames)))


def _erring(is_stated: bool, seed: int, frames: int) -> Pipeline:
    truth = tumble(seed, frames)
    table = MiscalibrationTable.model_validate({**ERRORS, "is_stated": is_stated})
    if not is_stated:
        table = table.model_copy(update=_of_that_size(truth))
    noise = truth.noise.model_copy(update={"stamp_jitter_s": JITTER_S})
    return truth.model_copy(update={"miscalibration": table, "noise": noise})


def _of_that_size(truth: Pipeline) -> dict[str, float]:
    """Deviations under which the seed draws errors of just the sizes of `ERRORS`."""
    unit = MiscalibrationTable.model_validate(dict.fromkeys(ERRORS, 1.0))
    drawn = Miscalibration.of(truth.model_copy(update={"miscalibration": unit}))
    sizes = {
        "focal_sd": abs(drawn.focal),
        "centre_sd_px": float(np.linalg.norm(drawn.centre_px)),
        "range_offset_sd_m": abs(drawn.range_offset_m),
        "range_scale_sd": abs(drawn.range_scale),
    }
    return {name: ERRORS[name] / size for name, size in sizes.items()}


def _followed(pipeline: Pipeline) -> JudgedRun:
    target = boxsat().target
    return follow(Scene.of(pipeline, target.mesh), target)


def claims(found: Mapping[str, Sequence[CalibrationRun]]) -> list[Claim]:
    """One of each case."""
    return [_claim(own) for own in found.values()]


def _claim(own: Sequence[CalibrationRun]) -> Claim:
    if own[0].is_stated:
        nees = _nees(own)
        expected = f"{NEES[0]:g} to {NEES[1]:g}"
        met = NEES[0] <= nees <= NEES[1]
        return Claim(NAME, "stated: NEES of the pose over dof", expected, nees, bool(met))
    held = mean(np.concatenate([each.held for each in own]))
    quantity = f"not stated: frames inside the {ELLIPSOID:.1%} ellipsoid"
    return Claim(NAME, quantity, f">= {HELD:g}", held, bool(held >= HELD))


def tables(found: Mapping[str, Sequence[CalibrationRun]]) -> list[TextTable]:
    """Both cases."""
    return [
        table_of(
            "calibration",
            found.items(),
            {
                "deviations": lambda each: each[0],
                "runs": lambda each: len(each[1]),
                "claimed": lambda each: mean(np.concatenate([r.run.claims for r in each[1]])),
                "NEES of the pose": lambda each: _nees(each[1]),
                "median of the runs": lambda each: percentile(_by_run(each[1]), 50),
                "largest": lambda each: _by_run(each[1]).max(),
                f"inside {ELLIPSOID:.1%}": lambda each: mean(
                    np.concatenate([r.held for r in each[1]])
                ),
                "position, mm": lambda each: _median_error(each[1]),
            },
        )
    ]


def _by_run(own: Sequence[CalibrationRun]) -> FloatArray:
    """(n,) means over the frames of each run: one draw of the errors."""
    return np.array([mean(each.nees) for each in own])


def _nees(own: Sequence[CalibrationRun]) -> float:
    return mean(_by_run(own))


def _median_error(own: Sequence[CalibrationRun]) -> float:
    return percentile(
        np.concatenate([1e3 * each.run.position_m[each.run.claims] for each in own]), 50
    )
