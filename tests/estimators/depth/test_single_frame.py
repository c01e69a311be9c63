"""Poses from single frames of the shipped satellite, against the pose they were rendered at."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcnav.config.depth import Measurements, PerceptionMode, PerceptionTable
from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, log_rotation, make_transform, rotation_angle
from pcnav.estimators.depth.single_frame import fuse_faces, single_frame_pose
from pcnav.perception.association import MeasuredFace, measure_by_prediction
from pcnav.perception.perceive import PerceivedFrame, perceive
from pcnav.perception.predicted_view import ViewPredictor
from pcnav.perception.reading import FrameReader
from pcnav.recordings.sequence import Frame
from pcnav.simulation.noise import add_sensor_faults
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target, load_target

SIGMA_M = 0.02
CAMERA = PinholeCamera.from_field_of_view(256, 256, np.deg2rad(25.0))
POSE = make_transform(exp_rotation(np.array([0.6, -0.9, 0.5])), np.array([0.2, -0.1, 25.0]))


@pytest.fixture(scope="module")
def target(repository: Path) -> Target:
    return load_target(repository / "meshes" / "boxsat.obj")


def seen(target: Target, settings: PerceptionTable, sigma_m: float) -> PerceivedFrame:
    noise = NoiseTable(range_sigma_m=sigma_m)
    clean = DepthRenderer(target.mesh, CAMERA).render(POSE)
    depth_m = add_sensor_faults(clean, noise, 1, 0)
    frame = Frame(0, 0.0, depth_m, CAMERA, np.eye(4))
    return perceive(frame, target.rectangles, settings, sigma_m, 1)


def errors(T: FloatArray) -> tuple[float, float]:
    """Position error in mm and attitude error in degrees."""
    shift = 1e3 * float(np.linalg.norm(T[:3, 3] - POSE[:3, 3]))
    return shift, float(np.rad2deg(rotation_angle(T[:3, :3].T @ POSE[:3, :3])))


@pytest.mark.parametrize(
    ("mode", "measurements", "sigma_m", "most_mm", "most_deg"),
    [
        (PerceptionMode.AREA_WEIGHTED, Measurements.REFINED, SIGMA_M, 3.0, 0.1),
        (PerceptionMode.AREA_WEIGHTED, Measurements.REFINED, 0.1, 15.0, 0.5),
        (PerceptionMode.AREA_WEIGHTED, Measurements.RECTANGLES, SIGMA_M, 3.0, 0.1),
        (PerceptionMode.AREA_WEIGHTED, Measurements.RECTANGLES, 0.1, 15.0, 0.5),
        (PerceptionMode.PAPER, Measurements.RECTANGLES, SIGMA_M, 150.0, 2.0),
    ],
)
def test_pose_of_the_whole_satellite(
    target: Target,
    mode: PerceptionMode,
    measurements: Measurements,
    sigma_m: float,
    most_mm: float,
    most_deg: float,
) -> None:
    settings = PerceptionTable(mode=mode, measurements=measurements)
    reader = FrameReader(target, settings, sigma_m, 1)
    pose = single_frame_pose(seen(target, settings, sigma_m).frame, reader)
    assert pose is not None
    shift_mm, turn_deg = errors(pose.T_cam_model)
    assert shift_mm < most_mm
    assert turn_deg < most_deg
    assert pose.inlier_ratio > 0.5
    assert pose.inlier_ratio == pose.agreement.inlier_ratio
    assert pose.agreement.agree + pose.agreement.conflict > 100
    assert len(pose.used) >= 1
    # The errors are those of one draw: 6 degrees of freedom, and only gross overconfidence shows.
    if mode is not PerceptionMode.PAPER:
        shift = POSE[:3, 3] - pose.T_cam_model[:3, 3]
        turn = log_rotation(pose.T_cam_model[:3, :3].T @ POSE[:3, :3])
        error = np.concatenate([shift, turn])
        assert error @ np.linalg.solve(pose.covariance, error) < 40.0


def test_a_face_that_contradicts_the_others_is_left_out(target: Target) -> None:
    settings = PerceptionTable()
    predicted = ViewPredictor(target, CAMERA, settings, SIGMA_M).predict(POSE)
    faces, _ = measure_by_prediction(seen(target, settings, SIGMA_M), predicted, 4.0)
    assert len(faces) >= 4
    for index in range(len(faces)):
        pose = fuse_faces(_spoilt(faces, index), POSE, target.diameter_m)
        assert faces[index].rectangle.name in pose.rejected
        assert errors(pose.T_cam_model)[0] < 10.0


def _spoilt(faces: list[MeasuredFace], index: int) -> list[MeasuredFace]:
    """The faces with one moved by half a metre along its normal."""
    moved = faces[index].T_cam_rect.copy()
    moved[:3, 3] += 0.5 * moved[:3, 2]
    return [replace(f, T_cam_rect=moved) if k == index else f for k, f in enumerate(faces)]


@pytest.mark.parametrize("measurements", [Measurements.REFINED, Measurements.RECTANGLES])
def test_an_empty_frame_has_no_pose(target: Target, measurements: Measurements) -> None:
    settings = PerceptionTable(measurements=measurements)
    frame = Frame(0, 0.0, np.zeros((256, 256), dtype=np.float32), CAMERA, np.eye(4))
    assert single_frame_pose(frame, FrameReader(target, settings, SIGMA_M, 1)) is None
