"""The pose of the camera from a bag's tree of transforms (/tf and /tf_static)."""

from bisect import bisect_left
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import invert_transform, make_transform
from pcnav.recordings.timed_poses import TimedPoses, interpolated

_MAX_DEPTH = 64
_MAX_KEPT = 1000
"""Transforms of one frame that are kept in any case."""


@dataclass
class _Edge:
    parent: str
    is_static: bool
    time_s: list[float] = field(default_factory=list)
    rows: list[list[float]] = field(default_factory=list)


class TransformTree:
    """Takes in transforms as they come."""

    def __init__(self) -> None:
        self._edges: dict[str, _Edge] = {}

    def add(self, message: Any, is_static: bool, origin_s: int) -> None:
        """Those of a TFMessage; times are counted from a whole second.

        Raises `ValueError` for a transform that is none.
        """
        for each in message.transforms:
            child, parent = _frame(each.child_frame_id), _frame(each.header.frame_id)
            edge = self._edges.get(child)
            if edge is None or edge.parent != parent:
                # A frame that changes its parent is followed from the last change on.
                edge = self._edges[child] = _Edge(parent, is_static)
            p, q = each.transform.translation, each.transform.rotation
            row = [float(x) for x in (p.x, p.y, p.z, q.x, q.y, q.z, q.w)]
            if not np.isfinite(row).all() or abs(np.linalg.norm(row[3:]) - 1.0) > 1e-2:
                raise ValueError(f"expected a transform of {child} with a unit quaternion")
            stamp = each.header.stamp
            edge.time_s.append(int(stamp.sec) - origin_s + int(stamp.nanosec) * 1e-9)
            edge.rows.append(row)

    def forget(self, before_s: float) -> None:
        """Drop most of what was before a time: of a stream nobody asks for it any more."""
        for edge in self._edges.values():
            if len(edge.time_s) > _MAX_KEPT:
                # One before the time is needed to tell what was then; one static one is enough.
                kept = (
                    len(edge.time_s) - 1 if edge.is_static else bisect_left(edge.time_s, before_s)
                )
                first = max(kept - 1, 0)
                del edge.time_s[:first], edge.rows[:first]

    def camera_poses(self, frame: str, time_s: FloatArray) -> tuple[str, FloatArray] | None:
        """The frame at the root above a camera's, and (n, 4, 4) T_root_cam at times (n,).

        nan where a moving transform is not known; None where the tree does not hold the camera.
        """
        child, T = _frame(frame), np.tile(np.eye(4), (len(time_s), 1, 1))
        if child not in self._edges:
            return None
        for _ in range(_MAX_DEPTH):
            edge = self._edges.get(child)
            if edge is None:
                break
            T = _along(edge, time_s) @ T
            child = edge.parent
        return child, T

    def camera_transforms(self, frame: str, time_s: FloatArray) -> tuple[str, FloatArray] | None:
        """As `camera_poses`, T_cam_root."""
        found = self.camera_poses(frame, time_s)
        return None if found is None else (found[0], invert_transform(found[1]))


def _along(edge: _Edge, time_s: FloatArray) -> FloatArray:
    """(n, 4, 4) T_parent_child at times (n,)."""
    rows = np.array(edge.rows)
    T = make_transform(Rotation.from_quat(rows[:, 3:]).as_matrix(), rows[:, :3])
    if edge.is_static:
        return np.tile(T[-1], (len(time_s), 1, 1))
    stamps, first = np.unique(np.array(edge.time_s), return_index=True)
    return interpolated(TimedPoses(stamps, T[first]), time_s)


def _frame(name: object) -> str:
    # ROS 1 of old began names with a slash.
    return str(name).lstrip("/")
