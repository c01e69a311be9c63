"""The expected view against the renderer's labels and against the very same frame measured."""

from collections.abc import Callable

import numpy as np
import pytest

from pcnav.config.depth import PerceptionTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera, project
from pcnav.core.spatial import exp_rotation, log_rotation, make_transform
from pcnav.perception.association import measure_by_prediction
from pcnav.perception.perceive import perceive
from pcnav.perception.predicted_view import ViewPredictor
from pcnav.recordings.sequence import Frame
from pcnav.target.rendering import RenderedDepth
from pcnav.target.satellite import Target

Shoot = Callable[..., tuple[Frame, RenderedDepth]]
SIGMA = 0.02
SETTINGS = PerceptionTable()


@pytest.fixture(scope="module")
def predictor(boxsat: Target, camera: PinholeCamera) -> ViewPredictor:
    return ViewPredictor(boxsat, camera, SETTINGS, SIGMA)


@pytest.mark.parametrize("seed", range(4))
def test_faces_are_where_their_rectangles_project(
    predictor: ViewPredictor, random_pose: Callable[..., FloatArray], seed: int
) -> None:
    T = random_pose(np.random.default_rng(seed))
    predicted = predictor.predict(T)
    assert len(predicted.faces) >= 2
    for index, face in enumerate(predicted.faces):
        v, u = np.nonzero(predicted.labels == index)
        assert len(u) == face.n_pixels >= SETTINGS.minimum_plane_points
        np.testing.assert_allclose(face.T_cam_rect, T @ face.rectangle.T_model_rect, atol=1e-12)
        # A pixel of the face looks at the rectangle: its ray meets the plane inside it, or on a
        # rim that noise (3.5 sigma deep) and the size of a pixel hide.
        rays = np.column_stack(
            [
                (u - predictor.camera.cx) / predictor.camera.fx,
                (v - predictor.camera.cy) / predictor.camera.fy,
                np.ones(len(u)),
            ]
        )
        normal, origin = face.T_cam_rect[:3, 2], face.T_cam_rect[:3, 3]
        assert normal @ origin < 0.0  # only faces turned to the sensor
        depth = (normal @ origin) / (rays @ normal)
        local = (rays * depth[:, None] - origin) @ face.T_cam_rect[:3, :2]
        half = 0.5 * np.array([face.rectangle.width_m, face.rectangle.length_m])
        assert np.mean(np.all(np.abs(local) < half + 0.1, axis=1)) > 0.95


def test_a_frame_at_the_true_pose_measures_the_truth_even_of_cut_faces(
    boxsat: Target, predictor: ViewPredictor, shoot: Shoot, random_pose: Callable[..., FloatArray]
) -> None:
    rng = np.random.default_rng(5)
    whole = cut = 0
    for _ in range(5):
        T = random_pose(rng, 14.0, 20.0)  # near enough for the image border to cut panels
        frame, _ = shoot(boxsat.mesh, T)
        predicted = predictor.predict(T)
        perceived = perceive(frame, boxsat.rectangles, SETTINGS, SIGMA, 0, predicted.surface)
        measured, unused = measure_by_prediction(perceived, predicted, 4.0)
        assert len(measured) >= 2
        assert all(item.reason for item in unused)
        for face in measured:
            truth = T @ face.rectangle.T_model_rect
            shift = truth[:3, :3].T @ (face.T_cam_rect[:3, 3] - truth[:3, 3])
            turn = log_rotation(truth[:3, :3].T @ face.T_cam_rect[:3, :3])
            error = np.concatenate([shift, turn])[face.known]
            assert np.max(np.abs(error)) < 1e-6, (face.rectangle.name, error)
            cut += face.seen.observation.is_cut
            whole += not face.seen.observation.is_cut
    assert whole > 3 and cut > 3


def test_a_target_out_of_view_is_expected_nowhere(predictor: ViewPredictor) -> None:
    for p in ([0.0, 0.0, -20.0], [30.0, 0.0, 20.0]):
        predicted = predictor.predict(make_transform(np.eye(3), np.array(p)))
        assert predicted.faces == ()
        assert np.all(predicted.labels == -1)
        assert not predicted.rendered.depth_m.any()


def test_moments_of_a_whole_face_sit_at_its_centre(
    predictor: ViewPredictor, boxsat: Target
) -> None:
    # Seen straight on, the bus's +z side shows its face with the ring in front; -x is whole.
    (face,) = [r for r in boxsat.rectangles if r.name == "panel_long_front"]
    facing = np.diag([1.0, -1.0, -1.0]) @ face.T_model_rect[:3, :3].T
    turned = exp_rotation(np.array([0.2, 0.15, 0.1])) @ facing
    centre = face.T_model_rect[:3, 3]
    T = make_transform(turned, np.array([0.0, 0.0, 20.0]) - turned @ centre)
    predicted = predictor.predict(T)
    (expected,) = [f for f in predicted.faces if f.rectangle.name == "panel_long_front"]
    shift = expected.shape.T_cam_rect[:3, 3] - expected.T_cam_rect[:3, 3]
    assert np.linalg.norm(shift) < 0.05  # a rim of one pixel at most: 0.034 m
    assert expected.shape.length_m == pytest.approx(4.0, abs=0.05)
    pixel = project(predictor.camera, (T[:3, :3] @ centre + T[:3, 3])[None])[0]
    u, v = np.rint(pixel).astype(int)
    assert predicted.faces[predicted.labels[v, u]] is expected
