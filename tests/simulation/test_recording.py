"""A simulated sequence against the mesh and the truth stored with it."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from pcnav.config.pipeline_file import Pipeline
from pcnav.core.camera import pixel_rays
from pcnav.core.errors import InputError
from pcnav.core.spatial import invert_transform, transform_points
from pcnav.dynamics.blocks import ATTITUDE, CENTRE, POSITION
from pcnav.dynamics.orbit import R_hill_world
from pcnav.recordings.bop import read_bop
from pcnav.recordings.truth import read_truth
from pcnav.simulation.depth import Scene
from pcnav.target.mesh_files.reading import MeshOrigin
from pcnav.target.satellite import Target
from pcnav.target.unknown_density import unknown_density

N = 0.001
TABLES = {
    "seed": 3,
    "scenario": {"frames": 6, "frame_rate_hz": 0.2},
    "orbit": {
        "mean_motion_rad_s": N,
        "r_hill_m": [12.0, 0.3, -0.2],
        "v_hill_m_s": [0.0, 0.01, 0.0],
    },
    "body": {
        "omega_body_deg_s": [1.6, -1.1, 2.0],
        "com_model_m": [0.1, -0.05, 0.2],
        "inertia_ratios": [1.1, 0.9, 0.03, -0.02, 0.05],
    },
    "camera": {"width_px": 128, "height_px": 96},
    "noise": {"range_sigma_m": 0.01, "dropout_fraction": 0.05},
}


@pytest.fixture
def target(tmp_path: Path) -> Target:
    mesh = trimesh.creation.box((1.0, 1.5, 2.0))
    path = tmp_path / "box.ply"
    mesh.export(path)
    return Target(
        name="box",
        mesh_path=path,
        mesh=mesh,
        rectangles=(),
        symmetry_transforms=np.eye(4)[None],
        mass=unknown_density(mesh),
        mesh_origin=MeshOrigin(len(mesh.faces), 1.0, "assumed"),
    )


def test_stored_points_lie_on_the_mesh_at_the_stored_pose(tmp_path: Path, target: Target) -> None:
    told: list[tuple[int, int]] = []
    pipeline = Pipeline.model_validate(TABLES)
    out = tmp_path / "seq"
    scene = Scene.showing(target, pipeline)
    summary = scene.write(out, on_frame=lambda done, total: told.append((done, total)))
    assert told == [(k + 1, 6) for k in range(6)]
    assert summary.startswith(f"sequence: {out} (6 frames, ")
    sequence, truth = read_bop(out), read_truth(out)
    assert truth is not None
    assert truth.T_cam_target is not None
    assert sequence.info.target_mesh == sequence.path / target.mesh_path.name
    assert (sequence.info.range_sigma_m, sequence.info.mean_motion_rad_s) == (0.01, N)
    for frame, T_cam_model in zip(sequence, truth.T_cam_target, strict=True):
        p_cam = (pixel_rays(frame.camera) * frame.depth_m[..., None])[frame.depth_m > 0.0]
        assert len(p_cam) > 200
        p_model = transform_points(invert_transform(T_cam_model), p_cam)
        # Signed distance to a box, for points about its surface.
        distance = (np.abs(p_model) - [0.5, 0.75, 1.0]).max(axis=1)
        assert np.abs(distance).max() < 6.0 * 0.01
        assert np.abs(distance).mean() > 0.001


def test_states_poses_and_camera_agree(tmp_path: Path, target: Target) -> None:
    Scene.showing(target, Pipeline.model_validate(TABLES)).write(tmp_path / "seq")
    sequence, truth = read_bop(tmp_path / "seq"), read_truth(tmp_path / "seq")
    assert truth is not None
    assert POSITION in truth
    assert CENTRE in truth
    assert ATTITUDE in truth
    assert truth.T_cam_target is not None
    for k, frame in enumerate(sequence):
        # The mass centre seen through the camera pose is the one seen through the target's pose.
        p_world = R_hill_world(frame.time_s, N).T @ truth[POSITION][k]
        through_world = transform_points(frame.T_cam_world, p_world[None])[0]
        through_model = transform_points(truth.T_cam_target[k], truth[CENTRE][k][None])[0]
        np.testing.assert_allclose(through_world, through_model, atol=1e-11)
        R_cam_body = frame.T_cam_world[:3, :3] @ truth[ATTITUDE][k]
        np.testing.assert_allclose(R_cam_body, truth.T_cam_target[k][:3, :3], atol=1e-12)


def test_same_pipeline_same_bytes(tmp_path: Path, target: Target) -> None:
    pipeline = Pipeline.model_validate(TABLES)
    for name in ("a", "b"):
        Scene.showing(target, pipeline).write(tmp_path / name / "seq")
    Scene.showing(target, pipeline.model_copy(update={"seed": 4})).write(tmp_path / "c" / "seq")
    files = [p.relative_to(tmp_path / "a") for p in sorted((tmp_path / "a").rglob("*.*"))]
    assert len(files) == 12
    for file in files:
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    image = Path("seq/depth/000000.png")
    assert (tmp_path / "a" / image).read_bytes() != (tmp_path / "c" / image).read_bytes()


def test_faults_leave_nothing_behind(
    tmp_path: Path, target: Target, caplog: pytest.LogCaptureFixture
) -> None:
    before = sorted(tmp_path.iterdir())
    fine = Pipeline.model_validate({**TABLES, "noise": {"quantisation_m": 1e-4}})
    with pytest.raises(InputError, match="16 bits"):
        Scene.showing(target, fine).write(tmp_path / "seq")
    assert sorted(tmp_path.iterdir()) == before
    away = Pipeline.model_validate({**TABLES, "camera": {"boresight_hill": [-1, 0, 0]}})
    told = Scene.showing(target, away).write(tmp_path / "seq")
    assert told.endswith("(6 frames, 0 returns each)")
    assert "outside the image in 6 of 6 frames" in caplog.text
    assert not read_bop(tmp_path / "seq").frame(0).depth_m.any()


def test_noiseless_sensor_states_its_rounding(tmp_path: Path, target: Target) -> None:
    exact = {"range_sigma_m": 0.0, "quantisation_m": 0.002}
    pipeline = Pipeline.model_validate({**TABLES, "noise": exact})
    Scene.showing(target, pipeline).write(tmp_path / "seq")
    stated = read_bop(tmp_path / "seq").info.range_sigma_m
    assert stated == pytest.approx(0.002 / np.sqrt(12.0))
