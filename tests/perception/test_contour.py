"""Displacements of an outline against projected edges, straight lines on a grid, and known errors.

What a run of an edge measures is its displacement by the error of the pose, so at noise that is
known ``value - jacobian @ error`` has mean zero and the stated variance, whatever is beside it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
import trimesh

from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera, project
from pcnav.core.distortion import Distortion, DistortionModel
from pcnav.core.spatial import exp_rotation, make_transform, transform_points
from pcnav.perception.contour import (
    OFFSET_PX,
    ContourRuns,
    MeshEdges,
    PoseDoubt,
    contour_runs,
    grid_variances,
    mesh_edges,
)
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.target.rendering import DepthRenderer
from pcnav.target.row_motion import Readout

DrawPose = Callable[..., FloatArray]
FACING = np.diag([1.0, -1.0, -1.0])
"""Model z towards the camera."""
BOX = trimesh.creation.box((2.0, 1.5, 3.0))
SIGMA = 1e-4


def sheet(width: float, height: float, T: FloatArray | None = None) -> trimesh.Trimesh:
    """A rectangle in the plane z = 0, or moved from there."""
    x, y = 0.5 * width, 0.5 * height
    corners = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
    corners = corners if T is None else transform_points(T, corners)
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


def join(*parts: trimesh.Trimesh) -> trimesh.Trimesh:
    """One mesh of several, vertices in their order."""
    mesh = trimesh.util.concatenate(list(parts))
    assert isinstance(mesh, trimesh.Trimesh)
    return mesh


def at(x: float, y: float, z: float, rotvec: tuple[float, float, float] = (0.0, 0.0, 0.0)):
    return make_transform(exp_rotation(np.array(rotvec)), np.array([x, y, z]))


def moved(T: FloatArray, error: FloatArray) -> FloatArray:
    """A pose moved by a shift in camera axes and a turn in model axes."""
    return make_transform(T[:3, :3] @ exp_rotation(error[3:]), T[:3, 3] + error[:3])


def one_edge(edges: MeshEdges, k: int) -> MeshEdges:
    return replace(edges, ends=edges.ends[k : k + 1], wings=edges.wings[k : k + 1])


class View:
    """A mesh seen from a predicted pose, and frames of it from others."""

    def __init__(
        self, mesh: trimesh.Trimesh, camera: PinholeCamera, diameter_m: float = 10.0
    ) -> None:
        """``mesh`` may be part of a target of that diameter."""
        self.camera = camera
        self.edges = replace(mesh_edges(mesh), diameter_m=diameter_m)
        self.renderer = DepthRenderer(mesh, camera)

    def frame(self, T: FloatArray) -> DepthImage:
        return self.renderer.render(T).depth_m

    def runs(
        self,
        depth_m: DepthImage,
        T: FloatArray,
        sd: tuple[float, float] = (1e-3, 2e-4),
        dropout: float = 0.0,
        edges: MeshEdges | None = None,
    ) -> ContourRuns:
        """Of a frame against the view from T, whose shift (m) and turn (rad) are so uncertain."""
        return contour_runs(
            self.edges if edges is None else edges,
            depth_m,
            self.renderer.render(T),
            PoseDoubt(T, np.diag(np.square(np.repeat(sd, 3))), SIGMA),
            dropout,
            SensorNoise(SIGMA),
        )


def is_mean(runs: ContourRuns) -> np.ndarray:
    """(n,) which runs are shifts of a whole stretch; a tilt, over a crossing, is far less."""
    return np.asarray(np.linalg.norm(runs.jacobian[:, :3], axis=1) > 5.0)


# Edges of a mesh.


def test_edges_of_a_box_are_twelve_without_the_diagonals_of_its_faces() -> None:
    edges = mesh_edges(BOX)
    vertices = np.array(BOX.vertices)
    assert len(edges.ends) == len(np.unique(edges.ends, axis=0)) == 12
    along = vertices[edges.ends[:, 1]] - vertices[edges.ends[:, 0]]
    np.testing.assert_array_equal(np.count_nonzero(along, axis=1), 1)
    assert edges.wings.shape == (12, 2)
    faces = {frozenset(face) for face in BOX.faces.tolist()}
    for ends, wings in zip(edges.ends.tolist(), edges.wings.tolist(), strict=True):
        assert wings[0] != wings[1]
        assert {frozenset([*ends, wing]) for wing in wings} <= faces


@pytest.mark.parametrize(("fold", "expected"), [(0.0, 6), (0.3, 7)])
def test_edges_of_an_open_sheet_are_its_border_and_its_fold(fold: float, expected: int) -> None:
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, fold], [2, 1, fold]])
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]], process=False)
    ends = mesh_edges(mesh).ends.tolist()
    assert len(ends) == expected
    assert ([1, 2] in ends) is (fold > 0.0)
    assert len(mesh_edges(sheet(2.0, 1.0)).ends) == 4


def test_an_edge_of_three_faces_is_kept_with_all_its_wings() -> None:
    corners = [[0, 0, 0], [0, 1, 0], [-1, 0, 0], [1, 0, 0], [0, 0, 1]]
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [1, 0, 3], [0, 1, 4]], process=False)
    edges = mesh_edges(mesh)
    (seam,) = np.flatnonzero((edges.ends == [0, 1]).all(axis=1))
    assert set(edges.wings[seam].tolist()) == {2, 3, 4}
    assert len(edges.ends) == 7


# The measurement's derivative and variance.


def crossings(pixels: FloatArray, major: FloatArray, upright: bool) -> FloatArray:
    """Where the line through two pixels (2, 2) crosses rows (if upright) or columns."""
    (a0, a1), (b0, b1) = pixels[:, int(upright)], pixels[:, 1 - int(upright)]
    return np.asarray(b0 + (b1 - b0) * (major - a0) / (a1 - a0))


def numerical_jacobian(
    ends: FloatArray, camera: PinholeCamera, T: FloatArray
) -> tuple[FloatArray, FloatArray, int]:
    """How a pose displaces a projected edge outward: in its middle (6,), change by crossing (6,).

    And how many pixel columns or rows it crosses.
    """
    pixels = project(camera, transform_points(T, ends))
    along = np.abs(pixels[1] - pixels[0])
    upright = bool(along[1] > along[0])
    low, high = np.sort(pixels[:, int(upright)])
    major = np.arange(np.ceil(low), np.floor(high) + 1)
    inward = project(camera, T[None, :3, 3])[0]
    side = np.sign(inward[1 - int(upright)] - crossings(pixels, inward[int(upright)], upright))
    jacobian = []
    for step in 1e-6 * np.eye(6):
        ahead, behind = (
            crossings(project(camera, transform_points(moved(T, d), ends)), major, upright)
            for d in (step, -step)
        )
        jacobian.append(np.polyfit(major - major.mean(), -side * (ahead - behind) / 2e-6, 1))
    tilt, mean = np.array(jacobian).T
    return mean, tilt, len(major)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_jacobian_is_the_motion_of_the_projected_edge(
    camera: PinholeCamera, random_pose: DrawPose, seed: int
) -> None:
    view = View(BOX, camera)
    T = random_pose(np.random.default_rng(seed), 14.0, 18.0)
    frame, compared = view.frame(T), 0
    for k in range(len(view.edges.ends)):
        runs = view.runs(frame, T, edges=one_edge(view.edges, k))
        if len(runs) != 2 or is_mean(runs).tolist() != [True, False]:
            continue  # not in view, or cut into short stretches
        mean, tilt, n = numerical_jacobian(view.edges.vertices[view.edges.ends[k]], camera, T)
        np.testing.assert_allclose(runs.jacobian[1], tilt, rtol=1e-6, atol=1e-8)
        # A line stays a line: the middle of the stretch that is seen is somewhere along it.
        along = (runs.jacobian[0] - mean) @ tilt / (tilt @ tilt)
        assert abs(along) < 0.5 * n
        np.testing.assert_allclose(runs.jacobian[0], mean + along * tilt, rtol=1e-6, atol=1e-6)
        compared += 1
    assert compared >= 3


@pytest.mark.parametrize("slope", [0.0, 0.37, 0.5, 1.0])
def test_variances_on_the_grid_are_those_of_straight_edges_of_any_phase(slope: float) -> None:
    cases = [(n, d) for n in (5, 12, 41, 80) for d in (0.1, 0.3, 0.5)]
    phase = (np.arange(6000) + 0.5)[:, None] / 6000
    n, distance = (np.array(column) for column in zip(*cases, strict=True))
    mean, tilt = grid_variances(n, np.full(len(n), slope), distance)
    for k, (size, d) in enumerate(cases):
        i = np.arange(size)
        counted = np.floor(phase + i * slope + d) - np.floor(phase + i * slope) - d
        assert np.abs(counted.mean()) < 1e-3
        centred = i - i.mean()
        slopes = counted @ centred / (centred @ centred)
        # To the phases that were tried.
        assert mean[k] == pytest.approx(counted.mean(axis=1).var(), rel=0.02, abs=2e-5), cases[k]
        assert tilt[k] == pytest.approx(slopes.var(), rel=0.02, abs=1e-9), cases[k]
    further = grid_variances(n, np.full(len(n), slope), distance + 0.5)
    np.testing.assert_array_equal(
        further, grid_variances(n, np.full(len(n), slope), np.full(len(n), 0.5))
    )


# Counting.

WALL = sheet(6.0, 6.0)
MESHES = {
    "box": BOX,
    # Its rim is thinner than a pixel.
    "panel": trimesh.creation.box((1.5, 4.0, 0.03)),
    "plate": join(sheet(2.0, 2.0, at(0.0, 0.0, 1.5)), WALL),
    # The plate comes near the wall where it is extended by a pixel.
    "steep": join(sheet(2.0, 2.0, at(0.0, 0.0, 1.5, (0.0, 1.3, 0.0))), WALL),
}


@dataclass(frozen=True)
class Sample:
    """Runs of many frames: what they measured, what the known error predicts."""

    value: FloatArray
    expected: FloatArray
    variance: FloatArray
    is_mean: np.ndarray

    def check(self, most_bias: float, most_slope_error: float) -> None:
        """Unbiased in offset and scale, to bounds that are met too, and of the stated variance."""
        difference = self.value - self.expected
        for rows in (self.is_mean, ~self.is_mean):
            z = difference[rows] / np.sqrt(self.variance[rows])
            assert np.mean(z**2) < 1.0 + 5.0 * np.sqrt(2.0 / len(z)), np.sort(np.abs(z))[-9:]
            assert np.mean(z**2) > 0.3
            assert np.abs(z.mean()) < 4.0 / np.sqrt(len(z))
        d, e = difference[self.is_mean], self.expected[self.is_mean]
        bias_sd = float(d.std() / np.sqrt(len(d)))
        slope_sd = float(np.sqrt(np.sum((d * e) ** 2)) / (e @ e))
        assert bias_sd < most_bias
        assert np.abs(d.mean()) < 4.0 * bias_sd
        assert slope_sd < most_slope_error
        assert np.abs(e @ d) / (e @ e) < 4.0 * slope_sd


def sampled(
    view: View,
    draw: Callable[[np.random.Generator], FloatArray],
    sd: tuple[float, float],
    frames: int,
    change: Callable[[DepthImage, np.random.Generator], DepthImage] = lambda depth, _: depth,
    dropout: float = 0.0,
) -> Sample:
    rng = np.random.default_rng(5)
    parts = []
    for _ in range(frames):
        T = draw(rng)
        error = rng.normal(size=6) * np.repeat(sd, 3)
        frame = change(view.frame(moved(T, error)), rng)
        runs = view.runs(frame, T, sd, dropout)
        parts.append((runs.value, runs.jacobian @ error, runs.variance, is_mean(runs)))
    return Sample(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def drawing(name: str, random_pose: DrawPose) -> Callable[[np.random.Generator], FloatArray]:
    """Any attitude for bodies; a wall is seen from the front."""

    def draw(rng: np.random.Generator) -> FloatArray:
        T = random_pose(rng, 18.0, 22.0)
        if name not in ("box", "panel"):
            roll = exp_rotation(np.array([0.0, 0.0, rng.uniform(0.0, 6.3)]))
            T[:3, :3] = exp_rotation(rng.normal(0.0, 0.2, 3)) @ FACING @ roll
        return T

    return draw


@pytest.mark.parametrize("sd", [(0.003, 6e-4), (0.008, 1e-3)], ids=["sharp", "blurred"])
@pytest.mark.parametrize("name", MESHES)
def test_counts_are_the_displacement_without_bias(
    camera: PinholeCamera, random_pose: DrawPose, name: str, sd: tuple[float, float]
) -> None:
    view = View(MESHES[name], camera)
    sampled(view, drawing(name, random_pose), sd, 60).check(7e-3, 0.1)


LENSES = {
    "barrel": Distortion(DistortionModel.OPENCV, (-1.5, 3.0, 0.01, -0.01, 0.0)),
    "cushion": Distortion(DistortionModel.OPENCV, (2.0, 5.0, 0.0, 0.02, 0.0)),
}


@pytest.mark.parametrize("sd", [(0.003, 6e-4), (0.008, 1e-3)], ids=["sharp", "blurred"])
@pytest.mark.parametrize("lens", LENSES)
def test_counts_along_bent_edges_are_the_displacement_without_bias(
    camera: PinholeCamera, random_pose: DrawPose, lens: str, sd: tuple[float, float]
) -> None:
    view = View(BOX, replace(camera, distortion=LENSES[lens]))
    # Wider on the image than the bodies above: edges bend by pixels.
    sampled(view, lambda rng: random_pose(rng, 11.0, 14.0), sd, 60).check(7e-3, 0.1)


def test_counts_of_rows_read_out_in_turn_are_the_displacement_without_bias(
    camera: PinholeCamera, random_pose: DrawPose
) -> None:
    """The edges shear by pixels; what is counted is what the pose at the frame's time does."""
    view, sd = View(BOX, camera), (0.003, 6e-4)
    rng, parts = np.random.default_rng(8), []
    for _ in range(60):
        T = random_pose(rng, 18.0, 22.0)
        readout = Readout(rng.normal(size=6) * np.repeat([1.0, 0.5], 3), 0.1)
        error = rng.normal(size=6) * np.repeat(sd, 3)
        true = moved(T, error)
        frame = view.renderer.render(true, readout.poses(true, 256)).depth_m
        rendered = view.renderer.render(T, readout.poses(T, 256))
        doubt = PoseDoubt(T, np.diag(np.square(np.repeat(sd, 3))), SIGMA)
        runs = contour_runs(view.edges, frame, rendered, doubt, 0.0, SensorNoise(SIGMA))
        parts.append((runs.value, runs.jacobian @ error, runs.variance, is_mean(runs)))
    Sample(*(np.concatenate(part) for part in zip(*parts, strict=True))).check(7e-3, 0.1)


