"""How a simulated sensor and target differ from what a recording says of them."""

from dataclasses import dataclass, replace

import numpy as np
import trimesh

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.recordings.calibration import Calibration

_STREAM = 6
"""Beside the seed: these errors leave the draws of the others as they are."""


@dataclass(frozen=True)
class Miscalibration:
    """The errors of one recording."""

    focal: float
    """Of the focal length, over itself."""
    centre_px: FloatArray
    """(2,)"""
    range_offset_m: float
    range_scale: float
    mesh_scale: float

    @staticmethod
    def of(pipeline: Pipeline) -> "Miscalibration":
        """Drawn by the seed of a pipeline."""
        table = pipeline.miscalibration
        drawn = np.random.default_rng([pipeline.seed, _STREAM]).standard_normal(6)
        return Miscalibration(
            table.focal_sd * float(drawn[0]),
            table.centre_sd_px * drawn[1:3],
            table.range_offset_sd_m * float(drawn[3]),
            table.range_scale_sd * float(drawn[4]),
            table.mesh_scale_sd * float(drawn[5]),
        )

    def true_camera(self, stated: PinholeCamera) -> PinholeCamera:
        """The camera that takes the frames of one as it is said to be."""
        larger = 1.0 + self.focal
        across, down = self.centre_px.tolist()
        return replace(
            stated,
            fx=larger * stated.fx,
            fy=larger * stated.fy,
            cx=stated.cx + across,
            cy=stated.cy + down,
        )

    def true_mesh(self, stated: trimesh.Trimesh) -> trimesh.Trimesh:
        """The target as it is, about the origin of its model."""
        return (
            stated if self.mesh_scale == 0.0 else stated.copy().apply_scale(1.0 + self.mesh_scale)
        )

    def range_error(self, range_m: FloatArray) -> FloatArray | float:
        """Of ranges (...), m."""
        if self.range_offset_m == 0.0 and self.range_scale == 0.0:
            return 0.0
        return self.range_offset_m + self.range_scale * range_m


def stated_calibration(pipeline: Pipeline) -> Calibration | None:
    """What a simulated recording states of its camera, its clock and the mesh."""
    table, noise = pipeline.miscalibration, pipeline.noise
    if not table.is_stated:
        return None
    return Calibration(
        table.focal_sd,
        table.centre_sd_px,
        table.range_offset_sd_m,
        table.range_scale_sd,
        table.mesh_scale_sd,
        stamp_jitter_sd_s=float(np.hypot(noise.stamp_jitter_s, noise.stamp_step_s / np.sqrt(12.0))),
    )
