"""MCAP: a bag of ROS 2 messages that Foxglove, RViz and rosbag2 play."""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pcnav.core._extras import rosbags
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import invert_transform, xyzw_from_rotation
from pcnav.runs.export.content import Export, Files
from pcnav.runs.export.pose_covariance import pose_covariances
from pcnav.target.mesh import wireframe_edges
from pcnav.target.satellite import target_mesh_of

ABOUT = (
    "ROS 2 messages, needs the extra `bags`: /pcnav/pose (PoseWithCovarianceStamped of the model "
    "in the frame `camera`: x right, y down, z forward, m, rad; PoseStamped where no covariance is "
    "known), /pcnav/truth (PoseStamped), /pcnav/status (String), /tf (world to camera, camera to "
    "target), /pcnav/markers (the mesh's edges). Quaternions scalar last. Stamped as the recording "
    "is, or from --epoch on."
)
_NAME = "pcnav"
_LINE_LIST, _ADD = 5, 0
_YELLOW = (1.0, 0.85, 0.1, 1.0)
_LINE_SHARE = 0.004
"""Width of a drawn edge over the size of the target."""
_MAX_EDGES = 20_000


@dataclass(frozen=True)
class _Message:
    """One message on its way into the bag."""

    time_ns: int
    topic: str
    kind: str
    content: Any


def write_mcap(export: Export) -> Files:
    """Raises `InputError` for a run without poses, times before 0, and without rosbags."""
    bags = rosbags("rosbag2", "MCAP files")
    stores = rosbags("typesys", "MCAP files")
    store = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
    messages = sorted(_messages(export, _Types(store)), key=lambda message: message.time_ns)
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / _NAME
        plugin = bags.StoragePlugin.MCAP
        with bags.Writer(bag, version=9, storage_plugin=plugin) as writer:
            topics: dict[str, Any] = {}
            for each in messages:
                if each.topic not in topics:
                    topics[each.topic] = writer.add_connection(
                        each.topic, each.kind, typestore=store
                    )
                data = store.serialize_cdr(each.content, each.kind)
                writer.write(topics[each.topic], each.time_ns, data)
        return {"": next(bag.glob("*.mcap")).read_bytes()}


class _Types:
    """Makes messages of ROS 2."""

    def __init__(self, store: Any) -> None:
        self._types = store.types

    def make(self, kind: str, *values: Any) -> Any:
        """A message of a kind like geometry_msgs/Point, its fields in order."""
        package, name = kind.split("/")
        return self._types[f"{package}/msg/{name}"](*values)

    def header(self, time_ns: int, frame: str) -> Any:
        """Stamp and frame."""
        return self.make("std_msgs/Header", self.time(time_ns), frame)

    def time(self, time_ns: int) -> Any:
        """A time."""
        return self.make("builtin_interfaces/Time", *divmod(time_ns, 10**9))

    def pose(self, T: FloatArray) -> Any:
        """Of a transform (4, 4)."""
        return self.make(
            "geometry_msgs/Pose",
            self.make("geometry_msgs/Point", *T[:3, 3].tolist()),
            self.make("geometry_msgs/Quaternion", *xyzw_from_rotation(T[:3, :3]).tolist()),
        )

    def tf(self, time_ns: int, parent: str, child: str, T_parent_child: FloatArray) -> Any:
        """One transform of the tree."""
        transform = self.make(
            "geometry_msgs/Transform",
            self.make("geometry_msgs/Vector3", *T_parent_child[:3, 3].tolist()),
            self.make(
                "geometry_msgs/Quaternion", *xyzw_from_rotation(T_parent_child[:3, :3]).tolist()
            ),
        )
        stamped = "geometry_msgs/TransformStamped"
        each = self.make(stamped, self.header(time_ns, parent), child, transform)
        return self.make("tf2_msgs/TFMessage", [each])


