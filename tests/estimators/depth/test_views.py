"""What a compared frame becomes: measurements for the filter, records for the result."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import NavigationState
from pcnav.estimators.depth.pose_measurement import ObserverPose, PoseMeasurement, moved_pose
from pcnav.estimators.depth.views import GATED, FrameView, silent_view, view_of_comparison
from pcnav.perception.agreement import Agreement
from pcnav.perception.face_evidence import FaceEvidence
from pcnav.perception.render_compare import Comparison, RenderComparer
from pcnav.recordings.sequence import Frame
from pcnav.runs.records import ACCEPTED
from pcnav.target.satellite import Rectangle, Target

Shoot = Callable[..., Frame]
LEVER_M = 5.0
SIGMA = 0.02
N = 31
"""Points along each side of a face."""


@pytest.fixture(scope="module")
def frame(state: NavigationState, observer: ObserverPose, shoot: Shoot) -> Frame:
    return shoot(state.T_cam_model(observer.T_cam_world, observer.R_hill_world))


def points_of(rectangle: Rectangle) -> FloatArray:
    """(n, 3) grid of points on a face, model frame."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, N), np.linspace(-0.5, 0.5, N))
    local = np.stack([x * rectangle.width_m, y * rectangle.length_m, 0.0 * x], axis=-1)
    T = rectangle.T_model_rect
    return np.asarray(local.reshape(-1, 3) @ T[:3, :3].T + T[:3, 3])


def of_plane(rectangle: Rectangle, T: FloatArray, error: FloatArray) -> FaceEvidence:
    """What the distances of points on a face from its plane say: three numbers of six."""
    normal = rectangle.T_model_rect[:3, 2]
    points = points_of(rectangle)
    # A point moves by shift + R (turn x p); along the normal that is n . shift + (p x n) . turn.
    J = np.hstack([np.tile(T[:3, :3] @ normal, (len(points), 1)), np.cross(points, normal)])
    information = J.T @ J / SIGMA**2
    return FaceEvidence(rectangle, information, information @ error, len(points), 1.0)


def view_of(
    frame: Frame, T: FloatArray, faces: tuple[FaceEvidence, ...], observer: ObserverPose
) -> FrameView:
    rendered = RenderComparer.__new__(RenderComparer)  # not looked at
    labels = np.zeros(frame.depth_m.shape, dtype=np.intp)
    unseen: Any = rendered
    comparison = Comparison(T, unseen, faces, Agreement(90, 10), labels, unseen)
    return view_of_comparison(frame, comparison, LEVER_M, observer)


def test_record_of_a_face_that_is_known_wholly_is_its_pose(
    boxsat: Target, frame: Frame, state: NavigationState, observer: ObserverPose
) -> None:
    T = state.T_cam_model(observer.T_cam_world, observer.R_hill_world)
    error = np.array([0.03, -0.02, 0.05, 0.01, -0.02, 0.015])
    information = np.diag([1e8] * 3 + [1e9] * 3)
    faces = tuple(
        FaceEvidence(r, information, information @ error, 100, 1.0) for r in boxsat.rectangles
    )
    view = view_of(frame, T, faces, observer)
    assert len(view.records) == len(boxsat.rectangles)
    for record, rectangle in zip(view.records, boxsat.rectangles, strict=True):
        expected = moved_pose(T, error) @ rectangle.T_model_rect
        np.testing.assert_allclose(record.T_cam_rect, expected, atol=1e-8)
        assert record.rectangle == rectangle.name
        assert (record.length_m, record.width_m) == (rectangle.length_m, rectangle.width_m)
        assert record.time_s == frame.time_s
        assert record.case == "I"
        # A shift of the face is that of the origin and of its turn about it.
        p = rectangle.T_model_rect[:3, 3]
        axes = rectangle.T_model_rect[:3, :3]
        at_face = 1e-8 + np.array(
            [1e-9 * (np.cross(axis, p) @ np.cross(axis, p)) for axis in axes.T]
        )
        np.testing.assert_allclose(record.sd[:3], np.sqrt(at_face), rtol=0.2)
        assert np.all(record.sd[:3] >= 0.99e-4)
        np.testing.assert_allclose(record.sd[3:], 1e-9**0.5, rtol=1e-3)


