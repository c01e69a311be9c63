"""A small scene in the formats of other tools, written by their own libraries."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

EPOCH_NS = 1_700_000_000 * 10**9
TOPIC = "/camera/depth/image_raw"


class Scene:
    """What a scene in our own format holds, read without the package."""

    def __init__(self, folder: Path, frames: int | None = None) -> None:
        cameras = json.loads((folder / "scene_camera.json").read_text())
        self.numbers = sorted(map(int, cameras))[:frames]
        entries = [cameras[str(k)] for k in self.numbers]
        self.K = np.reshape(entries[0]["cam_K"], (3, 3))
        self.unit_mm = float(entries[0]["depth_scale"])
        self.time_s = np.array([each["timestamp_s"] for each in entries])
        self.files = [folder / "depth" / f"{k:06d}.png" for k in self.numbers]
        self.depth = np.stack([np.asarray(Image.open(file)) for file in self.files])
        self.T_cam_world = None
        if "cam_R_w2c" in entries[0]:
            T = np.tile(np.eye(4), (len(entries), 1, 1))
            T[:, :3, :3] = [np.reshape(each["cam_R_w2c"], (3, 3)) for each in entries]
            T[:, :3, 3] = [np.array(each["cam_t_w2c"]) / 1000.0 for each in entries]
            self.T_cam_world = T

    def metres(self, k: int) -> np.ndarray:
        """A depth image as floats, whose holes are 0."""
        units = np.where(self.depth[k] == 65535, 0, self.depth[k]).astype(np.float64)
        return (units * self.unit_mm / 1000.0).astype(np.float32)

    @property
    def camera_toml(self) -> str:
        """As depth_camera.toml."""
        (fx, _, cx), (_, fy, cy), _ = self.K
        height, width = self.depth.shape[1:]
        size = f"width = {width}\nheight = {height}\ndepth_scale = {self.unit_mm}\n"
        return f"fx = {fx}\nfy = {fy}\ncx = {cx}\ncy = {cy}\n{size}"

    def pose_lines(self) -> str:
        """T_world_cam as a TUM file has it."""
        assert self.T_cam_world is not None
        T = np.linalg.inv(self.T_cam_world)
        q = Rotation.from_matrix(T[:, :3, :3]).as_quat()
        rows = np.column_stack([self.time_s, T[:, :3, 3], q])
        return "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist())


def as_npz(scene: Scene, path: Path) -> Path:
    arrays = {"depth": scene.depth, "K": scene.K, "time_s": scene.time_s}
    arrays["depth_scale"] = np.array(scene.unit_mm)
    if scene.T_cam_world is not None:
        arrays["T_cam_world"] = scene.T_cam_world
    np.savez_compressed(path, allow_pickle=False, **arrays)
    return path


def as_tum(scene: Scene, folder: Path) -> Path:
    (folder / "depth").mkdir(parents=True)
    lines = ["# depth maps", "# timestamp filename"]
    for file, time_s in zip(scene.files, scene.time_s.tolist(), strict=True):
        shutil.copy(file, folder / "depth" / f"{time_s:.6f}.png")
        lines.append(f"{time_s!r} depth/{time_s:.6f}.png")
    (folder / "depth.txt").write_text("\n".join(lines) + "\n")
    (folder / "depth_camera.toml").write_text(scene.camera_toml)
    if scene.T_cam_world is not None:
        (folder / "groundtruth.txt").write_text(scene.pose_lines())
    return folder


class _Bag:
    """A bag of either kind while it is written."""

    def __init__(self, path: Path) -> None:
        self._is1 = path.suffix == ".bag"
        store = get_typestore(Stores.ROS1_NOETIC if self._is1 else Stores.ROS2_HUMBLE)
        if self._is1:
            definition = "geometry_msgs/TransformStamped[] transforms"
            store.register(get_types_from_msg(definition, "tf2_msgs/msg/TFMessage"))
        self._store, self._topics = store, dict[str, Any]()
        if self._is1:
            self.writer: Any = Writer1(path)
        else:
            plugin = StoragePlugin.MCAP if path.suffix == ".mcap" else StoragePlugin.SQLITE3
            self.writer = Writer(path.with_suffix(""), version=9, storage_plugin=plugin)

    def make(self, kind: str, *values: Any) -> Any:
        package, name = kind.split("/")
        return self._store.types[f"{package}/msg/{name}"](*values)

    def header(self, time_ns: int, frame: str) -> Any:
        stamp = self.make("builtin_interfaces/Time", *divmod(time_ns, 10**9))
        values = (0, stamp, frame) if self._is1 else (stamp, frame)
        return self.make("std_msgs/Header", *values)

    def write(self, topic: str, kind: str, time_ns: int, message: Any) -> None:
        kind = kind.replace("/", "/msg/")
        if topic not in self._topics:
            self._topics[topic] = self.writer.add_connection(topic, kind, typestore=self._store)
        store = self._store
        serialize = store.serialize_ros1 if self._is1 else store.serialize_cdr
        self.writer.write(self._topics[topic], time_ns, serialize(message, kind))


Message = Callable[[_Bag, Any, np.ndarray], tuple[str, Any]]
"""Kind and message from a bag, a header and a stored image (height, width)."""


def image_message(bag: _Bag, header: Any, pixels: np.ndarray) -> tuple[str, Any]:
    encoding = "16UC1" if pixels.dtype == np.uint16 else "32FC1"
    height, width = pixels.shape
    data = np.frombuffer(pixels.tobytes(), dtype=np.uint8)
    fields = (header, height, width, encoding, 0, pixels.strides[0], data)
    return "sensor_msgs/Image", bag.make("sensor_msgs/Image", *fields)


def write_bag(
    scene: Scene,
    path: Path,
    message: Message = image_message,
    topic: str = TOPIC,
    distortion: tuple[str, tuple[float, ...]] = ("plumb_bob", (0.0,) * 5),
    with_info: bool = True,
) -> Path:
    """A bag of ROS 1 (.bag), one file of ROS 2 (.mcap), or a folder of it; where it lies."""
    bag = _Bag(path)
    with bag.writer:
        for k, time_s in enumerate(scene.time_s.tolist()):
            time_ns = EPOCH_NS + round(time_s * 1e9)
            header, pixels = bag.header(time_ns, "cam_optical"), scene.depth[k]
            if scene.unit_mm != 1.0:
                pixels = scene.metres(k)
            kind, content = message(bag, header, np.ascontiguousarray(pixels))
            bag.write(topic, kind, time_ns, content)
            if with_info:
                _write_info(bag, scene, time_ns, distortion)
            if scene.T_cam_world is not None:
                _write_transform(bag, time_ns, np.linalg.inv(scene.T_cam_world[k]))
    if path.suffix != ".mcap":
        return path
    return next(path.with_suffix("").glob("*.mcap")).rename(path)


def _write_info(
    bag: _Bag, scene: Scene, time_ns: int, distortion: tuple[str, tuple[float, ...]]
) -> None:
    height, width = scene.depth.shape[1:]
    model, coefficients = distortion
    region = bag.make("sensor_msgs/RegionOfInterest", 0, 0, 0, 0, False)
    info = bag.make(
        "sensor_msgs/CameraInfo",
        *(bag.header(time_ns, "cam_optical"), height, width, model),
        *(np.array(coefficients), scene.K.ravel(), np.eye(3).ravel(), np.zeros(12), 0, 0, region),
    )
    bag.write(f"{TOPIC.rsplit('/', 1)[0]}/camera_info", "sensor_msgs/CameraInfo", time_ns, info)


def _write_transform(bag: _Bag, time_ns: int, T: np.ndarray) -> None:
    """T_map_cam in two steps: the base moves, the camera is fixed a quarter turn on it."""
    T_base_cam = np.eye(4)
    T_base_cam[:3, :3] = [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    T_base_cam[:3, 3] = 0.1, -0.2, 0.3
    edges = (
        ("/tf", "map", "base", T @ np.linalg.inv(T_base_cam)),
        ("/tf_static", "base", "cam_optical", T_base_cam),
    )
    for topic, parent, child, pose in edges:
        q = Rotation.from_matrix(pose[:3, :3]).as_quat()
        transform = bag.make(
            "geometry_msgs/Transform",
            bag.make("geometry_msgs/Vector3", *pose[:3, 3].tolist()),
            bag.make("geometry_msgs/Quaternion", *q.tolist()),
        )
        header = bag.header(time_ns, parent)
        stamped = bag.make("geometry_msgs/TransformStamped", header, child, transform)
        bag.write(topic, "tf2_msgs/TFMessage", time_ns, bag.make("tf2_msgs/TFMessage", [stamped]))