def _messages(export: Export, types: _Types) -> Iterator[_Message]:
    frames, poses = export.poses()
    times_ns = _times_ns(export)
    covariances = pose_covariances(export)
    for k, status in enumerate(export.run.status):
        content = types.make("std_msgs/String", status)
        yield _Message(times_ns[k], "/pcnav/status", "std_msgs/msg/String", content)
    for k, T in zip(frames.tolist(), poses, strict=True):
        covariance = None if covariances is None else covariances[k]
        yield _pose_message(types, times_ns[k], T, covariance)
        tf = types.tf(times_ns[k], "camera", "target", T)
        yield _Message(times_ns[k], "/tf", "tf2_msgs/msg/TFMessage", tf)
    yield _markers(export, types, times_ns[int(frames[0])])
    recording = export.recording
    if recording is not None and len(recording) == len(export.run):
        for k, T_world_cam in enumerate(invert_transform(recording.T_cam_world)):
            tf = types.tf(times_ns[k], "world", "camera", T_world_cam)
            yield _Message(times_ns[k], "/tf", "tf2_msgs/msg/TFMessage", tf)
    true = export.true_poses_at(np.arange(len(export.run)))
    if true is not None:
        for k in np.flatnonzero(np.isfinite(true[:, 0, 0])).tolist():
            stamped = (types.header(times_ns[k], "camera"), types.pose(true[k]))
            content = types.make("geometry_msgs/PoseStamped", *stamped)
            yield _Message(times_ns[k], "/pcnav/truth", "geometry_msgs/msg/PoseStamped", content)


def _pose_message(
    types: _Types, time_ns: int, T: FloatArray, covariance: FloatArray | None
) -> _Message:
    header, pose = types.header(time_ns, "camera"), types.pose(T)
    if covariance is None:
        # A covariance of zeros would be read as certainty.
        content = types.make("geometry_msgs/PoseStamped", header, pose)
        return _Message(time_ns, "/pcnav/pose", "geometry_msgs/msg/PoseStamped", content)
    spread = types.make("geometry_msgs/PoseWithCovariance", pose, covariance.ravel())
    kind = "geometry_msgs/PoseWithCovarianceStamped"
    content = types.make(kind, header, spread)
    return _Message(time_ns, "/pcnav/pose", kind.replace("/", "/msg/"), content)


def _times_ns(export: Export) -> list[int]:
    """Of every frame. Raises `InputError` for times that a bag cannot hold."""
    zero_ns = export.zero_ns()
    zero_ns = round(export.time_zero_s * 1e9) if zero_ns is None else zero_ns
    times_ns = [zero_ns + round(time_s * 1e9) for time_s in export.run.time_s.tolist()]
    if times_ns and not 0 <= min(times_ns) <= max(times_ns) < 2**31 * 10**9:
        expected = "expected times from 0 on that a bag can hold; --epoch gives UTC of time 0"
        raise InputError(export.source, "time_s", expected)
    return times_ns


def _markers(export: Export, types: _Types, time_ns: int) -> _Message:
    """The edges of the mesh in the frame `target`; no marker where the mesh is gone."""
    pipeline, markers = export.run.pipeline, []
    mesh = None if pipeline is None else pipeline.target_mesh
    if pipeline is not None and mesh is not None and Path(mesh).is_file():
        geometry = target_mesh_of(Path(mesh), pipeline.mesh_unit)
        edges = wireframe_edges(geometry)[:_MAX_EDGES]
        width = _LINE_SHARE * float(np.linalg.norm(geometry.extents))
        points = [types.make("geometry_msgs/Point", *p) for p in edges.reshape(-1, 3).tolist()]
        markers = [_line_list(types, time_ns, points, width)]
    content = types.make("visualization_msgs/MarkerArray", markers)
    return _Message(time_ns, "/pcnav/markers", "visualization_msgs/msg/MarkerArray", content)


def _line_list(types: _Types, time_ns: int, points: list[Any], width_m: float) -> Any:
    nothing = np.zeros(0, dtype=np.uint8)
    return types.make(
        "visualization_msgs/Marker",
        types.header(time_ns, "target"),
        "pcnav",
        0,
        _LINE_LIST,
        _ADD,
        types.pose(np.eye(4)),
        types.make("geometry_msgs/Vector3", width_m, 0.0, 0.0),
        types.make("std_msgs/ColorRGBA", *_YELLOW),
        types.make("builtin_interfaces/Duration", 0, 0),
        True,
        points,
        [],
        "",
        types.make("sensor_msgs/CompressedImage", types.header(time_ns, ""), "", nothing),
        [],
        "",
        "",
        types.make("visualization_msgs/MeshFile", "", nothing),
        False,
    )