def test_record_of_a_plane_knows_its_distance_and_tilt_only(
    boxsat: Target, frame: Frame, state: NavigationState, observer: ObserverPose
) -> None:
    T = state.T_cam_model(observer.T_cam_world, observer.R_hill_world)
    error = np.array([0.03, -0.02, 0.05, 0.004, -0.006, 0.005])
    faces = tuple(of_plane(rectangle, T, error) for rectangle in boxsat.rectangles)
    for record, rectangle in zip(
        view_of(frame, T, faces, observer).records, boxsat.rectangles, strict=True
    ):
        predicted, truth = T @ rectangle.T_model_rect, moved_pose(T, error) @ rectangle.T_model_rect
        normal = truth[:3, 2]
        np.testing.assert_allclose(record.T_cam_rect[:3, 2], normal, atol=1e-4)
        assert normal @ (record.T_cam_rect[:3, 3] - truth[:3, 3]) == pytest.approx(0.0, abs=1e-3)
        # Within the plane it stays as predicted, to first order in the turn.
        shift = predicted[:3, :3].T @ (record.T_cam_rect[:3, 3] - predicted[:3, 3])
        np.testing.assert_allclose(shift[:2], 0.0, atol=2e-4)
        # Closed forms: the mean of N^2 points, and their moments about the axes.
        spacing = np.linspace(-0.5, 0.5, N)
        moment = N * np.sum(spacing**2)
        expected = [
            SIGMA / N,
            SIGMA / (rectangle.length_m * np.sqrt(moment)),
            SIGMA / (rectangle.width_m * np.sqrt(moment)),
        ]
        np.testing.assert_allclose(record.sd[2:5], expected, rtol=1e-3)
        assert np.isinf(record.sd[[0, 1, 5]]).all()


def test_every_face_is_measured_and_those_on_the_catalogue_are_recorded(
    boxsat: Target, frame: Frame, state: NavigationState, observer: ObserverPose
) -> None:
    T = state.T_cam_model(observer.T_cam_world, observer.R_hill_world)
    error = np.full(6, 1e-3)
    known = [of_plane(rectangle, T, error) for rectangle in boxsat.rectangles[:3]]
    other = FaceEvidence(None, np.eye(6), error, 50, 1.0)
    view = view_of(frame, T, (known[0], other, known[1], known[2]), observer)
    named = [boxsat.rectangles[k].name for k in range(3)]
    assert [record.rectangle for record in view.records] == named
    assert [len(m.covariance) for m in view.measurements] == [3, 6, 3, 3]
    assert view.face_of_record == (0, 2, 3)
    assert view.inlier_ratio == pytest.approx(0.9)
    # Measured about the compared pose: what the moved one leaves is nothing.
    for measured in view.measurements:
        assert isinstance(measured, PoseMeasurement)
        np.testing.assert_allclose(measured.residual(state), measured.value)
        np.testing.assert_allclose(measured.rows @ error, measured.value, atol=1e-9)
    outcomes = view.outcomes((True, True, False, True))
    assert [record.outcome for record in outcomes] == [ACCEPTED, GATED, ACCEPTED]

    silent = view.without_faces("not believed")
    assert [*silent.measurements, *silent.records, *silent.face_of_record] == []
    assert [record.outcome for record in silent.outcomes(())] == ["not believed"] * 3
    assert silent.inlier_ratio == view.inlier_ratio


def test_records_of_a_real_frame_are_near_the_faces(
    boxsat: Target, frame: Frame, state: NavigationState, observer: ObserverPose
) -> None:
    truth = state.T_cam_model(observer.T_cam_world, observer.R_hill_world)
    error = np.array([0.004, -0.003, 0.005, 8e-4, -6e-4, 5e-4])
    predicted = moved_pose(truth, error)
    P = np.diag(np.repeat([0.005, 1e-3], 3) ** 2)
    comparer = RenderComparer(boxsat, frame.camera, SIGMA)
    comparison = comparer.compare(frame.depth_m, predicted, P)
    view = view_of_comparison(frame, comparison, comparer.lever_m, observer)
    assert len(view.records) >= 3
    assert view.inlier_ratio > 0.95
    by_name = {rectangle.name: rectangle for rectangle in boxsat.rectangles}
    for record in view.records:
        expected = truth @ by_name[record.rectangle].T_model_rect
        difference = expected[:3, :3].T @ (record.T_cam_rect[:3, 3] - expected[:3, 3])
        known = np.isfinite(record.sd[:3])
        assert known[2]
        assert np.all(np.abs(difference[known]) < 5.0 * record.sd[:3][known])


def test_a_silent_frame_has_nothing(frame: Frame) -> None:
    view = silent_view(frame)
    assert [*view.measurements, *view.records, *view.unused] == []
    assert view.outcomes(()) == ()
    assert np.isnan(view.inlier_ratio)
    assert (view.image_labels == -1).all()
    assert view.image_labels.shape == frame.depth_m.shape
