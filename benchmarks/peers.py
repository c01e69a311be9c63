"""The methods compared: pcnav and its peers, each from the same frames to poses and times.

Point-cloud peers know the mesh as 20,000 points sampled from it and start every frame at the pose
extrapolated from their own last two. Samples that face away from the camera there are left out:
returns would be matched to the back of a thin panel, which triples the error. The peers have no
cold start, so they are given the first pose, true but for `START_TURN_DEG` and
`START_SHIFT_FRACTION`. Open3D and small_gicp each run with their usual settings and with those that
serve them better here, and the best of all is the one that counts.
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
from pcnav.estimation.single_frame import single_frame_pose
from pcnav.perception.odometry import follow
from pcnav.perception.reading import FrameReader
from pcnav.perception.returns import window_of_returns
from pcnav.sequences.poses import nearest_rotation
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
_FEWER_NEIGHBOURS, _NEIGHBOURS = 10, 20
"""Points that a covariance is estimated from: small_gicp's default, and half of it, which gives
smaller position errors in most cases and larger ones of attitude."""
_TUKEY_SIGMA = 2.0
"""Residual beyond which the robust ICP gives a return no weight, in deviations of the range noise.

Of 2, 3 and 5 the one with the smallest median position error in every case.
"""


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
    remembers: bool = True
    """Whether a pose follows from earlier ones: then a symmetric target must keep one attitude."""


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


def pcnav_single_frame(case: Case) -> Poses:
    """Every frame on its own, without prediction or memory."""
    pipeline = case.scene.pipeline
    reader = FrameReader(
        case.scene.target, pipeline.perception, _range_sigma_m(case), pipeline.seed
    )
    T_cam_model, seconds = _empty(len(case.frames))
    for k, frame in enumerate(case.frames):
        start = perf_counter()
        pose = single_frame_pose(frame, reader)
        seconds[k] = perf_counter() - start
        if pose is not None:
            T_cam_model[k] = pose.T_cam_model
    return Poses(T_cam_model, seconds)


def open3d_plane_icp(case: Case) -> Poses:
    """Open3D's point-to-plane ICP; the model's normals are those of the mesh."""
    return _open3d_icp(case, open3d.pipelines.registration.L2Loss())


def open3d_robust_icp(case: Case) -> Poses:
    """The same with Tukey's weights, at the range noise that pcnav is told too."""
    width_m = _TUKEY_SIGMA * _range_sigma_m(case)
    return _open3d_icp(case, open3d.pipelines.registration.TukeyLoss(k=width_m))


def _open3d_icp(case: Case, kernel: open3d.pipelines.registration.RobustKernel) -> Poses:
    registration = open3d.pipelines.registration
    estimation = registration.TransformationEstimationPointToPlane(kernel)
    criteria = registration.ICPConvergenceCriteria(1e-7, 1e-7, _MOST_ITERATIONS)

    def align(cloud: FloatArray, model: _Samples, start: FloatArray, reach_m: float) -> FloatArray:
        faced = _open3d_cloud(model.points)
        faced.normals = open3d.utility.Vector3dVector(model.normals)
        result = registration.registration_icp(
            _open3d_cloud(cloud), faced, reach_m, start, estimation, criteria
        )
        return np.array(result.transformation)

    return _tracked(case, align)


def small_gicp_gicp(case: Case) -> Poses:
    """small_gicp's GICP with its own settings; tighter convergence criteria change little."""
    return _gicp(case, _NEIGHBOURS)


def small_gicp_local(case: Case) -> Poses:
    """The same with covariances of smaller neighbourhoods."""
    return _gicp(case, _FEWER_NEIGHBOURS)


