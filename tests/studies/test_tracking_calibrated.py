"""The chapter on calibration: which errors it draws, and how it judges them."""

import numpy as np
import pytest
from scipy.stats import chi2

from pcnav.simulation.miscalibration import Miscalibration, stated_calibration
from studies.tracking import calibrated
from studies.tracking.calibrated import CalibrationRun, claims, tables
from tests.studies.test_tracking_parts import judged_run


def errors_of(is_stated: bool, seed: int) -> Miscalibration:
    return Miscalibration.of(calibrated._erring(is_stated, seed, 4))


def test_errors_are_drawn_as_stated_or_have_the_size_they_are_said_to_have() -> None:
    drawn = np.array([errors_of(True, seed).focal for seed in range(200)])
    assert drawn.std() == pytest.approx(0.002, rel=0.15)
    fixed = [errors_of(False, seed) for seed in range(20)]
    assert [abs(each.focal) for each in fixed] == pytest.approx(20 * [0.002])
    assert [abs(each.range_offset_m) for each in fixed] == pytest.approx(20 * [0.005])
    assert [np.linalg.norm(each.centre_px) for each in fixed] == pytest.approx(20 * [0.5])
    assert len({np.sign(each.focal) for each in fixed}) == 2
    stated = stated_calibration(calibrated._erring(True, 1, 4))
    assert stated is not None and stated.stamp_jitter_sd_s == pytest.approx(0.005)
    assert stated_calibration(calibrated._erring(False, 1, 4)) is None


def test_runs_are_judged_each_by_its_own_draw() -> None:
    near = judged_run(("locked",) * 4, np.full(4, 1.0))
    far = judged_run(("locked",) * 4, np.full(4, 5.0))
    claim, other = claims(
        {
            "stated": [CalibrationRun(True, 1, near), CalibrationRun(True, 2, far)],
            "not stated": [CalibrationRun(False, 1, near), CalibrationRun(False, 2, far)],
        }
    )
    # One component of six is off: by 1 and 5 deviations.
    assert claim.ours == pytest.approx((1.0 + 25.0) / 2.0 / 6.0)
    assert not claim.met
    assert 1.0 < chi2.ppf(0.999, 6) < 25.0
    assert other.ours == 0.5 and not other.met
    (table,) = tables({"stated": [CalibrationRun(True, 1, near)]})
    assert table.rows[0][:2] == ("stated", "1")


def test_a_camera_that_errs_is_claimed_and_held() -> None:
    run = calibrated.run_calibration(True, 3, 8)
    assert run.run.claims.any()
    # In millimetres of bias the noise alone would have some 1000 in place of 1.
    assert run.nees.mean() < 4.0
    assert 5e-3 < run.run.position_m[-1] < 0.2
