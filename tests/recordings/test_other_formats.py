"""Depth frames in the formats of other tools are those of the same scene in our own."""

import json
import logging
import struct
import subprocess
import sys
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.recording import RecordingTable
from pcnav.core.camera import PinholeCamera, project
from pcnav.core.distortion import DistortionModel
from pcnav.core.errors import InputError
from pcnav.pipeline import run
from pcnav.recordings.opening import open_recording, open_sequence
from pcnav.recordings.sequence import Sequence
from pcnav.recordings.truth import truth_of
from pcnav.runs.reader import read_run
from pcnav.runs.status import CLAIMED
from tests.recordings.other_formats import (
    EPOCH_NS,
    TOPIC,
    Scene,
    as_npz,
    as_tum,
    image_message,
    write_bag,
)
from tests.recordings.test_clouds import write_pcd

CAMERA = (20.0, 21.0, 3.5, 2.5)


def folder_of(suffix: str) -> Callable[[Scene, Path], Path]:
    """Images of a suffix in a folder, with the poses of the camera beside them."""

    def write(scene: Scene, folder: Path) -> Path:
        folder.mkdir()
        for k, pixels in enumerate(scene.depth):
            path = folder / f"shot{k}{suffix}"
            metres = scene.metres(k)
            if suffix == ".npy":
                np.save(path, pixels)
            elif suffix == ".tiff":
                tifffile.imwrite(path, metres * 1000.0 / scene.unit_mm)
            elif suffix == ".exr":
                OpenEXR = pytest.importorskip("OpenEXR")
                units = metres * np.float32(1000.0 / scene.unit_mm)
                header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
                OpenEXR.File(header, {"Z": units}).write(str(path))
            else:
                Image.fromarray(pixels).save(path)
        (folder / "times.csv").write_text("time_s\n" + "\n".join(map(repr, scene.time_s.tolist())))
        (folder / "poses.tum").write_text(scene.pose_lines())
        (folder / "depth_camera.toml").write_text(scene.camera_toml)
        return folder

    return write


WRITERS: dict[str, Callable[[Scene, Path], Path]] = {
    "npz": lambda scene, folder: as_npz(scene, folder.with_suffix(".npz")),
    "tum": as_tum,
    "bag of ROS 1": lambda scene, folder: write_bag(scene, folder.with_suffix(".bag")),
    "mcap": lambda scene, folder: write_bag(scene, folder.with_suffix(".mcap")),
    "bag of ROS 2": write_bag,
    **{f"folder of {suffix}": folder_of(suffix) for suffix in (".npy", ".tiff", ".exr", ".png")},
}


def expect_same(found: Sequence, scene: Sequence) -> None:
    """The same frames, cameras and times from the first frame on, to rounding."""
    assert len(found) == len(scene)
    for a, b in zip(found, scene, strict=True):
        assert a.time_s - found.times_s[0] == pytest.approx(b.time_s - scene.times_s[0], abs=1e-9)
        assert np.allclose(a.depth_m, b.depth_m, rtol=2e-7, atol=0.0)
        assert a.camera == b.camera
        assert np.allclose(a.T_cam_world, b.T_cam_world, atol=1e-12)


@pytest.mark.parametrize("name", WRITERS)
def test_the_frames_are_those_of_the_scene(name: str, scene: Path, tmp_path: Path) -> None:
    path = WRITERS[name](Scene(scene), tmp_path / "other")
    found, ours = open_sequence(path), open_sequence(scene)
    expect_same(found, ours)
    # Also out of order, and again.
    for k in (2, 0, 1, 1):
        assert np.array_equal(found.frame(k).depth_m, list(found)[k].depth_m)
    assert path == found.path


