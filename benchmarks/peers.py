"""The methods compared: pcnav and its peers, each from the same frames to poses and times.

Point-cloud peers know the mesh as 20,000 points sampled from it and start every frame at the pose
extrapolated from their own last two. They have no cold start, so they are given the first pose,
true but for `START_TURN_DEG` and `START_SHIFT_M`.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np
import small_gicp
import trimesh

from benchmarks.scenes import Case
from pcnav._open3d import open3d
from pcnav.arrays import FloatArray
from pcnav.perception.odometry import follow
from pcnav.perception.returns import window_of_returns
from pcnav.sequences.sequence import Frame
from pcnav.spatial import exp_rotation, invert_transform, make_transform
from pcnav.target import Target
from pcnav.tracking import Tracker

SAMPLES = 20_000
START_TURN_DEG = 5.0
START_SHIFT_FRACTION = 0.01
"""Of the target's diameter: 0.1 m for one of 10 m."""
_FIRST_REACH = 0.05
_REACH = 0.02
"""Largest distance of corresponding points over the diameter, in the first frame and later ones."""
_MOST_ITERATIONS = 50
_NEIGHBOURS = 10


@dataclass(frozen=True)
class Poses:
    """What a method says of a case."""

    T_cam_model: FloatArray
    """(n, 4, 4), nan where it says nothing."""
    seconds: FloatArray
    """(n,) time on each frame, from the depth image in memory to the pose."""


@dataclass(frozen=True)
class Method:
    """One way from frames to poses."""

    name: str
    start: str
    """What it is given to begin with."""
    estimate: Callable[[Case], Poses]


def pcnav_filtered(case: Case) -> Poses:
    """The tracker as `pcnav run` uses it."""
    pipeline = case.scene.pipeline
    tracker = Tracker(
        case.scene.target, case.info, pipeline.perception, pipeline.filter, pipeline.seed
    )
    T_cam_model, seconds = _empty(len(case.frames))
    for k, frame in enumerate(case.frames):
        start = perf_counter()
        estimate, _ = tracker.step(frame)
        seconds[k] = perf_counter() - start
        if estimate.T_cam_model is not None:
            T_cam_model[k] = estimate.T_cam_model
    return Poses(T_cam_model, seconds)


def open3d_plane_icp(case: Case) -> Poses:
    """Open3D's point-to-plane ICP; the model's normals are those of the mesh."""
    registration = open3d.pipelines.registration
    points, normals = _sampled(case.scene.target)
    model = _open3d_cloud(points)
    model.normals = open3d.utility.Vector3dVector(normals)
    estimation = registration.TransformationEstimationPointToPlane()
    criteria = registration.ICPConvergenceCriteria(1e-7, 1e-7, _MOST_ITERATIONS)

    def align(frame: Frame, T_model_cam: FloatArray, reach_m: float) -> FloatArray:
        cloud = _open3d_cloud(_returns(frame))
        result = registration.registration_icp(
            cloud, model, reach_m, T_model_cam, estimation, criteria
        )
        return np.array(result.transformation)

    return _tracked(case, align)


def small_gicp_gicp(case: Case) -> Poses:
    """small_gicp's GICP with covariances from 10 neighbours, on all cores."""
    threads = os.cpu_count() or 1
    model = small_gicp.PointCloud(_sampled(case.scene.target)[0])
    tree = small_gicp.KdTree(model, num_threads=threads)
    small_gicp.estimate_covariances(model, tree, _NEIGHBOURS, num_threads=threads)

    def align(frame: Frame, T_model_cam: FloatArray, reach_m: float) -> FloatArray:
        cloud = small_gicp.PointCloud(_returns(frame))
        own = small_gicp.KdTree(cloud, num_threads=threads)
        small_gicp.estimate_covariances(cloud, own, _NEIGHBOURS, num_threads=threads)
        result = small_gicp.align(
            model,
            cloud,
            tree,
            T_model_cam,
            registration_type="GICP",
            max_correspondence_distance=reach_m,
            num_threads=threads,
            max_iterations=_MOST_ITERATIONS,
        )
        return np.array(result.T_target_source)

    return _tracked(case, align)


def kiss_icp(case: Case) -> Poses:
    """KISS-ICP, which has no model: its motion is carried on from the true first pose."""
    T_cam_model, seconds = _empty(len(case.frames))
    for k, step in enumerate(follow(case.frames, case.scene.target.diameter_m)):
        seconds[k] = step.duration_s
        if step.T_now_first is not None:
            T_cam_model[k] = step.T_now_first @ case.T_cam_model[0]
    return Poses(T_cam_model, seconds)


OURS = Method("pcnav filtered", "nothing", pcnav_filtered)
_NEAR = f"first pose within {START_TURN_DEG:g} deg"
METHODS = (
    OURS,
    Method("Open3D point-to-plane ICP", _NEAR, open3d_plane_icp),
    Method("small_gicp GICP", _NEAR, small_gicp_gicp),
    Method("KISS-ICP (no model)", "first pose exact", kiss_icp),
)
"""Ours first; a further method is one more line here."""

_Align = Callable[[Frame, FloatArray, float], FloatArray]


def _tracked(case: Case, align: _Align) -> Poses:
    """Align frame after frame to the model, from a constant-velocity prediction.

    ``align`` takes a frame, the predicted T_model_cam and the largest distance of correspondence.
    """
    diameter = case.scene.target.diameter_m
    T_cam_model, seconds = _empty(len(case.frames))
    before = previous = _disturbed(case.T_cam_model[0], diameter)
    for k, frame in enumerate(case.frames):
        start = perf_counter()
        # The last step is repeated in the model frame: the target turns about itself.
        predicted = previous @ invert_transform(before) @ previous if k > 1 else previous
        reach_m = (_REACH if k > 0 else _FIRST_REACH) * diameter
        pose = invert_transform(align(frame, invert_transform(predicted), reach_m))
        seconds[k] = perf_counter() - start
        before, previous = previous, pose
        T_cam_model[k] = pose
    return Poses(T_cam_model, seconds)


def _disturbed(T_cam_model: FloatArray, diameter_m: float) -> FloatArray:
    """A pose turned and shifted off the truth, along fixed skew directions."""
    axis, direction = np.array([1.0, -2.0, 2.0]) / 3.0, np.array([2.0, 1.0, -2.0]) / 3.0
    turn = exp_rotation(np.deg2rad(START_TURN_DEG) * axis)
    return T_cam_model @ make_transform(turn, START_SHIFT_FRACTION * diameter_m * direction)


def _sampled(target: Target) -> tuple[FloatArray, FloatArray]:
    """(n, 3) points spread evenly over the mesh and (n, 3) normals of their faces."""
    points, faces = trimesh.sample.sample_surface(target.mesh, SAMPLES, seed=0)[:2]
    return np.array(points), np.array(target.mesh.face_normals[faces])


def _open3d_cloud(points: FloatArray) -> open3d.geometry.PointCloud:
    return open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))


def _returns(frame: Frame) -> FloatArray:
    """(n, 3) points in the camera frame, m."""
    window = window_of_returns(frame)
    if window is None:
        return np.empty((0, 3))
    seen = window.has_return
    return np.asarray(window.rays[seen] * window.range_m[seen, None])


def _empty(count: int) -> tuple[FloatArray, FloatArray]:
    return np.full((count, 4, 4), np.nan), np.full(count, np.nan)
