"""The outline before walls, on tables and among holes, against displacements that are known."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.perception.contour import ContourRuns, contour_reach, contour_runs
from pcnav.perception.mesh_edges import mesh_edges
from pcnav.perception.outline_frame import OutlineFrame, outline_frame
from pcnav.perception.pose_doubt import PoseDoubt
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.perception.surroundings import surroundings_of
from pcnav.target.rendering import DepthRenderer

BOX = trimesh.creation.box((2.0, 1.5, 3.0))
DIAMETER_M = float(np.linalg.norm(BOX.extents))
CAMERA = PinholeCamera.from_field_of_view(160, 160, 0.3)
SIGMA, TOLERANCE, SD = 1e-3, 0.03, (0.003, 6e-4)
RENDERER = DepthRenderer(BOX, CAMERA)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def draw(rng: np.random.Generator) -> FloatArray:
    """A box that stands upright in front of a camera which looks down on it by 35 degrees."""
    tilt = exp_rotation(np.array([-np.pi / 2 - np.radians(35.0), 0.0, 0.0]))
    turn = exp_rotation(np.array([0.0, 0.0, rng.uniform(0.0, 6.3)]))
    x, y = rng.uniform(-0.3, 0.3, 2)
    return make_transform(tilt @ turn, np.array([x, y, rng.uniform(18.0, 20.0)]))


def with_things(T: FloatArray, *things: tuple[trimesh.Trimesh, FloatArray]) -> DepthImage:
    """The box at a pose and other things at theirs, the nearest seen."""
    views = [RENDERER.render(T).depth_m]
    views += [DepthRenderer(mesh, CAMERA).render(pose).depth_m for mesh, pose in things]
    nearest = np.min([np.where(depth_m > 0.0, depth_m, np.inf) for depth_m in views], axis=0)
    return np.where(np.isfinite(nearest), nearest, 0.0).astype(np.float32)


def wall(distance_m: float) -> tuple[trimesh.Trimesh, FloatArray]:
    return trimesh.creation.box((40.0, 40.0, 0.1)), make_transform(
        exp_rotation(np.array([0.2, 0.3, 0.0])), np.array([0.0, 0.0, distance_m])
    )


def table(T: FloatArray) -> tuple[trimesh.Trimesh, FloatArray]:
    """Under the box."""
    return trimesh.creation.box((30.0, 30.0, 0.1)), T @ make_transform(
        np.eye(3), np.array([0.0, 0.0, -1.55])
    )


def seen(frame: DepthImage, T: FloatArray) -> OutlineFrame:
    surroundings = surroundings_of(frame, CAMERA, DIAMETER_M, SIGMA)
    assert surroundings is not None
    outline = outline_frame(frame, RENDERER.render(T), surroundings, TOLERANCE, 1)
    assert outline is not None
    return outline


def runs(
    frame: DepthImage, T: FloatArray, unknown: BoolArray | None = None, dropout: float = 0.0
) -> ContourRuns:
    doubt = PoseDoubt(T, np.diag(np.square(np.repeat(SD, 3))), SIGMA)
    rendered, noise = RENDERER.render(T), SensorNoise(SIGMA)
    return contour_runs(mesh_edges(BOX), frame, rendered, doubt, dropout, noise, unknown)


def information(found: ContourRuns) -> float:
    """About shifts, m^-2."""
    return float(np.sum(np.sum(found.jacobian[:, :3] ** 2, axis=1) / found.variance))


def same(a: ContourRuns, b: ContourRuns) -> None:
    np.testing.assert_array_equal(a.value, b.value)
    np.testing.assert_array_equal(a.jacobian, b.jacobian)
    assert len(a) > 8


def test_the_doubt_of_these_tests_takes_one_pixel_on_each_side() -> None:
    assert contour_reach(0.2) == 1
    assert contour_reach(0.5) == 2


def test_before_a_wall_the_outline_is_that_before_space(rng: np.random.Generator) -> None:
    T = draw(rng)
    frame = with_things(T, wall(35.0))
    outline = seen(frame, T)
    assert not outline.unknown.any()
    same(runs(outline.depth_m, T, outline.unknown), runs(with_things(T), T))
    # As it is, a wall behind it takes the outline away.
    assert len(runs(frame, T)) < 0.2 * len(runs(with_things(T), T))


def spoilt_by(
    change: Callable[[DepthImage, FloatArray, np.random.Generator], DepthImage],
    rng: np.random.Generator,
    dropout: float = 0.0,
) -> tuple[FloatArray, float]:
    """Normalised errors of the outlines of many frames, and the share of information left."""
    z, left = [], []
    for _ in range(24):
        T = draw(rng)
        error = rng.normal(size=6) * np.repeat(SD, 3)
        moved = make_transform(T[:3, :3] @ exp_rotation(error[3:]), T[:3, 3] + error[:3])
        outline = seen(change(with_things(moved), moved, rng), T)
        found = runs(outline.depth_m, T, outline.unknown, dropout)
        z.append((found.value - found.jacobian @ error) / np.sqrt(found.variance))
        left.append(information(found) / information(runs(with_things(moved), T)))
    return np.concatenate(z), float(np.mean(left))


def on_table(_: DepthImage, T: FloatArray, __: np.random.Generator) -> DepthImage:
    return with_things(T, table(T))


def in_hand(_: DepthImage, T: FloatArray, rng: np.random.Generator) -> DepthImage:
    """Two fingers from the border, at the depth of the box and on it, before a wall."""
    side = np.sign(rng.normal())
    finger = trimesh.creation.box((8.0, 0.5, 0.5))
    p = T[:3, 3] + [side * 5.0, rng.uniform(-0.8, 0.8), -0.3]
    return with_things(T, wall(30.0), (finger, make_transform(np.eye(3), p)))


def with_holes(_: DepthImage, T: FloatArray, rng: np.random.Generator) -> DepthImage:
    """A wall behind, and beside the box a shadow without returns; some of it on the box."""
    frame = with_things(T, wall(30.0))
    rows = np.flatnonzero((RENDERER.render(T).triangle >= 0).any(axis=1))
    i = rng.integers(rows[0], rows[-1] - 10)
    inside = np.flatnonzero(RENDERER.render(T).triangle[i] >= 0)
    frame[i : i + 12, inside[0] - 6 : inside[0] + 6] = 0.0
    return frame


def false_returns(clean: DepthImage, _: FloatArray, rng: np.random.Generator) -> DepthImage:
    false = rng.random(clean.shape) < 0.05
    return np.where(false, rng.uniform(5.0, 60.0, clean.shape), clean).astype(np.float32)


@pytest.mark.parametrize(
    ("change", "most_left"), [(on_table, 0.9), (in_hand, 0.95), (with_holes, 0.98)]
)
def test_what_touches_hides_or_leaves_the_outline_open_does_not_bias_it(
    change: Callable[[DepthImage, FloatArray, np.random.Generator], DepthImage],
    most_left: float,
    rng: np.random.Generator,
) -> None:
    z, left = spoilt_by(change, rng)
    assert 0.4 < left < most_left
    assert np.mean(z**2) < 1.0 + 5.0 * np.sqrt(2.0 / len(z)), np.sort(np.abs(z))[-9:]
    assert np.mean(z**2) > 0.3
    assert abs(z.mean()) < 4.0 / np.sqrt(len(z))


def test_false_returns_all_over_the_image_are_no_outline(rng: np.random.Generator) -> None:
    z, left = spoilt_by(false_returns, rng, dropout=0.05)
    assert left > 0.2
    assert np.mean(z**2) < 1.3
