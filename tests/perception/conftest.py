"""A camera, satellites and a noisy depth sensor for the tests of perception."""

from collections.abc import Callable

import numpy as np
import pytest
import trimesh

from pcnav.core.arrays import DepthImage, FloatArray
from pcnav.core.camera import PinholeCamera, range_per_depth
from pcnav.core.spatial import make_transform
from pcnav.recordings.sequence import Frame
from pcnav.target.rendering import DepthRenderer, RenderedDepth

Shoot = Callable[..., tuple[Frame, RenderedDepth]]


@pytest.fixture(scope="session")
def shoot(camera: PinholeCamera) -> Shoot:
    """Takes a frame of a mesh at a pose, with noise along the ray; also gives the clean view."""

    def take(
        mesh: trimesh.Trimesh, T_cam_model: FloatArray, sigma_m: float = 0.0, seed: int = 0
    ) -> tuple[Frame, RenderedDepth]:
        rendered = DepthRenderer(mesh, camera).render(T_cam_model)
        noise = np.random.default_rng(seed).normal(0.0, 1.0, rendered.depth_m.shape)
        depth = rendered.depth_m + sigma_m * noise / range_per_depth(camera)
        depth_m: DepthImage = np.zeros_like(rendered.depth_m)
        seen = rendered.depth_m > 0.0
        depth_m[seen] = depth[seen]
        return Frame(0, 0.0, depth_m, camera, np.eye(4)), rendered

    return take


@pytest.fixture(scope="session")
def panel() -> trimesh.Trimesh:
    """The 4.0 x 1.5 m panel of FINDINGS as a sheet in its own rectangle frame."""
    x, y = 0.75, 2.0
    corners = [[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]]
    return trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)


@pytest.fixture(scope="session")
def random_pose() -> Callable[..., FloatArray]:
    """Draws a pose near the optical axis at a distance in a given span."""

    def draw(rng: np.random.Generator, near_m: float = 20.0, far_m: float = 25.0) -> FloatArray:
        q = rng.normal(size=4)
        w, v = q[0] / np.linalg.norm(q), q[1:] / np.linalg.norm(q)
        cross = np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
        R = np.eye(3) + 2.0 * (w * cross + cross @ cross)
        return make_transform(R, np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(near_m, far_m)]))

    return draw
