"""MSSD and MSPD, compared with their definitions, pose by pose and point by point."""

import numpy as np
import pytest
import trimesh

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.evaluation.bop_errors import (
    MSSD_THRESHOLDS,
    bop_errors,
    bop_vertices,
    mspd_thresholds_px,
    recall,
)
from pcnav.target.roundness import Roundness

RNG = np.random.default_rng(4)
FX, FY, CX, CY = 410.0, 400.0, 310.0, 250.0
AWAY = np.array([0.0, 0.0, 8.0])


def pose(turn: float = 3.0) -> FloatArray:
    return make_transform(exp_rotation(turn * RNG.normal(size=3)), RNG.normal(size=3) + AWAY)


def by_definition(
    p: FloatArray, true: FloatArray, found: FloatArray, turns: FloatArray
) -> list[float]:
    """The two errors as the challenge states them."""
    in_space, in_image = [], []
    for S in turns:
        apart, apart_px = [], []
        for x in p:
            a = found[:3, :3] @ x + found[:3, 3]
            b = true[:3, :3] @ (S[:3, :3] @ x + S[:3, 3]) + true[:3, 3]
            apart.append(float(np.sqrt(((a - b) ** 2).sum())))
            u = FX * a[0] / a[2] - FX * b[0] / b[2], FY * a[1] / a[2] - FY * b[1] / b[2]
            apart_px.append(float(np.hypot(*u)))
        in_space.append(max(apart))
        in_image.append(max(apart_px))
    return [min(in_space), min(in_image)]


def test_errors_are_those_of_the_definitions() -> None:
    box = trimesh.creation.box(extents=(1.0, 2.0, 0.6))
    half_turns = [np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0]), np.diag([1.0, -1.0, -1.0, 1.0])]
    vertices, turns = bop_vertices(box), np.stack(half_turns)
    assert vertices.shape == (8, 3)
    true = np.stack([pose() for _ in range(6)])
    found = np.stack([pose() for _ in range(5)] + [true[5] @ turns[1]])
    missing = np.full((1, 4, 4), np.nan)
    K = np.tile([FX, FY, CX, CY], (7, 1))
    errors = bop_errors(
        vertices, np.concatenate([true, true[:1]]), np.concatenate([found, missing]), turns, K
    )
    expected = [by_definition(vertices, *each, turns) for each in zip(true, found, strict=True)]
    assert np.allclose(np.stack([errors.mssd_m, errors.mspd_px], axis=1)[:6], expected, rtol=1e-12)
    assert errors.mssd_m[5] < 1e-12 and errors.mspd_px[5] < 1e-9
    assert np.isnan([errors.mssd_m[6], errors.mspd_px[6]]).all()


def test_a_turn_that_leaves_no_trace_is_no_error() -> None:
    can = trimesh.creation.cylinder(radius=0.5, height=2.0, sections=64)
    about = Roundness(np.zeros(3), np.array([[0.0, 0.0, 1.0]]))
    true = pose()
    tilt = make_transform(exp_rotation(np.array([0.02, 0.0, 0.0])), np.zeros(3))
    turn = make_transform(exp_rotation(np.array([0.0, 0.0, 1.234])), np.zeros(3))
    found = np.stack([true @ turn, true @ tilt @ turn])
    K = np.tile([FX, FY, CX, CY], (2, 1))
    errors = bop_errors(bop_vertices(can), np.stack([true, true]), found, np.eye(4)[None], K, about)
    assert errors.mssd_m[0] < 1e-12
    # The rim is farthest from the axis of the tilt, up to the angle between two of its corners.
    assert errors.mssd_m[1] == pytest.approx(2.0 * np.sin(0.01) * np.hypot(1.0, 0.5), rel=5e-3)


def test_a_pose_behind_the_camera_is_no_hit_and_a_large_mesh_keeps_its_hull() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5)
    vertices = bop_vertices(ball)
    hull = np.asarray(ball.convex_hull.vertices)
    assert {tuple(x) for x in hull.tolist()} <= {tuple(x) for x in vertices.tolist()}
    true = make_transform(np.eye(3), np.array([0.0, 0.0, 5.0]))
    behind = make_transform(np.eye(3), np.array([0.0, 0.0, -5.0]))
    K = np.array([[FX, FY, CX, CY]])
    errors = bop_errors(vertices[:50], true[None], behind[None], np.eye(4)[None], K)
    assert errors.mssd_m[0] == pytest.approx(10.0) and np.isinf(errors.mspd_px[0])


def test_recalls_count_the_thresholds_that_are_kept() -> None:
    found = recall(np.array([0.0, 0.049, 0.26, 0.5, np.nan]), MSSD_THRESHOLDS)
    assert found.tolist() == pytest.approx([1.0, 1.0, 0.5, 0.0, 0.0])
    assert mspd_thresholds_px(1280).tolist() == pytest.approx([10.0 * k for k in range(1, 11)])
