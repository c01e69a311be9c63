"""Edges that contradict each other: on numbers, and at a target of which a strip is missing."""

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import make_transform
from pcnav.perception.contour import ContourRuns, contour_runs
from pcnav.perception.edge_conflicts import KnownError, conflicts_px, in_doubt
from pcnav.perception.pose_doubt import PoseDoubt
from pcnav.perception.sensor_noise import SensorNoise
from tests.perception.outlines import FACING, SIGMA, View, sheet

ANYWHERE = KnownError(np.zeros(6), np.diag(np.repeat([0.05, 0.2], 3) ** 2))
PX_PER_M = 1000.0


def edges(*normals: tuple[float, float]) -> FloatArray:
    """(n, 6) by the pose, of edges with outward normals in the image, right and down."""
    found = np.zeros((len(normals), 6))
    found[:, :2] = PX_PER_M * np.array(normals)
    return found


UP, DOWN, LEFT, RIGHT = (0.0, -1.0), (0.0, 1.0), (-1.0, 0.0), (1.0, 0.0)


def test_edges_that_one_shift_explains_agree() -> None:
    H = edges(UP, DOWN, LEFT, RIGHT)
    shift = np.array([0.02, -0.03, 0.0, 0.0, 0.0, 0.0])
    assert not conflicts_px(H @ shift, np.full(4, 0.01), H, ANYWHERE).any()


def test_of_two_opposite_edges_neither_is_believed_and_the_others_are() -> None:
    """A target that is seen 20 pixels too short lies anywhere over as many."""
    H = edges(UP, DOWN, LEFT, RIGHT)
    apart = conflicts_px(np.array([0.0, -20.0, 0.1, -0.1]), np.full(4, 0.01), H, ANYWHERE)
    np.testing.assert_allclose(apart, [-20.0, -20.0, 0.0, 0.0], rtol=0.01)
    half, variance = in_doubt(apart)
    np.testing.assert_allclose(half[:2], -10.0, rtol=0.01)
    assert np.all(variance[:2] > 10.0**2)


def test_one_edge_against_many_is_doubted_alone() -> None:
    H = edges(*[UP] * 8, *[DOWN] * 8)
    value = np.zeros(16)
    value[3] = -9.0
    apart = conflicts_px(value, np.full(16, 0.01), H, ANYWHERE)
    assert np.flatnonzero(apart).tolist() == [3]


def test_what_is_known_otherwise_settles_it() -> None:
    H = edges(UP, DOWN)
    known = KnownError(np.zeros(6), np.diag(np.full(6, 1e-4**2)))
    apart = conflicts_px(np.array([0.0, -20.0]), np.full(2, 0.01), H, known)
    np.testing.assert_allclose(apart, [0.0, -20.0])


def test_less_than_a_pixel_is_no_contradiction() -> None:
    H = edges(UP, DOWN)
    assert not conflicts_px(np.array([0.0, -0.9]), np.full(2, 1e-6), H, ANYWHERE).any()


@pytest.mark.parametrize("at_the_cut", [False, True])
def test_a_target_without_its_lower_rim_is_known_to_no_more_than_that(
    camera: PinholeCamera, at_the_cut: bool
) -> None:
    """Compared where it is, or where its upper edge would be missing instead."""
    view = View(sheet(2.0, 2.0), camera)
    T = make_transform(FACING, np.array([0.0, 0.0, 20.0]))
    frame = view.frame(T)
    rows = np.flatnonzero((frame > 0.0).any(axis=1))
    cut_px = 14
    frame[rows[-cut_px:]] = 0.0
    cut_m = cut_px * 20.0 / camera.fy
    pose = T.copy()
    pose[1, 3] -= cut_m if at_the_cut else 0.0
    runs = contour_runs(
        *(view.edges, frame, view.renderer.render(pose)),
        PoseDoubt(pose, np.diag(np.repeat([1e-3, 2e-4], 3) ** 2), SIGMA),
        *(0.0, SensorNoise(SIGMA)),
        known=KnownError(np.zeros(6), np.diag(np.repeat([1.0, 0.2], 3) ** 2)),
    )
    error, deviation = _down(runs)
    error += pose[1, 3] - T[1, 3]
    assert deviation > 0.5 * cut_m
    assert -1.5 * deviation < error < 1e-3 * deviation
    # Across, nothing is missing.
    across = np.abs(runs.jacobian[:, 0]) > 0.9 * np.abs(runs.jacobian[:, 0]).max()
    assert np.all(runs.variance[across] < 0.5**2)


def _down(runs: ContourRuns) -> tuple[float, float]:
    """Displacement downwards by all edges, and its standard deviation, m."""
    weighted = runs.jacobian[:, 1] / runs.variance
    information = float(weighted @ runs.jacobian[:, 1])
    return float(weighted @ runs.value) / information, information**-0.5
