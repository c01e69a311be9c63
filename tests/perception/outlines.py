"""Outlines of a mesh seen from poses that are known, and what is measured of them.

What a run of an edge measures is its displacement by the error of the pose, so at noise that is
known ``value - jacobian @ error`` has mean zero and the stated variance, whatever is beside it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import trimesh

from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, make_transform, transform_points
from pcnav.perception.contour import ContourRuns, contour_runs
from pcnav.perception.mesh_edges import MeshEdges, mesh_edges
from pcnav.perception.pose_doubt import PoseDoubt
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.target.rendering import DepthRenderer

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
