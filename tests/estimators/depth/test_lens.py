"""Targets followed through a lens, pixels that are not square, and rows read out in turn."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.spatial import rotation_angle
from pcnav.estimators.depth.tracker import Tracker
from pcnav.simulation.depth import Scene
from pcnav.target.satellite import Target

FRAMES = 13
PLAIN: dict[str, Any] = {"horizontal_fov_deg": 20.0}
CAMERAS: dict[str, dict[str, Any]] = {
    "lens": PLAIN | {"distortion": (-0.2, 0.05, 0.0, 0.0, 0.0)},
    "strong": PLAIN | {"distortion": (-1.5, 3.0, 0.01, -0.01, 0.0)},
    "fisheye": PLAIN | {"distortion_model": "fisheye", "distortion": (0.1, 0.05, 0.0, 0.0)},
    "uneven": PLAIN | {"pixel_aspect": 1.2},
}


def followed(
    target: Target,
    camera: dict[str, Any],
    rate_hz: float = 2.0,
    omega_deg_s: tuple[float, float, float] = (2.0, -1.4, 2.5),
    readout_s: float | None = None,
    seeds: tuple[int, ...] = (1, 2),
) -> tuple[float, float, float]:
    """RMS error of position (m) and attitude (rad) and NIS per degree of freedom, last frames.

    ``readout_s`` replaces what the recording states of its rows.
    """
    position, attitude, nis, dof = [], [], 0.0, 0
    for seed in seeds:
        pipeline = Pipeline.model_validate(
            {
                "seed": seed,
                "scenario": {"frames": FRAMES, "frame_rate_hz": rate_hz},
                "orbit": {"r_hill_m": [20.0, 1.5 - seed, 0.4], "v_hill_m_s": [0.004, 0.0, 0.003]},
                "body": {
                    "attitude_rotvec_deg": [25.0 * seed, 40.0, -30.0],
                    "omega_body_deg_s": omega_deg_s,
                    "com_model_m": [0.10, 0.12, -0.13],
                    "inertia_ratios": [0.577, 0.735, -0.02, 0.06, -0.045],
                },
                "camera": camera,
                "noise": {"range_sigma_m": 0.02},
            }
        )
        scene = Scene.showing(target, pipeline)
        info = scene.info
        if readout_s is not None:
            info = replace(info, row_readout_s=readout_s)
        tracker = Tracker(target, info, pipeline.perception, pipeline.filter, seed)
        for k, frame in enumerate(scene):
            estimate = tracker.step(frame)
            if k < 5:
                continue
            assert estimate.T_cam_target is not None, k
            true = scene.truth.poses[k]
            position.append(estimate.T_cam_target[:3, 3] - true[:3, 3])
            turn = estimate.T_cam_target[:3, :3].T @ true[:3, :3]
            attitude.append(float(rotation_angle(turn)))
            nis, dof = nis + estimate.nis, dof + estimate.nis_dof
    squared = np.sum(np.square(position), axis=1)
    return float(np.sqrt(squared.mean())), float(np.sqrt(np.mean(np.square(attitude)))), nis / dof


@pytest.fixture(scope="module")
def plain(boxsat: Target) -> tuple[float, float, float]:
    return followed(boxsat, PLAIN)


@pytest.mark.parametrize("name", CAMERAS)
def test_a_known_lens_costs_no_accuracy(
    boxsat: Target, plain: tuple[float, float, float], name: str
) -> None:
    position, attitude, nis = followed(boxsat, CAMERAS[name])
    # Two runs of eight frames: their own scatter is a third.
    assert position < 1.8 * plain[0]
    assert attitude < 1.8 * plain[1]
    # Likewise: of some hundred degrees of freedom.
    assert 0.7 < nis < 1.3


def test_rows_read_out_in_turn_cost_no_accuracy(boxsat: Target) -> None:
    spin, seeds = (8.0, -9.0, 16.0), (1, 2, 3)
    at_once = followed(boxsat, PLAIN, 10.0, spin, seeds=seeds)
    rolling = followed(boxsat, PLAIN | {"row_readout_s": 0.03}, 10.0, spin, seeds=seeds)
    assert rolling[0] < 2.0 * at_once[0]
    assert rolling[1] < 2.0 * at_once[1]
    assert 0.75 < rolling[2] < 1.25
    # Taken for a frame of one moment, they mislead.
    unstated = followed(boxsat, PLAIN | {"row_readout_s": 0.03}, 10.0, spin, 0.0, seeds)
    assert unstated[1] > 3.0 * rolling[1]
