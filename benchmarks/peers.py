"""The methods compared: pcnav and its peers, each from the same frames to poses and times.

They are the estimators that batches put to the test (`pcnav.estimators.peers`). Open3D and
small_gicp each run with their usual settings and with those that serve them better here, and the
best of all is the one that counts; both use all cores, as they would at a user's desk.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter

import numpy as np

from benchmarks.scenes import Case
from pcnav.core.arrays import FloatArray
from pcnav.estimators.interface import AxesPolicy, Estimator, FirstPose, Given
from pcnav.estimators.peers.icp import (
    START_TURN_DEG,
    Open3dIcp,
    SmallGicp,
    disturbed,
)
from pcnav.estimators.registry import ESTIMATORS, FEWER_NEIGHBOURS


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


def peer_threads() -> int:
    """Threads of Open3D and small_gicp: all cores, unless the environment says otherwise."""
    stated = os.environ.get("OMP_NUM_THREADS", "")
    return int(stated) if stated.isdecimal() and int(stated) else os.cpu_count() or 1


def followed(
    make: Callable[[Given], Estimator],
    first_pose: FirstPose,
    case: Case,
    clock: Callable[[], float] = perf_counter,
) -> Poses:
    """An estimator over all frames of a case, timed by a clock, s."""
    target, pipeline = case.scene.target, case.scene.pipeline
    given = Given(pipeline, case.info, target)
    if first_pose is FirstPose.NEAR:
        near = disturbed(case.T_cam_model[0], target.diameter_m)
        given = replace(given, T_cam_model_first=near)
    elif first_pose is FirstPose.EXACT:
        given = replace(given, T_cam_model_first=case.T_cam_model[0])
    estimator = make(given)
    count = len(case.frames)
    T_cam_model, seconds = np.full((count, 4, 4), np.nan), np.full(count, np.nan)
    for k, frame in enumerate(case.frames):
        start = clock()
        answer = estimator.step(frame)
        seconds[k] = clock() - start
        if answer.T_cam_target is not None:
            T_cam_model[k] = answer.T_cam_target
    return Poses(T_cam_model, seconds)


def _method(name: str, start: str, make: Callable[[Given], Estimator] | None = None) -> Method:
    """The estimator of a name; ``make`` replaces the way it is made."""
    entry = ESTIMATORS[name]
    estimate = partial(followed, make or entry.make, entry.first_pose)
    remembers = entry.axes is not AxesPolicy.SYMMETRY_OF_FRAME
    return Method(entry.title, start, estimate, remembers)


_NEAR = f"first pose within {START_TURN_DEG:g} deg"
_THREADS = peer_threads()
OURS = _method("pcnav", "nothing")
SINGLE_FRAME = _method("pcnav_single_frame", "nothing, every frame anew")
OPEN3D = _method("open3d_icp", _NEAR, partial(Open3dIcp, threads=_THREADS))
OPEN3D_ROBUST = _method(
    "open3d_icp_tukey", _NEAR, partial(Open3dIcp, robust=True, threads=_THREADS)
)
SMALL_GICP = _method("small_gicp", _NEAR, partial(SmallGicp, threads=_THREADS))
SMALL_GICP_LOCAL = _method(
    "small_gicp_10",
    _NEAR,
    partial(SmallGicp, neighbours=FEWER_NEIGHBOURS, threads=_THREADS),
)
KISS_ICP = _method("kiss_icp", "first pose exact")
METHODS = (OURS, SINGLE_FRAME, OPEN3D, OPEN3D_ROBUST, SMALL_GICP, SMALL_GICP_LOCAL, KISS_ICP)
"""Ours first."""
ICP_PEERS = (OPEN3D, OPEN3D_ROBUST, SMALL_GICP, SMALL_GICP_LOCAL)
"""Those that align to the model: the best of them is what pcnav has to beat."""
