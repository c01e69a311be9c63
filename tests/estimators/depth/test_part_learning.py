"""Targets with a part that is not as in the mesh, followed."""

import numpy as np
import pytest
import trimesh

from pcnav.config.depth import FilterTable, PerceptionTable
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.estimators.depth.pose_measurement import moved_pose, pose_error
from pcnav.estimators.depth.tracker import Tracker
from pcnav.recordings.calibration import EXACT
from pcnav.recordings.sequence import Frame, SequenceInfo
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target

SIGMA_M, STEP_S, FRAMES = 0.02, 0.5, 22
CAMERA = PinholeCamera.from_field_of_view(160, 160, np.deg2rad(25.0))
FIRST = make_transform(exp_rotation(np.array([0.4, 0.7, -0.5])), np.array([0.1, -0.1, 20.0]))
RATES = np.array([0.02, 0.0, 0.02, 0.0, 0.0, np.deg2rad(8.0)])
POSES = [moved_pose(FIRST, STEP_S * k * RATES) for k in range(FRAMES)]
PANEL = "panel_long"


def shown(target: Target, turn_deg: float | None) -> trimesh.Trimesh:
    """The mesh with its long panel turned about its long axis; without it where that is None."""
    body = next(r for r in target.rectangles if r.name.startswith(PANEL))
    pieces = []
    for piece in target.mesh.split(only_watertight=False):
        if np.allclose(piece.bounds.mean(axis=0)[1], body.T_model_rect[1, 3], atol=0.05):
            if turn_deg is None:
                continue
            hinge, centre = np.array([0.0, 1.0, 0.0]), piece.bounds.mean(axis=0)
            piece.apply_transform(
                trimesh.transformations.rotation_matrix(np.deg2rad(turn_deg), hinge, centre)
            )
        pieces.append(piece)
    mesh = trimesh.util.concatenate(pieces)
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def followed(target: Target, *meshes: trimesh.Trimesh) -> tuple[list[tuple[str, ...]], float]:
    """The parts that a tracker found changed, frame by frame, where meshes are shown for a time
    each, and the angle it is off by in the later half, rad."""
    renderers = [DepthRenderer(mesh, CAMERA) for mesh in meshes]
    rng, found, errors = np.random.default_rng(8), [], []
    info = SequenceInfo("boxsat", 0.0, SIGMA_M, None, calibration=EXACT)
    tracker = Tracker(target, info, PerceptionTable(), FilterTable(), 0)
    for k, T_cam_model in enumerate(POSES):
        depth_m = renderers[k * len(meshes) // FRAMES].render(T_cam_model).depth_m
        noisy = depth_m + SIGMA_M * rng.standard_normal(depth_m.shape)
        depth_m = np.where(depth_m > 0.0, noisy, 0.0).astype(np.float32)
        estimate = tracker.step(Frame(k, STEP_S * k, depth_m, CAMERA, np.eye(4)))
        found.append(tracker.changed_parts)
        if k >= FRAMES // 2:
            assert estimate.T_cam_target is not None
            errors.append(float(np.linalg.norm(pose_error(T_cam_model, estimate.T_cam_target)[3:])))
    return found, float(np.sqrt(np.mean(np.square(errors))))


@pytest.fixture(scope="module")
def usual_rad(boxsat: Target) -> float:
    """What the pose is off by with the right mesh."""
    found, off_rad = followed(boxsat, boxsat.mesh)
    assert not any(found)
    return off_rad


@pytest.mark.parametrize("turn_deg", [3.0, 10.0, None])
def test_a_part_that_does_not_fit_does_not_bend_the_pose(
    boxsat: Target, usual_rad: float, turn_deg: float | None
) -> None:
    found, off_rad = followed(boxsat, shown(boxsat, turn_deg))
    assert found[-1] == (PANEL,)
    assert off_rad < 2.0 * usual_rad


@pytest.mark.study
def test_a_part_that_fits_again_comes_back(boxsat: Target) -> None:
    found, _ = followed(boxsat, shown(boxsat, 10.0), boxsat.mesh)
    assert found[FRAMES // 2 - 1] == (PANEL,) and found[-1] == ()
