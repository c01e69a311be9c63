"""The scenario of a run: the case's pipeline with its axes applied, and a truth drawn by the seed.

Drawn are the initial attitude, the spin axis, the place in the image, the direction of the relative
velocity and, from the prior that the target states, mass centre and inertia ratios. Distance and
tumble rate are the case's; where it has none, those of the pipeline.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np

from pcnav.batch.axes import RANGE_AXIS, TUMBLE_AXIS, GridRun
from pcnav.batch.grid import GridBasis
from pcnav.config.pipeline_file import Pipeline
from pcnav.config.table import Vector3
from pcnav.simulation.random_truth import Satellite, Spread, random_truth
from pcnav.target.satellite import Target, load_target


@lru_cache(maxsize=8)
def loaded_target(mesh: Path) -> Target:
    """A target, read once in a process. Raises `InputError`."""
    return load_target(mesh)


def run_pipeline(basis: GridBasis, run: GridRun) -> tuple[Pipeline, Target]:
    """Everything that fixes the frames of a run, and the target they show. Raises `InputError`.

    `pcnav simulate` of this pipeline writes the same frames.
    """
    pipeline = basis.pipeline_of(run.case)
    target = loaded_target(basis.mesh_of(run.case))
    axes = dict(run.case.settings)
    orbit, body = pipeline.orbit, pipeline.body
    range_m = float(axes.get(RANGE_AXIS, _length(orbit.r_hill_m)))
    tumble_deg_s = float(axes.get(TUMBLE_AXIS, _length(body.omega_body_deg_s)))
    frame_rate_hz = pipeline.scenario.frame_rate_hz
    truth = random_truth(
        Satellite(target, pipeline),
        Spread((range_m, range_m), (tumble_deg_s, tumble_deg_s), _length(orbit.v_hill_m_s)),
        run.seed,
        frames=basis.frames_at(frame_rate_hz),
        frame_rate_hz=frame_rate_hz,
    )
    return truth, target


def _length(vector: Vector3) -> float:
    return float(np.linalg.norm(vector))
