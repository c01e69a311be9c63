"""The parts that a pipeline puts beside its target."""

from pathlib import Path

import numpy as np
import trimesh

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.spatial import make_transform
from pcnav.simulation.motion import TrueMotion
from pcnav.simulation.surroundings.backgrounds import backgrounds
from pcnav.simulation.surroundings.occluders import occluders
from pcnav.simulation.surroundings.part import Part, Stage
from pcnav.target.mesh import mesh_diameter

_SCENERY_STREAM = 2
"""Beside the seed: what stands about is drawn apart from motion and noise."""


def scenery(
    pipeline: Pipeline, motion: TrueMotion, mesh: trimesh.Trimesh, source: Path | str = "pipeline"
) -> tuple[Part, ...]:
    """The background first, then the occluders. Raises `InputError`, which names the source."""
    on_background, on_occluder = np.random.default_rng([pipeline.seed, _SCENERY_STREAM]).spawn(2)
    R_world_hill = np.swapaxes(motion.R_hill_world, 1, 2)
    T_world_hill = make_transform(R_world_hill, np.zeros(3))
    stage = Stage(
        T_cam_hill=motion.T_cam_world @ T_world_hill,
        T_cam_model=motion.truth.poses,
        time_s=motion.truth.time_s,
        mesh=mesh,
        diameter_m=mesh_diameter(mesh),
    )
    camera = pipeline.camera.pinhole
    behind = backgrounds(pipeline.background, stage, on_background)
    before = occluders(pipeline.occluder, stage, camera, on_occluder, source)
    return (*behind, *before)
