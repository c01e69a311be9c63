"""Bags of ROS 1 (.bag) and ROS 2 (a folder with metadata.yaml) and .mcap files of ROS messages.

Depth comes from Image (16UC1 in mm, 32FC1 in m), compressed depth (PNG) or PointCloud2, in the rows
and columns of a pinhole or of a LiDAR; the camera and its lens from CameraInfo; its pose in the
world from /tf and /tf_static, where the tree reaches above the camera's frame.
NAME.toml beside a file says what a sequence.toml says.
"""

import logging
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any
from weakref import finalize

import numpy as np

from pcnav.config.recording import AS_IT_IS, RecordingTable
from pcnav.core._extras import rosbags
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.distortion import COEFFICIENTS, DistortionModel
from pcnav.core.errors import InputError
from pcnav.core.spatial import make_transform
from pcnav.recordings.assembling import Parts, assembled, settings_file
from pcnav.recordings.bag_images import (
    CLOUD,
    COMPRESSED,
    IMAGE,
    cloud_of,
    depth_of_compressed,
    depth_of_image,
)
from pcnav.recordings.bag_topics import camera_topic, depth_topic
from pcnav.recordings.bag_transforms import TransformTree
from pcnav.recordings.cloud import Cloud
from pcnav.recordings.cloud_scans import CloudScans, scans_assembled
from pcnav.recordings.depth_camera import DepthCamera
from pcnav.recordings.depth_form import DepthForm
from pcnav.recordings.depth_image import ImageSize, StoredDepth
from pcnav.recordings.organised import depth_of_points, pinhole_of
from pcnav.recordings.sequence import Sequence
from pcnav.recordings.sequence_file import stated_axes

METADATA = "metadata.yaml"
_SUFFIXES = (".bag", ".mcap")
TF, TF_STATIC = "/tf", "/tf_static"
_TRIED = 10
"""Clouds by which a sensor without a CameraInfo is known."""
_MODELS = {
    "plumb_bob": DistortionModel.OPENCV,
    "rational_polynomial": DistortionModel.OPENCV,
    "equidistant": DistortionModel.FISHEYE,
    "fisheye": DistortionModel.FISHEYE,
    "kannala_brandt4": DistortionModel.FISHEYE,
}
_LOG = logging.getLogger("pcnav")


def is_bag(path: Path) -> bool:
    """Whether a path is a bag."""
    return (path.suffix.lower() in _SUFFIXES and path.is_file()) or (path / METADATA).is_file()


def read_bag(
    path: Path,
    target_mesh: Path | None = None,
    skip_bad_frames: bool = False,
    table: RecordingTable = AS_IT_IS,
) -> Sequence:
    """The depth images of a bag; which topics were taken is said.

    Images outside the time that the transforms cover are left out, and that is said. Raises
    `InputError`, also where rosbags is not installed.
    """
    bag = _Bag(path)
    topic = depth_topic(path, bag.kinds, table.topic)
    info = camera_topic(path, bag.kinds, topic, table.camera_topic)
    found = bag.scanned(topic, info)
    images = _BagImages(bag, topic, found.bag_ns)
    camera, scans = _camera(path, table, found, images), None
    if not isinstance(camera, DepthCamera):
        scans = CloudScans.of(path, camera, stated_axes(settings_file(path)), table.unit_m)
        camera = scans.depth_camera
    names, stamp_s = images.names, found.time_s
    T_cam_world, frame, remarks = None, found.frame, []
    seen = found.tree.camera_transforms(frame, found.time_s)
    where = "no camera poses"
    if seen is not None:
        root, T = seen
        known = np.isfinite(T[:, 0, 0])
        where = f"the camera ({frame}) in {root} by {TF}"
        if not known.any():
            raise InputError(path, TF, f"expected transforms of {frame} at the images' times")
        if not known.all():
            remarks.append(f"{int((~known).sum())} images without a transform left out")
        names = tuple(name for name, here in zip(names, known, strict=True) if here)
        stamp_s, T_cam_world = stamp_s[known], T[known]
        if scans is not None:
            T_cam_world = make_transform(scans.axes.R_cam_cloud, np.zeros(3)) @ T_cam_world
    lens = "options" if table.camera_px is not None else info or "the points"
    _LOG.info("%s: depth of %s, camera of %s, %s", path, topic, lens, where)
    parts = Parts(
        *(path, path, names, camera, stamp_s, T_cam_world),
        read_image=images.read,
        integer_unit_m=0.001,
        assumed=tuple(remarks),
        origin_s=found.origin_s,
    )
    if scans is not None:
        return scans_assembled(parts, target_mesh, table, skip_bad_frames, scans, images.read_cloud)
    return assembled(parts, target_mesh, table, skip_bad_frames)


