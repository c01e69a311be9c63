"""Estimates made up for every kind of output."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.blocks import (
    ATTITUDE,
    MASS_CENTRE_LAYOUT,
    Block,
)
from pcnav.runs.estimate import Estimate, FeaturePoint, FeatureUse, Output
from pcnav.runs.records import ACCEPTED, RectangleRecord
from pcnav.runs.writer import RunWriter

DEPTH = Output(MASS_CENTRE_LAYOUT, notes=("inlier_ratio", "n_rectangles"), has_records=True)


def value_of(block: Block, generator: np.random.Generator) -> FloatArray:
    """Of arbitrary numbers with all their digits."""
    if block is ATTITUDE:
        return exp_rotation(generator.standard_normal(3))
    return generator.standard_normal(block.size) * 10.0 ** generator.integers(-7, 4)


def estimate(index: int, generator: np.random.Generator, output: Output = DEPTH) -> Estimate:
    """A frame with all that an output has."""
    draw = generator.standard_normal
    size = output.layout.size
    factor = draw((size, size))
    record = RectangleRecord(
        time_s=index / 3.0,
        rectangle='panel "a", +y',
        length_m=4.0 / 3.0,
        width_m=1e-3 / 7.0,
        T_cam_rect=make_transform(exp_rotation(draw(3)), draw(3)),
        sd=np.array([0.1 / 3.0, np.inf, 1e-9, 1.0, np.inf, 2.0]),
        case="X",
        outcome=ACCEPTED,
    )
    unknown = replace(record, rectangle="", case="", outcome="side cut; 2,1 m\nshort")
    words = {"outcome": "measured, more or less"}
    points = {k: FeaturePoint(draw(3), np.diag(draw(3) ** 2)) for k in (7, index)}
    return Estimate(
        time_s=index / 3.0,
        status="locked",
        values={block.name: value_of(block, generator) for block in output.blocks},
        covariance=factor @ factor.T if size else None,
        T_cam_target=make_transform(exp_rotation(draw(3)), draw(3) * 20.0)
        if output.has_poses
        else None,
        nis=float(generator.chisquare(6)) if output.has_nis else np.nan,
        nis_dof=6 if output.has_nis else 0,
        notes={name: words.get(name, float(generator.uniform())) for name in output.notes},
        records=(record, unknown) if output.has_records else (),
        features=FeatureUse((index, 7), (index,), (7,), points),
    )


def empty(index: int) -> Estimate:
    """A frame before anything is known."""
    return Estimate(index / 3.0, "acquiring")


def made(output: Output = DEPTH) -> list[Estimate]:
    """Frames with and without an estimate."""
    generator = np.random.default_rng(3)
    known = [estimate(i, generator, output) for i in range(2, 7)]
    return [empty(0), empty(1), *known, empty(7)]


def write(
    folder: Path, estimates: list[Estimate], overwrite: bool = False, output: Output = DEPTH
) -> None:
    with RunWriter(folder, output, overwrite) as writer:
        for each in estimates:
            writer.add(each)
