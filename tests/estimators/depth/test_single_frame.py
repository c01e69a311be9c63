"""Poses from single frames of the shipped satellite, against the pose they were rendered at."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pcnav.config.depth import Measurements, PerceptionMode, PerceptionTable
from pcnav.config.sensors import NoiseTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera, pixel_rays
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, log_rotation, make_transform, rotation_angle
from pcnav.estimators.depth.pose_fit import SingleFramePose
from pcnav.estimators.depth.single_frame import _settles, fuse_faces, search, single_frame_pose
from pcnav.perception.agreement import Agreement
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


def among_things(target: Target, T_cam_model: FloatArray, seed: int) -> Frame:
    """The satellite before a wall, something like an arm across it, with noise."""
    rng = np.random.default_rng(seed)
    clean = DepthRenderer(target.mesh, CAMERA).render(T_cam_model)
    depth_m = add_sensor_faults(clean, NoiseTable(range_sigma_m=SIGMA_M), 1, 0)
    rays = pixel_rays(CAMERA)
    wall = 34.0 + 10.0 * rays[..., 0] + rng.normal(0.0, SIGMA_M, depth_m.shape)
    depth_m = np.where(depth_m > 0.0, depth_m, wall).astype(np.float32)
    along = rays[..., 0] + 0.3 * rays[..., 1] - 0.02
    arm = np.abs(along) < 0.012
    depth_m[arm] = (18.0 + rng.normal(0.0, SIGMA_M, depth_m.shape))[arm]
    return Frame(0, 0.0, depth_m, CAMERA, np.eye(4))


def test_the_pose_among_other_things(target: Target) -> None:
    reader = FrameReader(target, PerceptionTable(), SIGMA_M, 1)
    frame = among_things(target, POSE, 3)
    found, report = search(reader.look(frame), reader)
    shift_mm, turn_deg = errors(found[0].T_cam_model)
    assert shift_mm < 60.0
    assert turn_deg < 1.0
    assert report.span_m > 1.5 * target.diameter_m
    assert report.best_inlier_ratio > 0.8
    assert 1 <= len(report.tried) <= 16
    shares = [region.inlier_ratio for region in report.tried if not np.isnan(region.inlier_ratio)]
    assert shares == sorted(shares, reverse=True)


def test_the_target_alone_is_found_by_rectangles_alone(
    target: Target, monkeypatch: pytest.MonkeyPatch
) -> None:
    reader = FrameReader(target, PerceptionTable(), SIGMA_M, 1)

    def never(_: Frame) -> None:
        raise AssertionError("rectangles settle this frame")

    monkeypatch.setattr(reader, "view_hypotheses", never)
    found, report = search(seen(target, PerceptionTable(), SIGMA_M), reader)
    assert errors(found[0].T_cam_model)[0] < 3.0
    assert len(report.tried) == 1
    assert report.best_inlier_ratio == found[0].inlier_ratio


def test_a_target_without_rectangles_is_found(tmp_path: Path) -> None:
    parts = [trimesh.creation.icosphere(subdivisions=2) for _ in range(3)]
    for part, size, place in zip(
        parts,
        ([1.2, 1.4, 2.8], [2.0, 0.4, 0.4], [0.9, 0.9, 0.7]),
        ([0.0, 0.0, 0.0], [1.6, 0.3, 1.4], [-0.4, 0.8, -2.6]),
        strict=True,
    ):
        part.apply_scale(size)
        part.apply_translation(place)
    trimesh.util.concatenate(parts).export(tmp_path / "tank.stl")
    tank = load_target(tmp_path / "tank.stl")
    reader = FrameReader(tank, PerceptionTable(), SIGMA_M, 1)
    clean = DepthRenderer(tank.mesh, CAMERA).render(POSE)
    depth_m = add_sensor_faults(clean, NoiseTable(range_sigma_m=SIGMA_M), 1, 0)
    found, _ = search(reader.look(Frame(0, 0.0, depth_m, CAMERA, np.eye(4))), reader)
    shift_mm, turn_deg = errors(found[0].T_cam_model)
    assert shift_mm < 40.0
    assert turn_deg < 1.0
    with pytest.raises(InputError, match="rectangular face"):
        FrameReader(tank, PerceptionTable(measurements=Measurements.RECTANGLES), SIGMA_M, 1)


def test_half_turns_are_the_rivals_of_a_near_symmetric_target(tmp_path: Path) -> None:
    # A bar with a thin collar at one end: turned end for end, it explains nearly the whole frame.
    bar = trimesh.creation.box([1.2, 1.6, 6.0])
    collar = trimesh.creation.box([1.3, 1.7, 0.4])
    collar.apply_translation([0.0, 0.0, 2.4])
    trimesh.util.concatenate([bar, collar]).export(tmp_path / "bar.stl")
    target = load_target(tmp_path / "bar.stl")
    reader = FrameReader(target, PerceptionTable(), SIGMA_M, 1)
    clean = DepthRenderer(target.mesh, CAMERA).render(POSE)
    depth_m = add_sensor_faults(clean, NoiseTable(range_sigma_m=SIGMA_M), 1, 0)
    frame = Frame(0, 0.0, depth_m, CAMERA, np.eye(4))
    found, _ = search(reader.look(frame), reader)
    assert target.shows_alike(POSE, found[0].T_cam_model, 0.01, 0.01)
    rivals = reader.rivals(frame, [POSE])
    # About its long axis it lies on itself; about the other two, end for end.
    assert len(rivals) == 2
    for T in rivals:
        assert errors(T)[1] == pytest.approx(180.0, abs=1e-6)
        assert abs(float(T[:3, 2] @ POSE[:3, 2])) == pytest.approx(1.0, abs=1e-6)
        assert not target.shows_alike(POSE, T, 0.1, 0.1)
    # A rival that is already known is no new one.
    assert len(reader.rivals(frame, [POSE, rivals[0]])) == 0


def test_a_pose_settles_a_frame_whose_returns_it_explains_and_not_a_third_of_them() -> None:
    """A panel had been taken for the one opposite, and bus and other panel for other things: of
    what was left to explain that was nine tenths."""
    camera = PinholeCamera.from_field_of_view(64, 64, 0.4)
    frame = Frame(0, 0.0, np.full((64, 64), np.float32(10.0)), camera, np.eye(4))
    for agree, settles in ((4000, True), (1400, False)):
        agreement = Agreement(agree, round(0.08 * agree))
        pose = SingleFramePose(np.eye(4), np.eye(6), agreement, (), (), converged=True)
        assert pose.inlier_ratio > 0.9
        assert _settles(pose, frame) == settles