def test_frames_are_chosen_by_start_number_and_step(make_scene: Any, tmp_path: Path) -> None:
    scene = make_scene(tmp_path / "scene", numbers=tuple(range(10)))
    path = as_npz(Scene(scene), tmp_path / "a.npz")
    table = RecordingTable(start=1, every=3, frames=2)
    for each in (path, scene):
        taken, whole = open_sequence(each, table=table), open_sequence(each)
        assert [frame.index for frame in taken] == [0, 1]
        assert taken.times_s.tolist() == [0.5, 2.0]
        assert np.array_equal(taken.frame(1).depth_m, whole.frame(4).depth_m)
    with pytest.raises(InputError, match=r"--start: expected frames among its 10"):
        open_sequence(path, table=RecordingTable(start=10))


def test_an_option_that_is_of_no_use_is_refused(scene: Path) -> None:
    with pytest.raises(InputError, match="--topic: expected none: of no use for a BOP scene"):
        open_sequence(scene, table=RecordingTable(topic="/depth"))


def test_options_say_what_arrays_do_not(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    depth = np.arange(2 * 6 * 8, dtype=np.uint16).reshape(2, 6, 8)
    np.save(tmp_path / "a.npy", depth)
    with pytest.raises(InputError, match=r"a.npy: camera: expected --camera FX FY CX CY"):
        open_sequence(tmp_path / "a.npy")
    table = RecordingTable(camera_px=CAMERA, unit_m=0.0005, frame_rate_hz=4.0)
    found = open_sequence(tmp_path / "a.npy", table=table)
    frame = found.frame(1)
    assert (frame.time_s, frame.camera) == (0.25, PinholeCamera(8, 6, *CAMERA))
    assert np.allclose(frame.depth_m, depth[1] * 0.0005)
    caplog.clear()
    with caplog.at_level(logging.WARNING, logger="pcnav"):
        plain = open_sequence(tmp_path / "a.npy", table=RecordingTable(camera_px=CAMERA))
    (said,) = caplog.messages
    assert "0, 1, 2, ... s assumed" in said
    assert "taken as millimetres" in said
    assert "camera at rest" in said
    assert plain.frame(1).depth_m[5, 7] == pytest.approx(0.095)
    tifffile.imwrite(tmp_path / "a.tif", depth)
    pages = open_sequence(tmp_path / "a.tif", table=table)
    assert np.array_equal(pages.frame(1).depth_m, frame.depth_m)


def test_names_that_are_time_stamps_are_taken_as_such(tmp_path: Path) -> None:
    for name in ("1700000000250000000", "1700000000500000000", "1700000001000000000"):
        np.save(tmp_path / f"{name}.npy", np.ones((6, 8), dtype=np.float32))
    found = open_sequence(tmp_path, table=RecordingTable(camera_px=CAMERA))
    assert np.allclose(found.times_s, [0.0, 0.25, 0.75], atol=1e-6)
    assert found.info.time_zero_s == pytest.approx(1.70000000025e9)


def test_a_settings_file_beside_a_bag_or_array_says_the_rest(scene: Path, tmp_path: Path) -> None:
    path = as_npz(Scene(scene), tmp_path / "a.npz")
    text = (
        '[orbit]\nmean_motion_rad_s = 0.001\n[sensor]\nrange_sigma_m = 0.03\ndepth_is = "range"\n'
    )
    (tmp_path / "a.toml").write_text(text)
    found, ours = open_sequence(path), open_sequence(scene)
    assert (found.info.mean_motion_rad_s, found.info.range_sigma_m) == (0.001, 0.03)
    nearer = found.frame(0).depth_m[5, 7] / ours.frame(0).depth_m[5, 7]
    x, y = (7 - 3.5) / 20.0, (5 - 2.5) / 21.0
    assert nearer == pytest.approx(1.0 / np.sqrt(1.0 + x**2 + y**2))


@pytest.mark.parametrize("name", ["tum", "bag of ROS 2", "folder of .npy"])
def test_a_folder_may_hold_a_settings_file(name: str, scene: Path, tmp_path: Path) -> None:
    path = WRITERS[name](Scene(scene), tmp_path / "other")
    (path / "sequence.toml").write_text("[sensor]\nrange_sigma_m = 0.03\n")
    found = open_sequence(path)
    assert (len(found), found.info.range_sigma_m) == (3, 0.03)


def test_truth_of_tum_and_npz_is_read_for_the_evaluation_alone(scene: Path, tmp_path: Path) -> None:
    content = Scene(scene)
    tum = as_tum(content, tmp_path / "tum")
    assert truth_of(open_sequence(tum)) is None
    (tum / "target.tum").write_text(content.pose_lines())
    truth = truth_of(open_sequence(tum))
    assert truth is not None
    assert content.T_cam_world is not None
    assert np.allclose(truth.poses, np.linalg.inv(content.T_cam_world), atol=1e-12)
    path = as_npz(content, tmp_path / "a.npz")
    assert truth_of(open_sequence(path)) is None
    with np.load(path) as arrays:
        stored = {**arrays, "true_T_cam_model": content.T_cam_world}
        np.savez(tmp_path / "b.npz", allow_pickle=False, **stored)
    also = truth_of(open_sequence(tmp_path / "b.npz"))
    assert also is not None
    assert np.array_equal(also.poses, content.T_cam_world)
    assert also.time_s.tolist() == [0.0, 0.5, 1.0]


def test_associations_and_poses_between_the_images(scene: Path, tmp_path: Path) -> None:
    tum = as_tum(Scene(scene), tmp_path / "tum")
    (tum / "depth.txt").unlink()
    lines = "0.01 rgb/a.png 0.0 depth/0.000000.png\n1.0 depth/1.000000.png 1.01 rgb/b.png\n"
    (tum / "associations.txt").write_text(lines)
    (tum / "groundtruth.txt").write_text(
        "-0.5 0 0 0 0 0 0 1\n0.5 1 0 0 0 0 1 0\n1.5 2 0 0 0 0 0 1\n"
    )
    found = open_sequence(tum)
    assert found.times_s.tolist() == [0.0, 1.0]
    T_world_cam = np.linalg.inv(found.T_cam_world)
    assert np.allclose(T_world_cam[:, 0, 3], [0.5, 1.5])
    # Halfway between no turn and a half turn about z: a quarter turn either way.
    assert np.allclose(np.abs(T_world_cam[:, 1, 0]), 1.0)


def compressed_message(bag: Any, header: Any, pixels: np.ndarray) -> tuple[str, Any]:
    """As the plugin of compressed depth quantises floats: inverse depth in 16 bits."""
    quantum, reach = 100.0, 10.0
    a = quantum * (quantum + 1.0)
    b = 1.0 - a / reach
    with np.errstate(divide="ignore"):
        units = np.where(pixels > 0.0, np.floor(a / pixels + b), 0.0).astype(np.uint16)
    png = BytesIO()
    Image.fromarray(units).save(png, "PNG")
    data = struct.pack("<iff", 0, a, b) + png.getvalue()
    fields = (header, "32FC1; compressedDepth png", np.frombuffer(data, dtype=np.uint8))
    return "sensor_msgs/CompressedImage", bag.make("sensor_msgs/CompressedImage", *fields)


def test_compressed_depth_is_the_depth_to_its_quantum(scene: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    write_bag(Scene(scene), path, compressed_message, f"{TOPIC}/compressedDepth")
    ours = open_sequence(scene).frame(1).depth_m
    found = open_sequence(path).frame(1).depth_m
    seen = (ours > 0.2) & (ours < 10.0)
    assert seen.sum() > 20
    # A step of 1/10100 of inverse depth.
    assert np.all(np.abs(found - ours)[seen] <= ours[seen] ** 2 / 10_000.0)
    assert found[0, 0] == 0.0


def cloud_message(bag: Any, header: Any, pixels: np.ndarray) -> tuple[str, Any]:
    """Every pixel as a point of 20 bytes, x, y, z first; holes are nan."""
    v, u = np.mgrid[: pixels.shape[0], : pixels.shape[1]]
    fx, fy, cx, cy = CAMERA
    z = np.where(pixels > 0.0, pixels, np.nan)
    points = np.zeros((*pixels.shape, 5), dtype=np.float32)
    points[..., 0], points[..., 1], points[..., 2] = (u - cx) / fx * z, (v - cy) / fy * z, z
    fields = [bag.make("sensor_msgs/PointField", name, 4 * k, 7, 1) for k, name in enumerate("xyz")]
    data = np.frombuffer(points.tobytes(), dtype=np.uint8)
    height, width = pixels.shape
    rest = (False, 20, 20 * width, data, False)
    content = bag.make("sensor_msgs/PointCloud2", header, height, width, fields, *rest)
    return "sensor_msgs/PointCloud2", content


def test_an_organised_cloud_is_a_depth_image_and_tells_its_camera(
    make_scene: Any, tmp_path: Path
) -> None:
    content = Scene(make_scene(tmp_path / "scene"))
    # More pixels than the small scene has, so that a camera can be fitted.
    content.depth = np.full((3, 40, 50), 2000, dtype=np.uint16)
    content.depth[:, 3:9, 2:7] = 0
    path = write_bag(content, tmp_path / "a.mcap", cloud_message, "/points", with_info=False)
    found = open_sequence(path)
    assert np.allclose(found.intrinsics, [CAMERA] * 3, atol=1e-4)
    depth_m = found.frame(2).depth_m
    assert depth_m.shape == (40, 50)
    assert depth_m[20, 20] == 1.0
    assert not depth_m[3:9, 2:7].any()


def row_message(bag: Any, header: Any, pixels: np.ndarray) -> tuple[str, Any]:
    """The points that returned, in one row, 10 us apart."""
    name, cloud = cloud_message(bag, header, pixels)
    rows = cloud.data.view(np.uint32).reshape(-1, 5).copy()
    rows = rows[np.isfinite(rows[:, 2].view(np.float32))]
    rows[:, 4] = 10_000 * np.arange(len(rows))
    fields = [*cloud.fields, bag.make("sensor_msgs/PointField", "t", 16, 6, 1)]
    data = np.frombuffer(rows.tobytes(), dtype=np.uint8)
    rest = (False, 20, len(data), data, True)
    return name, bag.make("sensor_msgs/PointCloud2", header, 1, len(rows), fields, *rest)


def test_a_cloud_in_one_row_is_a_scan_with_the_times_of_its_points(
    make_scene: Any, tmp_path: Path
) -> None:
    content = Scene(make_scene(tmp_path / "scene"))
    content.depth = np.full((3, 40, 50), 2000, dtype=np.uint16)
    content.depth[:, 3:9, 2:7] = 0
    path = write_bag(content, tmp_path / "a.mcap", row_message, "/points", with_info=False)
    found = open_sequence(path)
    beams = found.frame(2).beams
    assert beams is not None and len(beams.rays) == 40 * 50 - 30
    np.testing.assert_allclose(beams.depth_m, 1.0, rtol=1e-6)
    np.testing.assert_allclose(beams.time_s, 1e-5 * np.arange(len(beams.rays)), atol=1e-12)
    assert found.info.scan_s == pytest.approx(1e-5 * 1969)


def test_the_lens_of_a_bag_is_that_of_its_camera_info(scene: Path, tmp_path: Path) -> None:
    for name, model, coefficients in (
        ("rational_polynomial", DistortionModel.OPENCV, (0.1, -0.02, 1e-3, 0, 0, 0, 0, 0.01)),
        ("equidistant", DistortionModel.FISHEYE, (0.05, -0.01, 0.0, 0.0)),
    ):
        path = tmp_path / f"{name}.mcap"
        write_bag(Scene(scene), path, distortion=(name, coefficients))
        camera = open_sequence(path).camera(0)
        assert camera.distortion is not None
        assert camera.distortion.model is model
        assert camera.distortion.coefficients == coefficients
        assert not np.allclose(project(camera, np.array([0.1, 0.1, 1.0])), [5.5, 4.6], atol=1e-6)


def test_what_was_taken_of_a_bag_is_said(
    scene: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_bag(Scene(scene), tmp_path / "a.bag")
    with caplog.at_level(logging.INFO, logger="pcnav"):
        found = open_sequence(path)
    said = " ".join(caplog.messages)
    assert TOPIC in said
    assert "/camera/depth/camera_info" in said
    assert "the camera (cam_optical) in map by /tf" in said
    assert found.info.time_zero_s == EPOCH_NS / 1e9
    chosen = open_sequence(path, table=RecordingTable(topic=TOPIC, camera_px=(9.0, 9.0, 1.0, 1.0)))
    assert chosen.camera(0).fx == 9.0


def colour_message(bag: Any, header: Any, pixels: np.ndarray) -> tuple[str, Any]:
    kind, message = image_message(bag, header, pixels)
    message.encoding = "rgb8"
    return kind, message


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"topic": "/elsewhere"}, ("--topic", TOPIC, "got /elsewhere")),
        ({"camera_topic": TOPIC}, ("--camera-topic", "camera_info")),
        ({"frame_rate_hz": 5.0}, ("--rate", "of no use for a bag")),
    ],
)
def test_wrong_options_for_a_bag(
    scene: Path, tmp_path: Path, change: dict[str, Any], words: tuple[str, ...]
) -> None:
    path = write_bag(Scene(scene), tmp_path / "a.mcap")
    with pytest.raises(InputError) as refused:
        open_sequence(path, table=RecordingTable(**change))
    assert all(word in str(refused.value) for word in words), refused.value


