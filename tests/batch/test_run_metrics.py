"""What a run comes to: locks right and wrong, equivalent attitudes, and the memory it took."""

import sys
from pathlib import Path

import numpy as np
import pytest

from pcnav.batch.axes import grid_case
from pcnav.batch.grid import GridBasis
from pcnav.batch.monte_carlo import Run
from pcnav.batch.one_run import run_pipeline
from pcnav.batch.process import peak_memory_mb, reset_peak_memory
from pcnav.batch.recorded_run import follow
from pcnav.batch.run_metrics import Followed, RunMetrics, run_metrics
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.blocks import POSE_LAYOUT
from pcnav.estimators.interface import Estimator
from pcnav.recordings.sequence import Frame
from pcnav.runs.estimate import Estimate, Output
from pcnav.simulation.depth import Scene
from pcnav.target.satellite import Target

FRAMES = 7


@pytest.fixture(scope="module")
def twinwing() -> tuple[Scene, Target]:
    basis = GridBasis("small.toml", Path(), FRAMES, None, None, None)
    axes = (("satellite", "twinwing"), ("range_m", 18.0), ("resolution_px", 96))
    pipeline, target = run_pipeline(basis, Run(grid_case(axes), 0, 3))
    assert target is not None
    return Scene.of(pipeline, target.mesh), target


class Told(Estimator):
    """Says what it was told to say."""

    output = Output(POSE_LAYOUT, has_nis=False)

    def __init__(self, answers: list[Estimate]) -> None:
        self._answers = iter(answers)

    def step(self, frame: Frame, /) -> Estimate:
        return next(self._answers)


def told(
    scene: Scene, T_cam_model: FloatArray, status: list[str], name: str = "open3d_icp"
) -> Followed:
    """A run of an estimator of a name that says these poses (n, 4, 4), nan for none."""
    rows = zip(scene.truth.time_s.tolist(), status, T_cam_model, strict=True)
    answers = [
        Estimate(time_s, word, T_cam_target=T if np.isfinite(T).all() else None)
        for time_s, word, T in rows
    ]
    return follow(scene, name, Told(answers))


def number(found: RunMetrics, column: str) -> FloatArray:
    return np.asarray(found.columns[column], dtype=np.float64)


def test_a_lock_is_right_up_to_one_symmetry_of_the_run(twinwing: tuple[Scene, Target]) -> None:
    scene, target = twinwing
    truth = scene.truth
    assert truth.T_cam_target is not None
    half_turn = target.symmetry_transforms[1]
    status = ["locked"] * FRAMES
    turned = run_metrics(told(scene, truth.T_cam_target @ half_turn, status), truth, target)
    assert turned.values["share_locked_right"] == 1.0
    np.testing.assert_allclose(number(turned, "attitude_error_deg"), 180.0, atol=1e-5)
    np.testing.assert_allclose(number(turned, "attitude_sym_error_deg"), 0.0, atol=1e-5)
    assert np.max(number(turned, "add_s_m")) < 1e-6
    assert np.min(number(turned, "add_m")) > 1.0

    flipping = truth.T_cam_target.copy()
    flipping[-2:] = flipping[-2:] @ half_turn
    flips = run_metrics(told(scene, flipping, status), truth, target)
    assert flips.values["share_locked_wrong"] == pytest.approx(2 / FRAMES)
    forgets = run_metrics(told(scene, flipping, status, "pcnav_single_frame"), truth, target)
    assert forgets.values["share_locked_right"] == 1.0


def test_locks_are_counted_by_status_and_error(twinwing: tuple[Scene, Target]) -> None:
    """acquiring, right, lost, ambiguous and right, locked 6 deg off, 6 % off, coasting."""
    scene, target = twinwing
    truth = scene.truth
    assert truth.T_cam_target is not None
    T = truth.T_cam_target.copy()
    T[0] = T[2] = np.nan
    T[4] = T[4] @ make_transform(exp_rotation(np.deg2rad([0.0, 6.0, 0.0])), np.zeros(3))
    T[5, 0, 3] += 0.06 * target.diameter_m
    T[3, 0, 3] += 0.04 * target.diameter_m
    status = ["acquiring", "locked", "lost", "ambiguous", "locked", "locked", "coasting"]
    values = run_metrics(told(scene, T, status), truth, target).values
    assert values["time_to_lock_s"] == 0.5
    assert values["share_locked_right"] == pytest.approx(2 / 7)
    assert values["share_locked_wrong"] == pytest.approx(2 / 7)
    assert values["share_unlocked"] == pytest.approx(3 / 7)
    assert values["frames_lost"] == 2.0
    off = target.diameter_m * np.sqrt((0.06**2 + 0.04**2) / 5)
    assert values["ate_rmse_m"] == pytest.approx(off)

    silent = run_metrics(told(scene, np.full_like(T, np.nan), ["acquiring"] * 7), truth, target)
    assert np.isnan(silent.values["time_to_lock_s"])
    assert np.isnan(silent.values["ate_rmse_m"])
    assert (silent.values["share_unlocked"], silent.values["frames_lost"]) == (1.0, 0.0)


@pytest.mark.skipif(sys.platform != "linux", reason="the peak is reset where Linux allows it")
def test_peak_memory_is_that_since_the_reset() -> None:
    reset_peak_memory()
    before = peak_memory_mb()
    ballast = np.ones(30_000_000)
    assert peak_memory_mb() > before + 1e-6 * 0.9 * ballast.nbytes
    del ballast
    reset_peak_memory()
    assert peak_memory_mb() < before + 100.0