def _gicp(case: Case, neighbours: int) -> Poses:
    threads = peer_threads()

    def prepared(points: FloatArray) -> tuple[small_gicp.PointCloud, small_gicp.KdTree]:
        cloud = small_gicp.PointCloud(points)
        tree = small_gicp.KdTree(cloud, num_threads=threads)
        small_gicp.estimate_covariances(cloud, tree, neighbours, num_threads=threads)
        return cloud, tree

    def align(cloud: FloatArray, model: _Samples, start: FloatArray, reach_m: float) -> FloatArray:
        target, tree = prepared(model.points)
        result = small_gicp.align(
            target,
            prepared(cloud)[0],
            tree,
            start,
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


_NEAR = f"first pose within {START_TURN_DEG:g} deg"
OURS = Method("pcnav filtered", "nothing", pcnav_filtered)
SINGLE_FRAME = Method(
    "pcnav single frame", "nothing, every frame anew", pcnav_single_frame, remembers=False
)
OPEN3D = Method("Open3D point-to-plane", _NEAR, open3d_plane_icp)
OPEN3D_ROBUST = Method("Open3D, Tukey weights", _NEAR, open3d_robust_icp)
SMALL_GICP = Method("small_gicp", _NEAR, small_gicp_gicp)
SMALL_GICP_LOCAL = Method(f"small_gicp, {_FEWER_NEIGHBOURS} neighbours", _NEAR, small_gicp_local)
KISS_ICP = Method("KISS-ICP (no model)", "first pose exact", kiss_icp)
METHODS = (OURS, SINGLE_FRAME, OPEN3D, OPEN3D_ROBUST, SMALL_GICP, SMALL_GICP_LOCAL, KISS_ICP)
"""Ours first."""
ICP_PEERS = (OPEN3D, OPEN3D_ROBUST, SMALL_GICP, SMALL_GICP_LOCAL)
"""Those that align to the model: the best of them is what pcnav has to beat."""


def peer_threads() -> int:
    """Threads of Open3D and small_gicp: all cores, unless the environment says otherwise."""
    stated = os.environ.get("OMP_NUM_THREADS", "")
    return int(stated) if stated.isdecimal() and int(stated) else os.cpu_count() or 1


@dataclass(frozen=True)
class _Samples:
    """Points of the mesh, model frame."""

    points: FloatArray
    """(n, 3) m"""
    normals: FloatArray
    """(n, 3) outward."""

    def facing(self, p_model_cam: FloatArray) -> "_Samples":
        """Those whose side of the surface a camera at (3,) could see."""
        facing = np.einsum("ij,ij->i", self.normals, p_model_cam - self.points) > 0.0
        return _Samples(self.points[facing], self.normals[facing])


_Align = Callable[[FloatArray, _Samples, FloatArray, float], FloatArray]
"""From a cloud (n, 3), the samples facing it, the predicted T_model_cam and the largest distance of
corresponding points, m, to T_model_cam."""


def _tracked(case: Case, align: _Align) -> Poses:
    """Align frame after frame to the model, from a constant-velocity prediction."""
    diameter = case.scene.target.diameter_m
    samples = _sampled(case.scene.target)
    T_cam_model, seconds = _empty(len(case.frames))
    before = previous = _disturbed(case.T_cam_model[0], diameter)
    for k, frame in enumerate(case.frames):
        start = perf_counter()
        # What the first frame corrects is the disturbance: it says nothing of the motion.
        predicted = _repeated_step(before, previous) if k > 1 else previous
        T_model_cam = invert_transform(predicted)
        reach_m = (_REACH if k > 0 else _FIRST_REACH) * diameter
        facing = samples.facing(T_model_cam[:3, 3])
        pose = invert_transform(align(_returns(frame), facing, T_model_cam, reach_m))
        seconds[k] = perf_counter() - start
        before, previous = previous, pose
        T_cam_model[k] = pose
    return Poses(T_cam_model, seconds)


def _repeated_step(T_before: FloatArray, T_now: FloatArray) -> FloatArray:
    """The next pose when the last step between two is made once more."""
    T_next = T_now @ invert_transform(T_before) @ T_now
    # Products of products: rounding errors of the rotation would double with every frame.
    T_next[:3, :3] = nearest_rotation(T_next[:3, :3])
    return T_next


def _disturbed(T_cam_model: FloatArray, diameter_m: float) -> FloatArray:
    """A pose turned and shifted off the truth, along fixed skew directions."""
    axis, direction = np.array([1.0, -2.0, 2.0]) / 3.0, np.array([2.0, 1.0, -2.0]) / 3.0
    turn = exp_rotation(np.deg2rad(START_TURN_DEG) * axis)
    return T_cam_model @ make_transform(turn, START_SHIFT_FRACTION * diameter_m * direction)


def _sampled(target: Target) -> _Samples:
    """Points spread evenly over the mesh with the normals of their faces."""
    points, faces = trimesh.sample.sample_surface(target.mesh, SAMPLES, seed=0)[:2]
    return _Samples(np.array(points), np.array(target.mesh.face_normals[faces]))


def _range_sigma_m(case: Case) -> float:
    """Noise along the ray as pcnav is told it."""
    return case.scene.pipeline.perception.range_sigma_m or case.info.range_sigma_m


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
