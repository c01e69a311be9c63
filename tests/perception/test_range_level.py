"""The level of the range noise, learnt from residuals whose noise is known."""

import numpy as np
import pytest

from pcnav.perception.modality import RangeResiduals
from pcnav.perception.range_level import face_levels
from pcnav.perception.sensor_noise import SensorNoise

SIGMA_M = 0.02


def face(hidden_share: float, sigma_m: float, stated_m: float) -> RangeResiduals:
    """Residuals of one face, columns of which something hides that stands two metres before it."""
    rng = np.random.default_rng(4)
    inside = np.ones((40, 50), dtype=np.bool_)
    u = np.nonzero(inside)[1]
    hidden = u < hidden_share * 50
    residual = np.where(hidden, -2.0 - 0.02 * u, 0.0) + sigma_m * rng.standard_normal(u.size)
    return RangeResiduals(
        face=np.zeros(u.size, dtype=np.intp),
        returned=np.ones(u.size, dtype=np.bool_),
        agrees=np.abs(residual) < 4.0 * stated_m,
        residual_m=residual,
        jacobian=np.zeros((u.size, 6)),
        pose_variance_m2=np.zeros(u.size),
        range_m=np.full(u.size, 20.0),
        sigma_m=stated_m,
        pixels=(np.nonzero(inside)[0], np.nonzero(inside)[1]),
        shape=inside.shape,
    )


@pytest.mark.parametrize("hidden_share", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("stated_m", [SIGMA_M / 3.0, SIGMA_M, 3.0 * SIGMA_M])
def test_noise_is_that_of_the_face_whatever_hides_it(hidden_share: float, stated_m: float) -> None:
    (level,) = face_levels(face(hidden_share, SIGMA_M, stated_m), SensorNoise(stated_m))
    assert np.sqrt(level.variance_m2) == pytest.approx(SIGMA_M, rel=0.1)
