"""Errors of the calibration, considered by a tracker: recordings of a camera that has them."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from pcnav.config.sensors import MiscalibrationTable
from pcnav.core.arrays import FloatArray
from pcnav.estimators.depth.calibration_errors import CalibrationErrors
from pcnav.recordings.calibration import EXACT, NOT_STATED, Calibration
from pcnav.recordings.sequence import SequenceInfo
from pcnav.simulation.depth import Scene
from pcnav.target.satellite import Target
from studies.following import follow
from tests.estimators.depth.tracked_boxsat import PIPELINE

OFF = MiscalibrationTable(
    focal_sd=0.002,
    centre_sd_px=0.5,
    range_offset_sd_m=0.005,
    range_scale_sd=0.002,
    mesh_scale_sd=0.002,
)


@dataclass(frozen=True)
class ToldSo(Scene):
    """A recording that states another calibration than its own."""

    told: Calibration | None = None

    @property
    def info(self) -> SequenceInfo:
        return replace(super().info, calibration=self.told)


def nees(target: Target, seed: int, told: Calibration | None) -> FloatArray:
    """Of the poses claimed, over their six degrees of freedom."""
    shorter = PIPELINE.scenario.model_copy(update={"frames": 10})
    changes = {"seed": seed, "miscalibration": OFF, "scenario": shorter}
    scene = Scene.showing(target, PIPELINE.model_copy(update=changes))
    found = follow(ToldSo(scene.pipeline, scene.motion, scene.mesh, told=told), target)
    assert found.claims.any()
    return np.asarray(found.pose_nees[found.claims] / 6.0)


@pytest.mark.parametrize("seed", [2])
def test_a_camera_that_is_off_has_deviations_that_say_so(boxsat: Target, seed: int) -> None:
    stated = Calibration(0.002, 0.5, 0.005, 0.002, 0.002, 0.0)
    # 99.9 % of six components; of one draw a recording, all its frames are off by as much.
    assert np.median(nees(boxsat, seed, stated)) < 22.5 / 6.0
    # Six tenths of these is what a recording is taken for that says nothing.
    assert np.median(nees(boxsat, seed, None)) < 0.6**-2 * 22.5 / 6.0
    assert np.median(nees(boxsat, seed, EXACT)) > 500.0


def test_what_is_assumed_of_a_calibration_leaves_no_pose_open(boxsat: Target) -> None:
    """An offset of 3 mm is a tenth of a target of 30 mm, and the frames say where that is."""
    shorter = PIPELINE.scenario.model_copy(update={"frames": 5})
    scene = Scene.showing(boxsat, PIPELINE.model_copy(update={"scenario": shorter}))
    run = follow(ToldSo(scene.pipeline, scene.motion, scene.mesh, told=NOT_STATED), boxsat)
    assert run.claims.any()
    errors = CalibrationErrors()
    errors._by_error[:] = 1.0
    assert not errors.in_camera.any() and errors.covariance.any()


def test_no_pose_is_claimed_that_a_stated_calibration_leaves_open(boxsat: Target) -> None:
    """Noise and motion are known as well as ever: what is only considered counts as much."""
    shorter = PIPELINE.scenario.model_copy(update={"frames": 8})
    scene = Scene.showing(boxsat, PIPELINE.model_copy(update={"scenario": shorter}))
    for sd_m, is_claimed in ((0.02, True), (0.2 * boxsat.diameter_m, False)):
        told = Calibration(0.0, 0.0, sd_m, 0.0, 0.0, 0.0)
        found = follow(ToldSo(scene.pipeline, scene.motion, scene.mesh, told=told), boxsat)
        assert found.claims.any() == is_claimed
        assert np.linalg.norm(found.errors.p_cam_m[-1]) < 0.01
