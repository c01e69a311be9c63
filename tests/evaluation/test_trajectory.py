"""Trajectory errors against evo, on files that evo itself reads."""

from pathlib import Path

import numpy as np
import pytest
from evo.core.metrics import APE, RPE, PoseRelation, StatisticsType, Unit
from evo.tools import file_interface

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform, rotation_from_xyzw, xyzw_from_rotation
from pcnav.evaluation.trajectory import (
    absolute_errors,
    relative_errors,
    root_mean_square,
)

TOLERANCE = 1e-9


def written(path: Path, T: FloatArray) -> Path:
    """A TUM file: timestamp tx ty tz qx qy qz qw."""
    rows = np.column_stack([0.5 * np.arange(len(T)), T[:, :3, 3], xyzw_from_rotation(T[:, :3, :3])])
    np.savetxt(path, rows, fmt="%.17g")
    return path


def read(path: Path) -> FloatArray:
    """Our own reading of it."""
    rows = np.loadtxt(path, ndmin=2)
    return make_transform(rotation_from_xyzw(rows[:, 4:8]), rows[:, 1:4])


@pytest.fixture(params=[(0, 0.001), (1, 0.3), (2, 1.5)], ids=["small", "large", "turned"])
def files(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Path, Path]:
    """A drifting tumble and its truth; the larger the spread, the larger the errors."""
    seed, spread = request.param
    generator = np.random.default_rng(seed)
    n = 120
    R = exp_rotation(np.outer(np.arange(n), [0.03, -0.05, 0.09]))
    p = np.array([0.4, -0.2, 20.0]) + np.cumsum(generator.normal(0.0, 0.05, (n, 3)), axis=0)
    walk = np.cumsum(generator.normal(0.0, 0.1 * spread, (n, 3)), axis=0)
    estimated = make_transform(
        R @ exp_rotation(generator.normal(0.0, spread, (n, 3))), p * (1.0 + 0.1 * spread) + walk
    )
    shift = make_transform(exp_rotation(np.array([0.3, spread, 0.1])), np.array([1.0, 2.0, spread]))
    return (
        written(tmp_path / "truth.tum", make_transform(R, p)),
        written(tmp_path / "estimate.tum", shift @ estimated),
    )


def test_errors_are_those_of_evo(files: tuple[Path, Path]) -> None:
    pair = tuple(file_interface.read_tum_trajectory_file(path) for path in files)
    T_true, T = (read(path) for path in files)
    absolute, (shift_m, turn_rad) = absolute_errors(T_true, T), relative_errors(T_true, T)
    for metric, ours in (
        (APE(PoseRelation.translation_part), absolute),
        (RPE(PoseRelation.translation_part, 1, Unit.frames, all_pairs=True), shift_m),
        (RPE(PoseRelation.rotation_angle_rad, 1, Unit.frames, all_pairs=True), turn_rad),
    ):
        metric.process_data(pair)
        np.testing.assert_allclose(ours, metric.error, rtol=0.0, atol=TOLERANCE)
        expected = metric.get_statistic(StatisticsType.rmse)
        assert root_mean_square(ours) == pytest.approx(expected, rel=0.0, abs=TOLERANCE)


def test_one_pose_is_no_motion() -> None:
    T = np.broadcast_to(np.eye(4), (1, 4, 4))
    assert [len(errors) for errors in relative_errors(T, T)] == [0, 0]
    assert np.isnan(root_mean_square(np.zeros(0)))
