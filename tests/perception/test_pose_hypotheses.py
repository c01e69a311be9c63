"""Hypotheses from one frame against the true pose and the target's symmetry."""

from collections.abc import Callable

import numpy as np
import pytest

from pcnav.config.depth import PerceptionTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import make_transform, rotation_angle
from pcnav.perception.perceive import perceive
from pcnav.perception.pose_hypotheses import PoseHypothesis, depth_tolerance, pose_hypotheses
from pcnav.perception.render_compare import RenderComparer
from pcnav.recordings.sequence import Frame
from pcnav.target.rendering import RenderedDepth
from pcnav.target.satellite import Target

Shoot = Callable[..., tuple[Frame, RenderedDepth]]
SIGMA = 0.02
SETTINGS = PerceptionTable()


def hypotheses_of(
    target: Target, comparer: RenderComparer, frame: Frame
) -> tuple[PoseHypothesis, ...]:
    perceived = perceive(frame, target.rectangles, SETTINGS, SIGMA, 0)
    found = pose_hypotheses(perceived, target, comparer, SIGMA)
    shares = [h.agreement.inlier_ratio for h in found]
    assert shares == sorted(shares, reverse=True)
    assert all(0.0 <= share <= 1.0 for share in shares)
    return found


def angle_to(T: FloatArray, hypothesis: PoseHypothesis) -> float:
    return float(rotation_angle(T[:3, :3].T @ hypothesis.T_cam_model[:3, :3]))


def test_best_hypothesis_is_the_true_pose(
    boxsat: Target,
    camera: PinholeCamera,
    shoot: Shoot,
    random_pose: Callable[..., FloatArray],
) -> None:
    rng = np.random.default_rng(2)
    comparer = RenderComparer(boxsat, camera, SIGMA, stride=4)
    proposed = best = 0
    runs = 12
    for k in range(runs):
        T = random_pose(rng)
        frame, _ = shoot(boxsat.mesh, T, SIGMA, k)
        hypotheses = hypotheses_of(boxsat, comparer, frame)
        near = [h for h in hypotheses if angle_to(T, h) < 0.15]
        proposed += bool(near)
        if near and hypotheses[0] is near[0]:
            best += 1
            assert np.linalg.norm(hypotheses[0].T_cam_model[:3, 3] - T[:3, 3]) < 0.4
            assert hypotheses[0].agreement.inlier_ratio > 0.7
        # Distinct: no two within the angle and shift that make them one.
        for i, h in enumerate(hypotheses):
            for other in hypotheses[:i]:
                shift = np.linalg.norm(h.T_cam_model[:3, 3] - other.T_cam_model[:3, 3])
                assert angle_to(h.T_cam_model, other) >= 0.15 or shift >= 0.1 * boxsat.diameter_m
    # A frame may show no whole face; the start then waits for the next one.
    assert proposed >= runs - 2
    assert best >= proposed - 1


def test_attitudes_that_the_symmetry_makes_equal_are_proposed_once(
    twinwing: Target, camera: PinholeCamera, shoot: Shoot
) -> None:
    comparer = RenderComparer(twinwing, camera, SIGMA, stride=4)
    x = np.array([0.25, 0.9, 0.2])
    z = np.array([-0.9, 0.1, 0.4])  # the sensor looks at the +x side
    z /= np.linalg.norm(z)
    x -= z * (x @ z)
    x /= np.linalg.norm(x)
    T = make_transform(np.stack([x, np.cross(z, x), z]), np.array([0.0, 0.0, 24.0]))
    frame, _ = shoot(twinwing.mesh, T, SIGMA)
    hypotheses = hypotheses_of(twinwing, comparer, frame)
    assert len(twinwing.symmetry_transforms) == 2
    tolerance = depth_tolerance(twinwing, SIGMA)
    equal = [
        comparer.score(frame.depth_m, pose, tolerance).inlier_ratio
        for pose in T @ twinwing.symmetry_transforms
    ]
    assert equal[0] == pytest.approx(equal[1], abs=0.02)
    right = [
        h
        for h in hypotheses
        if twinwing.shows_alike(T, h.T_cam_model, angle_rad=0.1, shift_fraction=0.1)
    ]
    (best,) = right
    assert best.agreement.inlier_ratio > 0.8
    # The same attitude may be proposed elsewhere too, by a wing taken for the other one.
    assert all(
        h.agreement.inlier_ratio < best.agreement.inlier_ratio for h in hypotheses if h is not best
    )


def test_no_returns_no_hypotheses(boxsat: Target, camera: PinholeCamera) -> None:
    frame = Frame(0, 0.0, np.zeros((256, 256), dtype=np.float32), camera, np.eye(4))
    comparer = RenderComparer(boxsat, camera, SIGMA, stride=4)
    assert hypotheses_of(boxsat, comparer, frame) == ()
