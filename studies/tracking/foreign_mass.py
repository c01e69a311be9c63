"""Foreign masses: NEES by block where the inertia is any body's, not that of the target's plans."""

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.table import Vector5
from pcnav.core.arrays import FloatArray
from pcnav.core.statistics import mean_squared
from pcnav.dynamics.inertia_parameters import parameters_of, ratios_from_parameters
from pcnav.files.text_table import TextTable
from pcnav.simulation.depth import Scene
from pcnav.simulation.random_truth import Satellite, Spread, random_truth, satellite

from ..blocks import JUDGED
from ..following import JudgedRun, follow
from ..tables import Claim, inside, table
from .shapes import SHAPES, shape
from .tumbles import FRAME_RATE_HZ

NAME = "foreign masses"
_SATELLITES = ("boxsat", "twinwing", "cubesat6u")
_SHAPES = ("hexagonal bus", "octagonal bus", "dish", "docked capsule", "helix antenna")
CASES = {name: (name,) for name in (*_SATELLITES, *_SHAPES)}
QUICK_CASES = {"boxsat": ("boxsat",)}
"""One of them, for a look at the machinery."""
_NEAREST, _FARTHEST, _SPEED, _RATES_DEG_S = 1.5, 3.0, 0.002, (1.0, 5.0)
"""Distances and speed in diameters."""
_MIN_SHARE = 0.02
"""Of the thinnest axis in the second moments: no satellite is a sheet."""
_TIMES = {"at a quarter": 0.25, "at half": 0.5, "at the end": 1.0}


def foreign_truth(of: Satellite, seed: int, frames: int) -> Pipeline:
    """A random truth whose principal axes point anywhere in the body, whose shares of them in the
    second moments are uniform, and whose mass centre is anywhere that the shape's prior has it."""
    diameter = of.target.diameter_m
    spread = Spread((_NEAREST * diameter, _FARTHEST * diameter), _RATES_DEG_S, _SPEED * diameter)
    truth = random_truth(of, spread, seed, frames=frames, frame_rate_hz=FRAME_RATE_HZ)
    body = truth.body.model_copy(update={"inertia_ratios": _ratios_of_any_body(seed)})
    return truth.model_copy(update={"body": body})


def _ratios_of_any_body(seed: int) -> Vector5:
    generator = np.random.default_rng((seed, 1))
    shares = generator.dirichlet(np.ones(3))
    while shares.min() < _MIN_SHARE:
        shares = generator.dirichlet(np.ones(3))
    axes = Rotation.random(rng=generator).as_matrix()
    inertia = np.eye(3) - axes @ np.diag(shares) @ axes.T
    a, b, c, d, e = (float(value) for value in ratios_from_parameters(parameters_of(inertia)))
    return a, b, c, d, e


@cache
def found(name: str) -> Satellite:
    """A target of the chapter, by its name."""
    return shape(name) if name in SHAPES else satellite(name)


def run_foreign(name: str, seed: int, frames: int) -> JudgedRun:
    """One track of a target with a foreign mass: truth and noise are the seed's."""
    of = found(name)
    return follow(Scene.of(foreign_truth(of, seed, frames), of.target.mesh), of.target)


def claims(found: Mapping[str, Sequence[JudgedRun]]) -> list[Claim]:
    """The mean of every block inside its bounds, over the runs of all targets together."""
    runs = [run for own in found.values() for run in own]
    return [
        inside(NAME, f"NEES of {name} {when}", mean_squared(_nees(runs, name, share), block.size))
        for name, block in JUDGED.items()
        for when, share in _TIMES.items()
    ]


def tables(found: Mapping[str, Sequence[JudgedRun]]) -> list[TextTable]:
    """NEES by target and block."""
    targets = dict(found)
    if len(targets) > 1:
        targets["all"] = [run for own in found.values() for run in own]
    rows: list[list[object]] = []
    for target, runs in targets.items():
        rows += [
            [
                *(target, name, block.size, len(runs)),
                *(mean_squared(_nees(runs, name, when), block.size) for when in _TIMES.values()),
            ]
            for name, block in JUDGED.items()
        ]
    return [table("foreign_masses", ("target", "block", "dof", "runs", *_TIMES), rows, 2)]


def _nees(runs: Sequence[JudgedRun], name: str, share: float) -> FloatArray:
    return np.array([run.nees(JUDGED[name])[_frame(run, share)] for run in runs])


def _frame(run: JudgedRun, share: float) -> int:
    return max(int(share * len(run)), 1) - 1
