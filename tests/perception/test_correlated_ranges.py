"""Errors that pixels share, against the dense covariance of all pixels."""

import numpy as np
import pytest

from pcnav.perception.correlated_ranges import face_field, range_evidence
from pcnav.perception.modality import Evidence
from pcnav.perception.sensor_noise import SensorNoise

SIGMA = 0.01
FACE_SD, TILT_SD, FRAME_SD = 0.004, 0.002, 0.02


def test_a_field_is_orthogonal_and_of_unit_mean_square() -> None:
    rng = np.random.default_rng(0)
    u = rng.uniform(0, 30, 200)
    field = face_field(u, 0.5 * u + rng.uniform(0, 5, 200))
    np.testing.assert_allclose(field.T @ field / 200, np.eye(3), atol=1e-12)


def test_a_single_row_of_pixels_has_no_tilt_across() -> None:
    field = face_field(np.arange(20.0), np.full(20, 3.0))
    assert np.isfinite(field).all()
    assert np.sort(np.mean(field**2, axis=0))[0] < 1e-20


@pytest.mark.parametrize("frame_sd", [0.0, FRAME_SD])
def test_evidence_of_two_faces_is_that_of_the_dense_covariance(frame_sd: float) -> None:
    rng = np.random.default_rng(1)
    noise = SensorNoise(SIGMA, face_sd_m=FACE_SD, face_tilt_sd_m=TILT_SD, frame_sd_m=frame_sd)
    parts, jacobians, residuals, covariances = [], [], [], []
    for n, cosine in ((40, 0.9), (60, 0.4)):
        H, r = rng.normal(size=(n, 6)), rng.normal(size=n)
        # Moved along its normal by one, a face is seen farther by the inverse cosine.
        H[:, :3] /= cosine * np.linalg.norm(H[:, :3], axis=1, keepdims=True)
        B = face_field(rng.uniform(0, 9, n), rng.uniform(0, 9, n))
        parts.append(range_evidence(H, r, B, SIGMA**2, noise).evidence)
        jacobians.append(H)
        residuals.append(r)
        B = B * np.array([FACE_SD, TILT_SD, TILT_SD]) / cosine
        covariances.append(SIGMA**2 * np.eye(n) + B @ B.T)
    found = Evidence.together(parts, noise.n_shared).of_pose
    H, r, n = np.vstack(jacobians), np.concatenate(residuals), 40
    covariance = np.full((100, 100), frame_sd**2)
    covariance[:n, :n] += covariances[0]
    covariance[n:, n:] += covariances[1]
    weighted = np.linalg.solve(covariance, H)
    np.testing.assert_allclose(found.information, H.T @ weighted, rtol=1e-8)
    np.testing.assert_allclose(found.vector, weighted.T @ r, rtol=1e-7, atol=1e-6)