def test_bags_that_hold_no_depth_are_refused_in_a_line(scene: Path, tmp_path: Path) -> None:
    colour = write_bag(Scene(scene), tmp_path / "colour.mcap", colour_message)
    with pytest.raises(InputError, match=r"expected depth \(16UC1, .*got pixels of 'rgb8'"):
        open_sequence(colour)
    bare = write_bag(Scene(scene), tmp_path / "bare.mcap", with_info=False)
    with pytest.raises(InputError, match="camera: expected CameraInfo beside the images"):
        open_sequence(bare)
    whole = bare.read_bytes()
    for name, content in (("cut", whole[: len(whole) // 2]), ("noise", b"\x89MCAP0\r\n" * 9)):
        path = tmp_path / f"{name}.mcap"
        path.write_bytes(content)
        with pytest.raises(InputError) as refused:
            open_sequence(path)
        assert str(path) in str(refused.value)
        assert "\n" not in str(refused.value)


def _npz(**arrays: np.ndarray) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        np.savez(folder / "a.npz", allow_pickle=True, **arrays)
        return folder / "a.npz"

    return write


def _header(words: str) -> Callable[[Path], Path]:
    """An array whose header says something, with hardly anything behind it."""

    def write(folder: Path) -> Path:
        text = words.encode() + b"\n"
        size = len(text).to_bytes(2, "little")
        (folder / "a.npy").write_bytes(b"\x93NUMPY\x01\x00" + size + text + b"\x00" * 9)
        return folder / "a.npy"

    return write


def _text(name: str, text: str) -> Callable[[Path], Path]:
    """A folder with one image and another file."""

    def write(folder: Path) -> Path:
        np.save(folder / "0.npy", np.ones((6, 8), dtype=np.float32))
        (folder / name).write_text(text)
        return folder

    return write


DEPTH = np.ones((2, 6, 8), dtype=np.float32)
K = np.array([[20.0, 0.0, 3.5], [0.0, 21.0, 2.5], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (_npz(a=DEPTH, b=DEPTH), ("depth", "expected one array depth", "a (2, 6, 8)")),
        (_npz(depth=DEPTH, K=K, depth_scale=np.array(np.inf)), ("depth_scale", "finite")),
        (_npz(depth=DEPTH, K=-K), ("K", "expected K (3, 3)")),
        (_npz(depth=DEPTH, K=K, time_s=np.zeros(3)), ("time_s", "expected 2 numbers")),
        (_npz(depth=DEPTH, K=K, time_s=np.array([0.0, 1e15])), ("time stamp", "seconds")),
        (_npz(depth=DEPTH, K=K, T_cam_world=np.ones((2, 4, 4))), ("T_cam_world[0]", "rigid")),
        (_npz(depth=DEPTH.astype(object)), ("file", "undamaged NumPy arrays")),
        (_header("{'descr': '<f4', 'shape': (2, 6, (8)"), ("file", "undamaged NumPy arrays")),
        (_header("{'descr': '<f4', 'fortran_order': False, 'shape': (9, 99, 99)}"), ("early",)),
        (_text("depth_camera.toml", "fx = 1.0"), ("depth_camera.toml", "fy", "missing")),
        (_text("depth_camera.json", '{"K": [1, 2]}'), ("K", "expected nine numbers")),
        (_text("depth_camera.json", "[" * 9999), ("depth_camera.json", "JSON")),
        (_text("depth_camera.toml", "fx=1\nfy=1\ncx=0\ncy=0\nwidth=9\nheight=6"), ("9 x 6",)),
        (_text("depth.txt", "0.0"), ("line 1", "expected timestamp filename")),
        (_text("depth.txt", "0.0 ../../0.npy"), ("line 1", "in the recording's folder")),
        (_text("depth.txt", "0.0 0.npy"), ("camera", "525 525 319.5 239.5")),
        (_text("a.md", ""), ("camera", "expected --camera FX FY CX CY")),
    ],
)
def test_what_is_wrong_is_said_in_one_line(
    write: Callable[[Path], Path], words: tuple[str, ...], tmp_path: Path
) -> None:
    with pytest.raises(InputError) as refused:
        open_recording(write(tmp_path))
    message = str(refused.value)
    assert all(word in message for word in words), message
    assert str(tmp_path) in message
    assert "\n" not in message


def as_pcd(scene: Scene, folder: Path) -> Path:
    """A folder of organised clouds, named by their time stamps."""
    folder.mkdir()
    height, width = scene.depth.shape[1:]
    v, u = np.mgrid[:height, :width]
    (fx, _, cx), (_, fy, cy), _ = scene.K
    for k, time_s in enumerate(scene.time_s.tolist()):
        z = np.where(scene.metres(k) > 0.0, scene.metres(k), np.nan).astype(np.float64)
        cloud = np.stack([(u - cx) / fx * z, (v - cy) / fy * z, z], axis=-1).astype(np.float32)
        write_pcd(folder / f"{time_s:.9f}.pcd", cloud, height=height)
    return folder


# The small scene has too few pixels for a cloud.
OF_CUBE = {name: WRITERS[name] for name in ("npz", "tum", "mcap", "bag of ROS 1")} | {"pcd": as_pcd}


def cube_of(shared_data: Path) -> Path:
    """The real recording, where it is."""
    cube = shared_data / "real" / "cube"
    if not cube.is_dir():
        pytest.skip(f"no real recording in {cube}")
    return cube


@pytest.mark.parametrize("name", OF_CUBE)
def test_the_real_cube_is_the_same_through_every_reader(
    name: str, shared_data: Path, tmp_path: Path
) -> None:
    cube = cube_of(shared_data)
    found = open_sequence(OF_CUBE[name](Scene(cube, 3), tmp_path / "cube"))
    ours = open_sequence(cube, table=RecordingTable(frames=3))
    if name != "pcd":
        expect_same(found, ours)
    else:
        # Its camera is fitted to coordinates that are rounded to 24 bits.
        assert np.allclose(found.intrinsics, ours.intrinsics, rtol=1e-6, atol=1e-4)
    for a, b in zip(found, ours, strict=True):
        # Its depths are floats, ours are integers times a unit.
        assert np.allclose(a.depth_m, b.depth_m, rtol=2e-7 if name == "pcd" else 0.0, atol=0.0)


def in_binary_time(cube: Path, folder: Path) -> Path:
    """The recording at 16 Hz: stamps that seconds, nanoseconds and decimals hold exactly.

    A start that is decided one frame earlier for a billionth of a second tells of no reader.
    """
    folder.mkdir()
    for name in ("depth", "sequence.toml", "cube85.obj"):
        (folder / name).symlink_to(cube / name)
    cameras = json.loads((cube / "scene_camera.json").read_text())
    for k, number in enumerate(sorted(cameras, key=int)):
        cameras[number]["timestamp_s"] = k / 16.0
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    return folder


@pytest.mark.study
def test_the_poses_of_the_real_cube_are_the_same_through_every_reader(
    shared_data: Path, tmp_path: Path
) -> None:
    cube, frames = in_binary_time(cube_of(shared_data), tmp_path / "cube"), 8
    scene = Scene(cube, frames)
    ways = {"bop": cube} | {
        name: OF_CUBE[name](scene, tmp_path / name) for name in ("tum", "mcap", "npz", "pcd")
    }
    # What formats of others do not hold lies beside them.
    said = (cube / "sequence.toml").read_text()
    for path in (path for name, path in ways.items() if name != "bop"):
        inside = path / "sequence.toml" if path.is_dir() else path.with_suffix(".toml")
        inside.write_text(said)
    pipeline = Pipeline(recording=RecordingTable(frames=frames))
    runs = {}
    for name, path in ways.items():
        out = tmp_path / "runs" / name
        run(path, out, pipeline, target_mesh=cube / "cube85.obj", report=False)
        runs[name] = read_run(out)
    poses = {name: found.trajectory.T_cam_target for name, found in runs.items()}
    claimed = np.array([word in CLAIMED for word in runs["bop"].status])
    first = poses.pop("bop")
    assert first is not None and np.count_nonzero(claimed) >= 3
    for name, T in poses.items():
        assert T is not None
        between = np.abs(np.linalg.inv(first[claimed]) @ T[claimed] - np.eye(4))
        if name == "pcd":
            # Its camera, fitted to coordinates of 24 bits, is another one in the seventh digit.
            assert between[-1].max() < 5e-3
        else:
            assert runs[name].status == runs["bop"].status and between.max() < 1e-12, name


def test_a_bag_of_another_library_is_read() -> None:
    """Written by mcap 1.6 and mcap-ros2-support 0.6 of Foxglove: chunks, compressed with zstd."""
    found = open_sequence(Path(__file__).parent / "data" / "by_mcap_library.mcap")
    assert found.times_s.tolist() == [0.0, 0.25, 0.5]
    assert found.info.time_zero_s == 1_700_000_000.0
    assert np.array_equal(found.intrinsics, [[20.0, 21.0, 3.5, 2.5]] * 3)
    for k, frame in enumerate(found):
        expected = (2000 + 100 * k + np.arange(48).reshape(6, 8)) / 1000.0
        expected[0, 0] = 0.0
        assert np.allclose(frame.depth_m, expected, rtol=1e-6)
        assert np.allclose(frame.T_cam_world[:3, 3], [-0.1 * k, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    "words",
    [
        ("--dst-storage", "sqlite3"),
        ("--dst-storage", "mcap", "--compress", "zstd", "--compress-mode", "message"),
    ],
)
def test_a_bag_that_a_public_tool_converted_is_read(
    words: tuple[str, ...], scene: Path, tmp_path: Path
) -> None:
    """`rosbags-convert` makes bags of ROS 2 from those of ROS 1."""
    bag = write_bag(Scene(scene), tmp_path / "one.bag")
    to = ("--dst", str(tmp_path / "two"), "--dst-typestore", "ros2_humble")
    command = [sys.executable, "-m", "rosbags.convert", "--src", str(bag), *to, *words]
    answer = subprocess.run(command, capture_output=True, text=True, check=False)
    assert answer.returncode == 0, answer.stderr
    expect_same(open_sequence(tmp_path / "two"), open_sequence(scene))
