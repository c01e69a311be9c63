"""What estimators without a model of the target were told of its state before the first frame."""

from collections.abc import Callable, Mapping

import numpy as np

from pcnav.config.inertia_bank import inertia_matrix
from pcnav.config.pipeline_file import EstimatorKind, Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import ATTITUDE, POSITION, RATE, RATIOS, VELOCITY, Block, Layout
from pcnav.dynamics.rigid_body import ratios_from_inertia


def stated_prior_sd(estimator: str, pipeline: Pipeline | None, layout: Layout) -> FloatArray:
    """(size,) standard deviations in the layout's order; infinite of what nothing was told of."""
    sd = np.full(layout.size, np.inf)
    told = _TOLD.get(estimator)
    if told is not None:
        for block, value in told(pipeline or Pipeline()).items():
            if block in layout:
                sd[layout.slice_of(block)] = value
    return sd


def _bank(pipeline: Pipeline) -> Mapping[Block, float | FloatArray]:
    table = pipeline.inertia_bank
    ratios = ratios_from_inertia(np.array([inertia_matrix(each) for each in table.hypotheses]))
    return {
        POSITION: table.mass_centre_sd_m,
        VELOCITY: table.velocity_sd_m_s,
        ATTITUDE: np.deg2rad(table.attitude_sd_deg),
        RATE: np.deg2rad(table.rate_sd_deg_s),
        RATIOS: ratios.std(axis=0),
    }


def _attitudes(pipeline: Pipeline) -> Mapping[Block, float | FloatArray]:
    table = pipeline.attitude_inertia
    return {RATE: np.deg2rad(table.rate_sd_deg_s), RATIOS: table.inertia_ratio_sd}


_TOLD: Mapping[str, Callable[[Pipeline], Mapping[Block, float | FloatArray]]] = {
    EstimatorKind.INERTIA_BANK: _bank,
    EstimatorKind.ATTITUDE_INERTIA: _attitudes,
}
