"""What the plots show against the run and its deviations."""

import numpy as np
import pytest

from pcnav.dynamics.blocks import CENTRE
from pcnav.viewer.clock import Playback, speeds
from pcnav.viewer.curves import Chart, groups_of, linear_range
from pcnav.viewer.loaded_run import LoadedRun


def test_errors_have_three_stated_deviations_about_zero(loaded: LoadedRun) -> None:
    charts, error = groups_of(loaded)["mass centre"]().charts, loaded.error(CENTRE)
    assert error is not None and all(chart.is_error for chart in charts)
    scale = 1e3 if charts[0].label.endswith("mm") else 1.0
    for k, chart in enumerate(charts):
        assert np.allclose(chart.values, scale * error[:, k], equal_nan=True)
        assert chart.high is not None and chart.low is not None
        expected = 3.0 * scale * loaded.trajectory.sd_of(CENTRE)[:, k]
        assert np.allclose(chart.high, expected, equal_nan=True)
        assert np.allclose(chart.low, -expected, equal_nan=True)


def test_long_series_keep_their_peaks() -> None:
    values = np.zeros(100_000)
    values[12_345], values[67_890] = 5.0, -7.0
    at = Chart("x, m", np.arange(100_000.0), values).shown()
    assert len(at) <= 1000
    assert {12_345, 67_890} <= set(at.tolist())


def test_inertia_is_shaded_where_data_halved_the_doubt(loaded: LoadedRun) -> None:
    for chart, name in zip(
        groups_of(loaded)["inertia ratios"]().charts,
        ("i_yy", "i_zz", "i_xy", "i_xz", "i_yz"),
        strict=True,
    ):
        verdict = loaded.verdicts[name]
        assert chart.known is not None
        if not verdict.from_data:
            assert not chart.known.any()


@pytest.mark.parametrize(
    ("start", "end", "expected"), [(1.0, 1.0, None), (100.0, 0.3, 1.0), (100.0, 4.0, 10.0)]
)
def test_bounds_that_shrink_by_decades_get_a_two_sided_log(
    start: float, end: float, expected: float | None
) -> None:
    time_s = np.linspace(0.0, 100.0, 500)
    bound = np.where(time_s < 50.0, start, end)
    assert linear_range(time_s, bound) == expected


def test_playback_follows_the_time_of_the_run() -> None:
    times = np.array([0.0, 0.5, 1.0, 5.0, 5.5])
    playback = Playback(started_s=100.0, from_s=0.5, speed=2.0)
    assert [playback.frame_at(100.0 + dt, times) for dt in (0.0, 0.2, 0.25, 2.2, 2.25, 9.0)] == [
        *(1, 1, 2, 2, 3, 4)
    ]
    assert not playback.has_ended(102.0, times) and playback.has_ended(102.5, times)
    name, value = speeds(times)[-1]
    assert name == "20 frames/s" and value == pytest.approx(10.0)