@dataclass(frozen=True)
class _Found:
    """What one pass over a bag finds."""

    origin_s: int
    """Whole second that times are counted from: an epoch leaves a sum of floats no digits."""
    time_s: FloatArray
    """(n,) of the images' headers, from there on."""
    bag_ns: IntArray
    """(n,) when each was recorded."""
    frame: str
    """Of the first image."""
    info: Any
    """The first CameraInfo, or None."""
    tree: TransformTree


class _Bag:
    """A bag that is open for as long as the recording is."""

    def __init__(self, path: Path) -> None:
        highlevel = rosbags("highlevel", f"bags like {path.name}")
        typesys = rosbags("typesys", f"bags like {path.name}")
        self.path, self._lock = path, Lock()
        default = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        with self.guarded():
            self._reader = highlevel.AnyReader([path], default_typestore=default)
            self._reader.open()
        # Closed with the recording: frames may be asked for as long as there is one.
        finalize(self, self._reader.close)
        self.kinds: dict[str, str] = {c.topic: c.msgtype for c in self._reader.connections}

    @contextmanager
    def guarded(self) -> Iterator[None]:
        """Faults of the file as `InputError`; one reader at a time."""
        with self._lock:
            try:
                yield
            except InputError:
                raise
            except Exception as error:
                # The reader's libraries raise what their parsers happen to: all is the file's.
                why = " ".join(str(error).split())[:200] or type(error).__name__
                raise InputError(self.path, "file", f"expected an undamaged bag ({why})") from error

    def scanned(self, topic: str, info: str | None) -> _Found:
        """One pass. Raises `InputError` for a bag without images."""
        wanted = {topic, TF, TF_STATIC} | ({info} if info else set())
        stamps, recorded, frame, camera = [], [], "", None
        tree, origin_s = TransformTree(), None
        with self.guarded():
            for connection, bag_ns, raw in self._messages(wanted):
                origin_s = bag_ns // 10**9 if origin_s is None else origin_s
                if connection.topic == topic:
                    stamps.append(_stamp_ns(raw, self._reader.is2))
                    recorded.append(bag_ns)
                    if not frame:
                        frame = self._message(connection, raw).header.frame_id
                elif connection.topic == info:
                    camera = camera or self._message(connection, raw)
                elif connection.topic != info:
                    static = connection.topic == TF_STATIC
                    tree.add(self._message(connection, raw), static, origin_s)
        if not stamps:
            raise InputError(self.path, topic, "expected at least one image")
        if not any(stamps):
            _LOG.warning("%s: the images' headers have no time: when they were recorded", self.path)
            stamps = recorded
        origin_s = origin_s or 0
        time_s = np.array([ns // 10**9 - origin_s + (ns % 10**9) * 1e-9 for ns in stamps])
        return _Found(origin_s, time_s, np.array(recorded), frame, camera, tree)

    def images(self, topic: str, start_ns: int) -> Iterator[tuple[str, Any]]:
        """Kinds and messages of a topic from when they were recorded on."""
        for connection, _, raw in self._messages({topic}, start_ns):
            yield connection.msgtype, self._message(connection, raw)

    def _messages(self, topics: set[str], start_ns: int | None = None) -> Iterator[Any]:
        chosen = [c for c in self._reader.connections if c.topic in topics]
        return iter(self._reader.messages(connections=chosen, start=start_ns))

    def _message(self, connection: Any, raw: bytes) -> Any:
        return self._reader.deserialize(raw, connection.msgtype)


class _BagImages:
    """The images of a topic by name; read on from the last one where they are read in order."""

    def __init__(self, bag: _Bag, topic: str, bag_ns: IntArray) -> None:
        self._bag, self._topic, self._bag_ns = bag, topic, bag_ns
        self.names = tuple(f"{topic.strip('/').replace('/', '.')}[{k}]" for k in range(len(bag_ns)))
        self._places = {name: k for k, name in enumerate(self.names)}
        self._next = 0
        self._stream: Iterator[tuple[str, Any]] = iter(())

    def read(self, path: Path) -> StoredDepth:
        """Raises `InputError`, which names the image, for a message that holds no depth."""
        kind, message = self.message(self._places[path.name])
        try:
            return depth_of_message(kind, message)
        except ValueError as error:
            raise InputError(path, "message", str(error)) from error

    def read_cloud(self, path: Path) -> Cloud:
        """Raises `InputError`, which names the cloud, for a message that holds none."""
        _, message = self.message(self._places[path.name])
        try:
            return cloud_of(message)
        except ValueError as error:
            raise InputError(path, "message", str(error)) from error

    def message(self, place: int) -> tuple[str, Any]:
        """Kind and message of an image by its place."""
        with self._bag.guarded():
            if place != self._next or place == 0:
                # Images may share a time: go back to the first of it.
                first = int(np.searchsorted(self._bag_ns, self._bag_ns[place]))
                self._stream = self._bag.images(self._topic, int(self._bag_ns[place]))
                self._next = first
                while self._next < place:
                    next(self._stream)
                    self._next += 1
            self._next += 1
            found: tuple[str, Any] = next(self._stream)
            return found


def _camera(
    path: Path, table: RecordingTable, found: _Found, images: _BagImages
) -> DepthCamera | list[Cloud]:
    """The camera of the images; the first clouds where that of clouds is none."""
    if table.camera_px is not None:
        return DepthCamera(table.camera_px, None, table.unit_m)
    if found.info is not None:
        return camera_of_info(path, found.info, table.unit_m)
    kind, _ = images.message(0)
    if kind != CLOUD:
        expected = "expected CameraInfo beside the images, --camera-topic or --camera FX FY CX CY"
        raise InputError(path, "camera", expected)
    clouds = [images.read_cloud(path / name) for name in images.names[:_TRIED]]
    first = clouds[0]
    if first.time is None and min(first.points.shape[:2]) > 1:
        try:
            return DepthCamera(pinhole_of(first.points), None, table.unit_m)
        except ValueError:
            pass
    return clouds


def depth_of_message(kind: str, message: Any) -> StoredDepth:
    """(height, width) of a message of depth. Raises `ValueError` for one that holds none."""
    if kind == IMAGE:
        return depth_of_image(message)
    if kind == COMPRESSED:
        return depth_of_compressed(message)
    points = cloud_of(message).points
    if min(points.shape[:2]) < 2:
        raise ValueError(f"expected rows and columns, got {points.shape[1]} points in one row")
    return depth_of_points(points)


def camera_of_info(path: Path, info: Any, unit_m: float | None) -> DepthCamera:
    """Of a CameraInfo, whose letters are capitals in ROS 1."""
    K, D = (np.array(getattr(info, n, getattr(info, n.upper(), ()))) for n in ("k", "d"))
    if K.size != 9 or not np.isfinite(K).all() or not (K[0] > 0.0 and K[4] > 0.0):
        raise InputError(path, "CameraInfo K", "expected intrinsics with focal lengths above 0")
    if K[1] != 0.0:
        raise InputError(path, "CameraInfo K", "expected no skew (second number 0)")
    size = ImageSize(int(info.width), int(info.height))
    name, form = str(info.distortion_model), DepthForm()
    if D.any():
        model = _MODELS.get(name)
        count = next((n for n in COEFFICIENTS.get(model, ()) if len(D) == n), None) if model else 0
        if model is None or count is None or not np.isfinite(D).all():
            known = ", ".join(_MODELS)
            expected = f"expected one of {known} with its coefficients"
            raise InputError(path, "CameraInfo D", f"{expected}, got {name!r} with {len(D)}")
        form = DepthForm(distortion_model=model, distortion=tuple(D.tolist()))
    fx, fy, cx, cy = (float(K[k]) for k in (0, 4, 2, 5))
    return DepthCamera((fx, fy, cx, cy), size if size.width and size.height else None, unit_m, form)


def _stamp_ns(raw: bytes, is_ros2: bool) -> int:
    """Of the header that a message begins with, without parsing its pixels."""
    if not is_ros2:
        _, sec, nanosec = struct.unpack_from("<III", raw)
        return int(sec) * 10**9 + int(nanosec)
    order = "<" if raw[1] & 1 else ">"
    sec, nanosec = struct.unpack_from(f"{order}iI", raw, 4)
    return int(sec) * 10**9 + int(nanosec)