def test_edges_through_a_lens_that_hardly_bends_are_those_of_a_pinhole(
    camera: PinholeCamera,
) -> None:
    T = make_transform(exp_rotation(np.array([0.2, 0.3, 0.2])) @ FACING, np.array([0, 0, 20.0]))
    straight = View(sheet(2.0, 2.0), camera)
    expected = straight.runs(straight.frame(T), T)
    lens = Distortion(DistortionModel.OPENCV, (-1e-9, 0.0, 0.0, 0.0, 0.0))
    view = View(sheet(2.0, 2.0), replace(camera, distortion=lens))
    runs = view.runs(view.frame(T), T)
    np.testing.assert_allclose(runs.jacobian, expected.jacobian, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(runs.value, expected.value, atol=1e-6)
    np.testing.assert_allclose(runs.variance, expected.variance, rtol=0.3)


@pytest.mark.parametrize("name", ["box", "plate"])
def test_lost_returns_make_noise_and_no_bias(
    camera: PinholeCamera, random_pose: DrawPose, name: str
) -> None:
    def drop(depth_m: DepthImage, rng: np.random.Generator) -> DepthImage:
        return np.where(rng.random(depth_m.shape) < 0.3, np.float32(0.0), depth_m)

    view = View(MESHES[name], camera)
    draw = drawing(name, random_pose)
    sampled(view, draw, (0.01, 2e-3), 60, drop, 0.3).check(0.012, 0.05)


def test_what_hides_a_part_of_the_outline_says_nothing_of_it(
    camera: PinholeCamera, random_pose: DrawPose
) -> None:
    def hide(depth_m: DepthImage, rng: np.random.Generator) -> DepthImage:
        u, v = rng.integers(90, 130, 2)
        depth_m = depth_m.copy()
        depth_m[v : v + 40, u : u + 40] = 9.0
        return depth_m

    view = View(BOX, camera)
    draw = drawing("box", random_pose)
    hidden = sampled(view, draw, (0.01, 2e-3), 60, hide)
    hidden.check(7e-3, 0.1)
    assert hidden.is_mean.sum() > 150


def test_lone_outliers_leave_an_edge_whole(camera: PinholeCamera) -> None:
    view = View(sheet(2.0, 2.0), camera)
    T = make_transform(exp_rotation(np.array([0.2, 0.3, 0.2])) @ FACING, np.array([0, 0, 20.0]))
    clean = view.frame(T)
    rng = np.random.default_rng(0)
    spoilt = np.where((clean > 0.0) & (rng.random(clean.shape) < 0.05), np.float32(25.0), clean)
    runs, expected = view.runs(spoilt, T), view.runs(clean, T)
    np.testing.assert_array_equal(runs.jacobian, expected.jacobian)
    z = (runs.value - expected.value) / np.sqrt(expected.variance)
    assert np.all(np.abs(z) < 2.5)


def test_comparison_can_be_repeated(camera: PinholeCamera, random_pose: DrawPose) -> None:
    view = View(BOX, camera)
    T = random_pose(np.random.default_rng(3))
    frame = view.frame(moved(T, np.full(6, 1e-3)))
    first, second = view.runs(frame, T), view.runs(frame, T)
    np.testing.assert_array_equal(first.value, second.value)
    # Where the view is exact, the count at the line beside an edge still is whole pixels.
    exact = view.runs(view.frame(T), T)
    assert np.abs(exact.value).max() > 0.1 * OFFSET_PX


def test_outline_that_is_further_off_than_any_doubt_is_not_that_of_the_mesh(
    camera: PinholeCamera,
) -> None:
    view = View(sheet(2.0, 2.0), camera)
    T = make_transform(exp_rotation(np.array([0.1, 0.1, 0.2])) @ FACING, np.array([0, 0, 20.0]))
    off = np.array([0.15, 0.15, 0.0, 0.0, 0.0, 0.0])  # four pixels
    assert len(view.runs(view.frame(T), T)) == 8
    runs = view.runs(view.frame(moved(T, off)), T)
    assert not is_mean(runs).any()


# Edges that show nothing.


def test_edges_hidden_behind_another_part_give_no_sample(camera: PinholeCamera) -> None:
    small, large = sheet(1.0, 1.0), sheet(3.0, 3.0, at(0.0, 0.0, 2.0))
    T = make_transform(exp_rotation(np.array([0.1, -0.2, 0.3])) @ FACING, np.array([0, 0, 20.0]))
    alone, both = View(small, camera), View(join(small, large), camera)
    frame = both.frame(T)
    for k in range(4):
        assert len(alone.runs(alone.frame(T), T, edges=one_edge(alone.edges, k))) == 2
        assert len(both.runs(frame, T, edges=one_edge(both.edges, k))) == 0
        assert len(both.runs(frame, T, edges=one_edge(both.edges, 4 + k))) == 2


def test_half_hidden_edges_are_measured_where_they_are_seen(camera: PinholeCamera) -> None:
    lower, upper = sheet(3.0, 3.0), sheet(1.5, 6.0, at(0.0, 0.0, 2.0))
    view, alone = View(join(lower, upper), camera), View(lower, camera)
    T = make_transform(exp_rotation(np.array([0.0, 0.0, 0.1])) @ FACING, np.array([0, 0, 20.0]))
    error = np.array([1e-3, -1e-3, 5e-4, 1e-4, 2e-4, -1e-4])
    frame = view.frame(moved(T, error))
    for k in range(4):
        runs = view.runs(frame, T, edges=one_edge(view.edges, k))
        whole = alone.runs(alone.frame(T), T, edges=one_edge(alone.edges, k))
        # The strip lies across two of the edges and cuts them in two.
        assert len(runs) in (2, 4)
        assert np.all(np.abs(runs.value - runs.jacobian @ error) < 3.0 * np.sqrt(runs.variance))
        assert len(whole) == 2
        if len(runs) == 4:
            turns = np.sort(runs.jacobian[:2, 5])
            assert turns[0] < whole.jacobian[0, 5] < turns[1]
    assert sum(len(view.runs(frame, T, edges=one_edge(view.edges, k))) for k in range(4)) == 12


def test_border_of_the_image_is_no_outline(camera: PinholeCamera, random_pose: DrawPose) -> None:
    filling = View(sheet(50.0, 50.0), camera)
    T = make_transform(FACING, np.array([0.0, 0.0, 20.0]))
    assert (filling.frame(T) > 0.0).all()
    assert len(filling.runs(filling.frame(T), T)) == 0

    # Cut by the right border: its right edge is out of view, and the others are cut.
    cut = View(sheet(4.0, 4.0), camera)
    T = make_transform(exp_rotation(np.array([0.0, 0.0, 0.1])) @ FACING, np.array([4.0, 0, 20.0]))
    seen = [len(cut.runs(cut.frame(T), T, edges=one_edge(cut.edges, k))) for k in range(4)]
    assert sorted(seen) == [0, 2, 2, 2]

    def draw(rng: np.random.Generator) -> FloatArray:
        T = random_pose(rng, 18.0, 22.0)
        T[:2, 3] = 4.3 * np.sign(T[:2, 3])
        return T

    sampled(View(BOX, camera), draw, (0.01, 2e-3), 60).check(0.01, 0.05)


def test_edges_behind_the_camera_give_no_sample(camera: PinholeCamera) -> None:
    front = View(BOX, camera)
    behind = BOX.copy()
    behind.apply_translation([0.0, 0.0, 36.0])
    both = View(join(BOX, behind), camera)
    T = make_transform(exp_rotation(np.array([0.1, -0.2, 0.3])) @ FACING, np.array([0, 0, 18.0]))
    frame = front.frame(T)
    np.testing.assert_array_equal(both.frame(T), frame)
    for k in range(24):
        runs = both.runs(frame, T, edges=one_edge(both.edges, k))
        if k >= 12:
            assert len(runs) == 0
        else:
            alone = front.runs(frame, T, edges=one_edge(front.edges, k))
            np.testing.assert_allclose(runs.value, alone.value, atol=1e-12)

    # A beam that passes the camera: what its long edges project to is no line in the image.
    beam = View(trimesh.creation.box((1.0, 1.0, 60.0)), camera)
    T = make_transform(np.eye(3), np.array([3.0, 0.4, 5.0]))
    frame = beam.frame(T)
    assert (frame > 0.0).any()
    for k in range(12):
        if np.ptp(beam.edges.vertices[beam.edges.ends[k], 2]) > 0.0:
            assert len(beam.runs(frame, T, edges=one_edge(beam.edges, k))) == 0


def test_target_out_of_view_has_no_outline(camera: PinholeCamera) -> None:
    view = View(BOX, camera)
    for position in ([60.0, 0.0, 20.0], [0.0, 0.0, -20.0]):
        T = make_transform(np.eye(3), np.array(position))
        runs = view.runs(view.frame(T), T)
        assert len(runs) == 0
        assert runs.jacobian.shape == (0, 6)


@pytest.mark.parametrize("size", [256, 257])
def test_faces_that_are_edge_on_raise_no_warning(size: int) -> None:
    # With a pixel on the optical axis, rays lie in the planes of a box that is seen straight.
    camera = PinholeCamera.from_field_of_view(size, size, np.deg2rad(25.0))
    view = View(BOX, camera)
    for x in (0.0, 1.0, -1.0):
        for y in (0.0, 0.75):
            T = make_transform(np.eye(3), np.array([x, y, 20.0]))
            runs = view.runs(view.frame(T), T)
            assert len(runs) >= 4
            assert np.isfinite(runs.value).all()
