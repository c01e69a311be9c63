"""Peers that know the target: its surface as points, aligned with the returns of every frame.

The mesh is 20,000 points sampled from it. Every frame starts at the pose extrapolated from the
last two. Samples that face away from the camera there are left out: returns would be matched to
the back of a thin panel, which triples the error. None of them can start cold, so they are given
the first pose, true but for `START_TURN_DEG` and `START_SHIFT_FRACTION`.
"""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from pcnav.core._extras import small_gicp
from pcnav.core._open3d import open3d
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, invert_transform, make_transform, nearest_orthogonal
from pcnav.estimators.interface import Given
from pcnav.estimators.peers.baseline import Baseline
from pcnav.perception.returns import returns_of
from pcnav.recordings.sequence import Frame
from pcnav.target.satellite import Target

SAMPLES = 20_000
START_TURN_DEG = 5.0
START_SHIFT_FRACTION = 0.01
"""Of the target's diameter: 0.1 m for one of 10 m."""
NEIGHBOURS = 20
"""Points that a covariance is estimated from: small_gicp's default."""
_FIRST_REACH = 0.05
_REACH = 0.02
"""Largest distance of corresponding points over the diameter, in the first frame and later ones."""
_MAX_ITERATIONS = 50
_MIN_POINTS = 50
"""Fewer returns than this tell no pose, and too few no covariance."""
_TUKEY_SIGMA = 2.0
"""Residual beyond which the robust ICP gives a return no weight, in deviations of the range noise.

Of 2, 3 and 5 the one with the smallest median position error in every case of the benchmark.
"""


@dataclass(frozen=True)
class Samples:
    """Points of the mesh, model frame."""

    points: FloatArray
    """(n, 3) m"""
    normals: FloatArray
    """(n, 3) outward."""

    @staticmethod
    def of(target: Target) -> "Samples":
        """Points spread evenly over the mesh with the normals of their faces."""
        points, faces = trimesh.sample.sample_surface(target.mesh, SAMPLES, seed=0)[:2]
        return Samples(np.array(points), np.array(target.mesh.face_normals[faces]))

    def facing(self, p_model_cam: FloatArray) -> "Samples":
        """Those whose side of the surface a camera at (3,) could see."""
        facing = np.einsum("ij,ij->i", self.normals, p_model_cam - self.points) > 0.0
        return Samples(self.points[facing], self.normals[facing])


class ModelAlignment(Baseline):
    """Aligns frame after frame to the model, from a constant-velocity prediction."""

    def __init__(self, given: Given) -> None:
        self._diameter_m = given.target.diameter_m
        self._samples = Samples.of(given.target)
        self._before = self._previous = given.first_pose
        self._frames = 0

    def pose(self, frame: Frame) -> FloatArray | None:
        """None where fewer than 50 points came back, or none of them is near the model."""
        # What the first frame corrects is the disturbance: it says nothing of the motion.
        moving = self._frames > 1
        predicted = repeated_step(self._before, self._previous) if moving else self._previous
        T_model_cam = invert_transform(predicted)
        reach_m = (_REACH if self._frames > 0 else _FIRST_REACH) * self._diameter_m
        facing = self._samples.facing(T_model_cam[:3, 3])
        cloud = returns_of(frame)
        aligned = None
        if min(len(cloud), len(facing.points)) >= _MIN_POINTS:
            aligned = self.align(cloud, facing, T_model_cam, reach_m)
        found = None if aligned is None else invert_transform(aligned)
        self._before = self._previous
        self._previous = predicted if found is None else found
        self._frames += 1
        return found

    @abstractmethod
    def align(
        self, cloud: FloatArray, model: Samples, T_model_cam: FloatArray, reach_m: float
    ) -> FloatArray | None:
        """(4, 4) T_model_cam from a predicted one; None where no point has a partner.

        Args:
            cloud: (n, 3) returns, camera frame, m.
            model: the samples that face the camera.
            T_model_cam: (4, 4) predicted.
            reach_m: largest distance of corresponding points.
        """


