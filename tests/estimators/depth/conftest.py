"""A camera, the shipped satellite, and a state that shows it to the camera."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.depth.pose_measurement import ObserverPose
from pcnav.recordings.sequence import Frame
from pcnav.simulation.noise import add_sensor_faults
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target, load_target
from tests.estimators.depth.tracked_boxsat import PIPELINE, Recording, recorded

Shoot = Callable[..., Frame]


@pytest.fixture(scope="session")
def observer() -> ObserverPose:
    """A camera that is neither at the chaser's centre nor along its axes, late in the orbit."""
    R = exp_rotation(np.array([0.1, -0.2, 0.3]))
    return ObserverPose.of(make_transform(R, np.array([0.2, 0.1, -0.3])), 600.0, 1.1e-3)


@pytest.fixture(scope="session")
def state(observer: ObserverPose, boxsat: Target) -> NavigationState:
    """A target 22 m in front of that camera."""
    p_cam = np.array([0.3, -0.2, 22.0])
    r_hill = observer.R_cam_hill.T @ (p_cam - observer.T_cam_world[:3, 3])
    return NavigationState(
        r_hill=r_hill,
        v_hill=np.array([0.004, -0.002, 0.003]),
        com_model=boxsat.com_model,
        R_world_body=exp_rotation(np.array([0.5, 0.7, -0.5])),
        omega_body=np.array([0.03, -0.02, 0.04]),
        inertia_ratios=boxsat.inertia_ratios,
    )


@pytest.fixture(scope="session")
def shoot(boxsat: Target, camera: PinholeCamera, observer: ObserverPose) -> Shoot:
    """Takes a frame of the satellite at a pose (4, 4), with 0.02 m of noise."""

    def take(T_cam_model: FloatArray, seed: int = 0) -> Frame:
        clean = DepthRenderer(boxsat.mesh, camera).render(T_cam_model)
        depth_m = add_sensor_faults(clean, NoiseTable(range_sigma_m=0.02), seed, 0)
        return Frame(7, 600.0, depth_m, camera, observer.T_cam_world)

    return take


@pytest.fixture(scope="session")
def recording(repository: Path) -> Recording:
    return recorded(load_target(repository / "meshes" / "boxsat.obj"), PIPELINE)
