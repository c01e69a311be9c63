"""Which face a segment is, and what of it is measured."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pcnav.config.depth import PerceptionMode, PerceptionTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, log_rotation, make_transform
from pcnav.perception.association import (
    PLANE,
    SQUARE,
    WHOLE,
    as_rectangle,
    measure_by_prediction,
    measure_by_size,
)
from pcnav.perception.perceive import perceive
from pcnav.perception.predicted_view import ViewPredictor
from pcnav.recordings.sequence import Frame
from pcnav.target.rendering import RenderedDepth
from pcnav.target.satellite import Target
from tests.target.catalogued import find_rectangles

Shoot = Callable[..., tuple[Frame, RenderedDepth]]
SIGMA = 0.02
SETTINGS = PerceptionTable()


def target_of(mesh: trimesh.Trimesh, boxsat: Target) -> Target:
    """A target of another mesh."""
    return replace(boxsat, mesh=mesh, rectangles=find_rectangles(mesh))


def pose_error(T_true: FloatArray, T: FloatArray) -> FloatArray:
    """(6,) shift and turn in the axes of the true frame."""
    R = T_true[:3, :3].T
    return np.concatenate([R @ (T[:3, 3] - T_true[:3, 3]), log_rotation(R @ T[:3, :3])])


@pytest.mark.parametrize("predicted", [False, True], ids=["ransac", "expected"])
def test_right_faces_from_a_prediction_that_is_off(
    boxsat: Target,
    camera: PinholeCamera,
    shoot: Shoot,
    random_pose: Callable[..., FloatArray],
    predicted: bool,
) -> None:
    rng = np.random.default_rng(1)
    predictor = ViewPredictor(boxsat, camera, SETTINGS, SIGMA)
    z = []
    for k in range(12):
        T = random_pose(rng)
        frame, _ = shoot(boxsat.mesh, T, SIGMA, k)
        # What a filter predicts: a few millimetres and hundredths of a degree off.
        off = make_transform(exp_rotation(rng.normal(0.0, 1e-3, 3)), rng.normal(0.0, 5e-3, 3))
        view = predictor.predict(T @ off)
        surface = view.surface if predicted else None
        perceived = perceive(frame, boxsat.rectangles, SETTINGS, SIGMA, 0, surface)
        measured, _ = measure_by_prediction(perceived, view, 4.0)
        assert len(measured) >= 2
        for face in measured:
            truth = T @ face.rectangle.T_model_rect
            if -truth[:3, 2] @ truth[:3, 3] < 0.25 * np.linalg.norm(truth[:3, 3]):
                continue  # flatter than 75 degrees: the rim is too much of the view as the face
            error = pose_error(truth, face.T_cam_rect)
            z.append(np.where(face.known, error / np.sqrt(np.diag(face.covariance)), np.nan))
            assert np.all(np.abs(z[-1][2:5]) < 6.0), face.rectangle.name
    rms = np.sqrt(np.nanmean(np.square(z), axis=0))
    assert np.all(rms[2:5] < 2.0), rms  # what the plane alone gives
    assert np.all(np.nanmedian(np.abs(z), axis=0) < 2.0)


def test_part_of_a_face_missing_leaves_its_plane(
    boxsat: Target, camera: PinholeCamera, shoot: Shoot
) -> None:
    (panel,) = [r for r in boxsat.rectangles if r.name == "panel_long_front"]
    turned = exp_rotation(np.array([0.3, 0.2, 0.1])) @ np.diag([1.0, -1.0, -1.0])
    R = turned @ panel.T_model_rect[:3, :3].T
    T = make_transform(R, np.array([0.0, 0.0, 22.0]) - R @ panel.T_model_rect[:3, 3])
    predicted = ViewPredictor(boxsat, camera, SETTINGS, SIGMA).predict(T)
    frame, _ = shoot(boxsat.mesh, T, SIGMA)
    index = next(k for k, f in enumerate(predicted.faces) if f.rectangle is panel)
    for hidden, known in ((False, WHOLE), (True, PLANE)):
        depth = frame.depth_m.copy()
        if hidden:  # a third of the panel returns nothing, which no model foresees
            rows, columns = np.nonzero(predicted.labels == index)
            low = rows < np.quantile(rows, 1 / 3)
            depth[rows[low], columns[low]] = 0.0
        perceived = perceive(
            replace(frame, depth_m=depth), boxsat.rectangles, SETTINGS, SIGMA, 0, None
        )
        measured, _ = measure_by_prediction(perceived, predicted, 4.0)
        (face,) = [f for f in measured if f.rectangle is panel]
        np.testing.assert_array_equal(face.known, known)
        error = pose_error(T @ panel.T_model_rect, face.T_cam_rect)
        sd = np.sqrt(np.diag(face.covariance))
        assert np.all(np.abs(error)[face.known] < 5.0 * sd[face.known])


def test_a_square_gives_five_degrees_of_freedom(
    boxsat: Target, camera: PinholeCamera, shoot: Shoot
) -> None:
    cube = target_of(trimesh.creation.box((2.0, 2.0, 2.0)), boxsat)
    T = make_transform(exp_rotation(np.array([0.5, 0.6, 0.2])), np.array([0.1, 0.2, 18.0]))
    frame, _ = shoot(cube.mesh, T, SIGMA)
    predicted = ViewPredictor(cube, camera, SETTINGS, SIGMA).predict(T)
    perceived = perceive(frame, cube.rectangles, SETTINGS, SIGMA, 0)
    measured, _ = measure_by_prediction(perceived, predicted, 4.0)
    assert len(measured) == 3
    for face in measured:
        np.testing.assert_array_equal(face.known, SQUARE)
        error = pose_error(T @ face.rectangle.T_model_rect, face.T_cam_rect)
        sd = np.sqrt(np.diag(face.covariance))
        assert np.all(np.abs(error[:5]) < 5.0 * sd[:5])
        # The unknown yaw is the predicted one, so that nothing else is turned by it.
        assert abs(error[5]) < 0.01


def test_what_no_face_is_expected_at_is_not_used(
    boxsat: Target, camera: PinholeCamera, shoot: Shoot
) -> None:
    T = make_transform(exp_rotation(np.array([0.4, 0.5, 0.2])), np.array([0.0, 0.0, 22.0]))
    elsewhere = T.copy()
    elsewhere[:3, 3] = [40.0, 0.0, 22.0]
    frame, _ = shoot(boxsat.mesh, T, SIGMA)
    perceived = perceive(frame, boxsat.rectangles, SETTINGS, SIGMA, 0)
    predicted = ViewPredictor(boxsat, camera, SETTINGS, SIGMA).predict(elsewhere)
    measured, unused = measure_by_prediction(perceived, predicted, 4.0)
    assert measured == []
    assert len(unused) == len(perceived.seen) >= 3
    assert {item.reason for item in unused} == {"no face expected there"}


def test_by_size_takes_the_nearest_of_equal_rectangles(twinwing: Target, shoot: Shoot) -> None:
    settings = PerceptionTable(mode=PerceptionMode.PAPER, size_gate_sigma=8.0)
    T = make_transform(exp_rotation(np.array([0.0, np.pi / 2, 0.1])), np.array([0.0, 0.0, 24.0]))
    frame, _ = shoot(twinwing.mesh, T, SIGMA)
    perceived = perceive(frame, twinwing.rectangles, settings, SIGMA, 0)
    measured, _ = measure_by_size(perceived, T)
    wings = [face for face in measured if face.rectangle.name.startswith("wing")]
    assert len({face.rectangle.name for face in wings}) == len(wings) == 2
    for face in wings:
        error = pose_error(T @ face.rectangle.T_model_rect, face.T_cam_rect)
        assert np.linalg.norm(error[:3]) < 0.15
        assert np.linalg.norm(error[3:]) < 0.05
    away = T.copy()
    away[:3, 3] += [0.0, 0.0, 10.0]
    measured, unused = measure_by_size(perceived, away)
    assert measured == []
    assert "far from every predicted rectangle of its size" in {item.reason for item in unused}


def test_covariance_moves_with_the_frame(twinwing: Target, shoot: Shoot) -> None:
    # Read as itself, a segment keeps its covariance up to the case's signs.
    T = make_transform(exp_rotation(np.array([0.0, np.pi / 2, 0.1])), np.array([0.0, 0.0, 24.0]))
    frame, _ = shoot(twinwing.mesh, T, SIGMA)
    perceived = perceive(frame, twinwing.rectangles, SETTINGS, SIGMA, 0)
    seen = next(s for s in perceived.seen if s.recognitions)
    face = as_rectangle(seen, seen.recognitions[0].rectangle, T)
    own = seen.observation.covariance[:6, :6]
    np.testing.assert_allclose(np.abs(face.covariance), np.abs(own), rtol=1e-9, atol=1e-18)
