"""Trajectory errors against evo, on files that evo itself reads."""

from pathlib import Path

import numpy as np
import pytest
from evo.core import geometry
from evo.core.metrics import APE, RPE, PoseRelation, StatisticsType, Unit
from evo.tools import file_interface

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform, rotation_from_xyzw, xyzw_from_rotation
from pcnav.evaluation.trajectory import (
    absolute_errors,
    aligned,
    relative_errors,
    root_mean_square,
    umeyama_alignment,
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


@pytest.mark.parametrize("alignment", ["none", "rigid", "similarity"])
def test_absolute_errors_are_those_of_evo(files: tuple[Path, Path], alignment: str) -> None:
    reference, estimate = (file_interface.read_tum_trajectory_file(path) for path in files)
    T_true, T = (read(path) for path in files)
    with_scale = alignment == "similarity"
    if alignment != "none":
        estimate.align(reference, correct_scale=with_scale)
        moved = aligned(T_true, T, with_scale)
        assert moved is not None
        T = moved
    metric = APE(PoseRelation.translation_part)
    metric.process_data((reference, estimate))
    ours = absolute_errors(T_true, T)
    np.testing.assert_allclose(ours, metric.error, rtol=0.0, atol=TOLERANCE)
    expected = metric.get_statistic(StatisticsType.rmse)
    assert root_mean_square(ours) == pytest.approx(expected, rel=0.0, abs=TOLERANCE)


@pytest.mark.parametrize("step", [1, 7])
@pytest.mark.parametrize("all_pairs", [True, False])
def test_relative_errors_are_those_of_evo(
    files: tuple[Path, Path], step: int, all_pairs: bool
) -> None:
    pair = tuple(file_interface.read_tum_trajectory_file(path) for path in files)
    T_true, T = (read(path) for path in files)
    ours = relative_errors(T_true, T, step=step, all_pairs=all_pairs)
    for relation, values in (
        (PoseRelation.translation_part, ours.translation_m),
        (PoseRelation.rotation_angle_rad, ours.rotation_rad),
        (PoseRelation.rotation_angle_deg, np.rad2deg(ours.rotation_rad)),
    ):
        metric = RPE(relation, step, Unit.frames, all_pairs=all_pairs)
        metric.process_data(pair)
        np.testing.assert_allclose(values, metric.error, rtol=0.0, atol=TOLERANCE)


@pytest.mark.parametrize("with_scale", [False, True])
def test_an_alignment_never_mirrors(with_scale: bool) -> None:
    """Points and their mirror image: the best orthogonal matrix would be a reflection."""
    points = np.random.default_rng(4).normal(size=(30, 3)) * [1.0, 0.7, 0.1]
    mirrored = points * [1.0, 1.0, -1.0]
    found = umeyama_alignment(points, mirrored, with_scale)
    assert found is not None
    assert np.linalg.det(found.R) == pytest.approx(1.0)
    R, t, scale = geometry.umeyama_alignment(points.T, mirrored.T, with_scale)
    np.testing.assert_allclose(found.R, R, atol=1e-12)
    np.testing.assert_allclose(found.t, t, atol=1e-12)
    assert found.scale == pytest.approx(scale, rel=1e-12)


@pytest.mark.parametrize("count", [0, 1, 2, 9])
def test_points_on_a_line_tell_no_rotation(count: int) -> None:
    points = np.outer(np.arange(count), [1.0, 2.0, 3.0])
    assert umeyama_alignment(points, points + 1.0) is None
    T = make_transform(np.broadcast_to(np.eye(3), (count, 3, 3)), points)
    assert aligned(T, T) is None


def test_trajectories_that_are_not_matched_are_refused() -> None:
    T = np.broadcast_to(np.eye(4), (5, 4, 4))
    with pytest.raises(ValueError, match="matched in time"):
        absolute_errors(T, T[:4])
    with pytest.raises(ValueError, match="at least 1"):
        relative_errors(T, T, step=0)
    assert len(relative_errors(T[:1], T[:1]).rotation_rad) == 0
