"""What is known of a sensor's noise."""

import numpy as np
import pytest

from pcnav.perception.sensor_noise import SensorNoise


@pytest.mark.parametrize(("growth", "factor"), [(0, 1.0), (1, 2.0), (2, 4.0)])
def test_noise_grows_with_range(growth: int, factor: float) -> None:
    noise = SensorNoise(0.01, growth, reference_m=5.0)
    assert noise.sigma_at(10.0) == pytest.approx(0.01 * factor)
    np.testing.assert_allclose(noise.sigma_at(np.array([5.0, 10.0])), [0.01, 0.01 * factor])


def test_noise_of_an_image_is_that_at_its_returns() -> None:
    depth_m = np.zeros((4, 4), dtype=np.float32)
    assert SensorNoise(0.01, 1, 5.0).sigma_in(depth_m) == 0.01
    depth_m[1, 1:3] = 15.0
    assert SensorNoise(0.01, 1, 5.0).sigma_in(depth_m) == pytest.approx(0.03)
    assert SensorNoise(0.01).sigma_in(depth_m) == 0.01


def test_a_number_is_white_noise() -> None:
    assert SensorNoise.of(0.02) == SensorNoise(0.02)
    assert SensorNoise.of(SensorNoise(0.02, 2)) == SensorNoise(0.02, 2)
