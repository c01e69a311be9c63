"""The shipped scenarios show what they promise: a whole target, unlike its nominal self."""

from pathlib import Path

import numpy as np
import pytest

from pcnav.config.pipeline_file import read_pipeline
from pcnav.config.shipped import shipped_mesh
from pcnav.dynamics.blocks import RATE
from pcnav.simulation.motion import true_motion
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import load_target

PIPELINES = Path(__file__).parents[2] / "pipelines"
RENDERED = 25


@pytest.mark.parametrize("name", ["boxsat", "demo", "twinwing", "cubesat6u"])
def test_shipped_scenario(name: str) -> None:
    pipeline = read_pipeline(PIPELINES / f"{name}.toml")
    assert pipeline.target_mesh is not None
    mesh_path = shipped_mesh(pipeline.target_mesh)
    assert mesh_path is not None
    target = load_target(mesh_path)

    offset = np.linalg.norm(np.array(pipeline.body.com_model_m) - target.com_model)
    assert 0.5 * target.com_sd_m < offset < 1.5 * target.com_sd_m
    ratio_error = np.abs(np.array(pipeline.body.inertia_ratios) - target.inertia_ratios)
    assert 0.03 < ratio_error.max() < 0.15
    assert np.abs(pipeline.body.inertia_ratios[2:]).min() > 0.01

    motion = true_motion(pipeline, name)
    speed = np.linalg.norm(motion.truth[RATE], axis=1)
    turned = np.trapezoid(speed, motion.truth.time_s)
    assert turned > np.deg2rad(180.0)
    renderer = DepthRenderer(target.mesh, pipeline.camera.pinhole)
    for k in np.linspace(0, len(motion) - 1, RENDERED).astype(int).tolist():
        seen = renderer.render(motion.truth.poses[k]).triangle >= 0
        assert seen.sum() > 1500
        rim = [seen[0], seen[-1], seen[:, 0], seen[:, -1]]
        assert not np.concatenate(rim).any()