class Open3dIcp(ModelAlignment):
    """Open3D's point-to-plane ICP; the model's normals are those of the mesh."""

    def __init__(self, given: Given, *, robust: bool = False, threads: int = 1) -> None:
        """``robust`` weighs residuals as Tukey does, at the range noise that pcnav is told too.

        ``threads`` holds for all of Open3D in this process. More than one add up in another order
        each time.
        """
        super().__init__(given)
        self._library = open3d()
        registration = self._library.pipelines.registration
        width_m = _TUKEY_SIGMA * given.range_sigma_m
        loss = registration.TukeyLoss(k=width_m) if robust else registration.L2Loss()
        self._estimation = registration.TransformationEstimationPointToPlane(loss)
        self._criteria = registration.ICPConvergenceCriteria(1e-7, 1e-7, _MAX_ITERATIONS)
        self._threads = threads

    def align(
        self, cloud: FloatArray, model: Samples, T_model_cam: FloatArray, reach_m: float
    ) -> FloatArray | None:
        library = self._library
        library.utility.set_max_threads(self._threads)
        faced = self._cloud(model.points)
        faced.normals = library.utility.Vector3dVector(model.normals)
        result = library.pipelines.registration.registration_icp(
            self._cloud(cloud), faced, reach_m, T_model_cam, self._estimation, self._criteria
        )
        return np.array(result.transformation) if result.fitness > 0.0 else None

    def _cloud(self, points: FloatArray) -> Any:
        vectors = self._library.utility.Vector3dVector(points)
        return self._library.geometry.PointCloud(vectors)


class SmallGicp(ModelAlignment):
    """small_gicp's GICP with its own settings; tighter convergence criteria change little.

    Raises `InputError` where the extra `peers`, which brings it, is not installed.
    """

    def __init__(self, given: Given, *, neighbours: int = NEIGHBOURS, threads: int = 1) -> None:
        """``neighbours``: points that each covariance is estimated from."""
        super().__init__(given)
        self._library = small_gicp("the estimator small_gicp")
        self._neighbours, self._threads = neighbours, threads

    def align(
        self, cloud: FloatArray, model: Samples, T_model_cam: FloatArray, reach_m: float
    ) -> FloatArray | None:
        library, threads = self._library, self._threads
        prepared = []
        for points in (model.points, cloud):
            shape = library.PointCloud(points)
            tree = library.KdTree(shape, num_threads=threads)
            library.estimate_covariances(shape, tree, self._neighbours, num_threads=threads)
            prepared.append((shape, tree))
        (target, tree), (source, _) = prepared
        result = library.align(
            target,
            source,
            tree,
            T_model_cam,
            registration_type="GICP",
            max_correspondence_distance=reach_m,
            num_threads=threads,
            max_iterations=_MAX_ITERATIONS,
        )
        return np.array(result.T_target_source) if result.num_inliers > 0 else None


def disturbed(T_cam_model: FloatArray, diameter_m: float) -> FloatArray:
    """A pose (4, 4) turned and shifted off the truth, along fixed skew directions."""
    axis, direction = np.array([1.0, -2.0, 2.0]) / 3.0, np.array([2.0, 1.0, -2.0]) / 3.0
    turn = exp_rotation(np.deg2rad(START_TURN_DEG) * axis)
    return T_cam_model @ make_transform(turn, START_SHIFT_FRACTION * diameter_m * direction)


def repeated_step(T_before: FloatArray, T_now: FloatArray) -> FloatArray:
    """The next pose when the last step between two (4, 4) is made once more."""
    T_next = T_now @ invert_transform(T_before) @ T_now
    # Products of products: rounding errors of the rotation would double with every frame.
    T_next[:3, :3] = nearest_orthogonal(T_next[:3, :3])
    return T_next
