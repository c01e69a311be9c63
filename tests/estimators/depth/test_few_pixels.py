"""Poses fitted to frames of a target that covers hardly more pixels than it has faces."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera, range_per_depth
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.estimators.depth.pose_fit import fit_pose
from pcnav.estimators.depth.pose_measurement import pose_error
from pcnav.perception.render_compare import RenderComparer
from pcnav.target.rendering import DepthRenderer
from pcnav.target.satellite import Target

SIGMA = 0.02
SD = np.repeat([0.1, 0.03], 3)
"""Of the guess: 0.1 m, 1.7 degrees; a pixel covers 0.26 m."""
RANGE_M = 150.0
POSES = 30


@pytest.fixture(scope="module")
def fitted(boxsat: Target, camera: PinholeCamera) -> FloatArray:
    """(POSES, 3) returns, angle of the error and NEES per degree of freedom of fits to frames at
    random attitudes; infinite where there was no fit."""
    rng = np.random.default_rng(5)
    comparer = RenderComparer(boxsat, camera, SIGMA)
    renderer, found = DepthRenderer(boxsat.mesh, camera), []
    for _ in range(POSES):
        R = Rotation.random(rng=rng).as_matrix()
        T = make_transform(R, np.array([*rng.uniform(-5.0, 5.0, 2), RANGE_M]))
        clean = renderer.render(T).depth_m
        noise = SIGMA * rng.standard_normal(clean.shape) / range_per_depth(camera)
        depth_m = np.where(clean > 0.0, clean + noise, 0.0).astype(np.float32)
        error = SD * rng.standard_normal(6)
        guess = make_transform(R @ exp_rotation(error[3:]), T[:3, 3] + error[:3])
        fit = fit_pose(depth_m, guess, np.diag(SD**2), comparer)
        n = float(np.count_nonzero(depth_m))
        if fit is None:
            found.append((n, np.inf, np.inf))
            continue
        wrong = pose_error(T, fit.T_cam_model)
        nees = wrong @ np.linalg.solve(fit.covariance, wrong) / 6.0
        found.append((n, float(np.linalg.norm(wrong[3:])), float(nees)))
    return np.array(found)


def test_a_hundred_pixels_tell_the_attitude_though_no_face_has_many(fitted: FloatArray) -> None:
    returns, angle, _ = fitted.T
    assert 50 < np.median(returns) < 150
    assert np.median(angle) < np.deg2rad(0.5)


def test_fits_to_few_pixels_are_as_wrong_as_they_say(fitted: FloatArray) -> None:
    assert np.median(fitted[:, 2]) < 2.0
