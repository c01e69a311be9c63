"""Recordings of other tools and results, read as users read them: by commands."""

import contextlib
import io
import sys
from collections.abc import Callable
from pathlib import Path
from unittest import mock

import numpy as np
import tifffile

from pcnav import cli
from pcnav.config.recording import RecordingTable
from pcnav.config.region import RegionTable
from pcnav.config.shipped import shipped_mesh
from pcnav.recordings.intake import Intake
from pcnav.recordings.opening import open_sequence
from tests.cli.answers import PIPELINE
from tests.fuzz.subject import RefusedError, Subject
from tests.recordings.conftest import write_scene
from tests.recordings.other_formats import TOPIC, Scene, as_npz, as_tum, write_bag
from tests.recordings.test_bop_data_sets import write_data_set
from tests.recordings.test_clouds import points, write_pcd
from tests.recordings.test_other_formats import (
    CAMERA,
    cloud_message,
    compressed_message,
    folder_of,
)

_FRAMES = tuple(range(4))
_SAID = """
[sequence]
name = "small"
time_zero_s = 0.0
[orbit]
mean_motion_rad_s = 0.001
[sensor]
range_sigma_m = 0.02
invalid_depth = 7
depth_is = "range"
camera_position_sd_m = 0.001
camera_attitude_sd_deg = 0.01
row_readout_s = 0.02
distortion_model = "opencv"
distortion = [0.01, -0.02, 0.001, 0.001]
[calibration]
focal_sd = 0.001
centre_sd_px = 0.25
range_offset_sd_m = 0.0025
range_scale_sd = 0.001
mesh_scale_sd = 0.001
stamp_jitter_sd_s = 0.0025
time_offset_sd_s = 0.01
mount_position_sd_m = 0.001
mount_attitude_sd_deg = 0.02
"""


def pcnav(*arguments: object) -> None:
    """A command by its entry point. Raises `RefusedError` with what stands on stderr at its end."""
    said = io.StringIO()
    words = ["pcnav", *map(str, arguments)]
    with mock.patch.object(sys, "argv", words), contextlib.redirect_stderr(said):
        try:
            cli.main()
        except SystemExit as ended:
            code = ended.code
    lines = said.getvalue().splitlines()
    # Warnings are read in the same terminal as errors are.
    strange = next((line for line in lines if not line.isprintable()), None)
    if strange is not None:
        raise RefusedError(strange)
    if code:
        raise RefusedError(lines[-1])


def _seen(recording: Path, *options: object) -> None:
    """What is in a recording is said, and its frames are written in our own format."""
    refused = None
    converted = ("convert", recording, *options, "-o", recording.parent / "converted")
    for words in (("info", recording, *options), converted):
        try:
            pcnav(*words)
        except RefusedError as error:
            refused = error
    if refused is not None:
        raise refused


def _scene_in(folder: Path) -> Scene:
    """A scene of our own, beside the folder that another form of it is to lie in."""
    folder.mkdir()
    return Scene(write_scene(folder.parent / f"{folder.name}-scene", _FRAMES))


def _bag(name: str, **how: object) -> Callable[[Path], None]:
    def build(folder: Path) -> None:
        write_bag(_scene_in(folder), folder / name, **how)  # type: ignore[arg-type]

    return build


def _cloud_bag(folder: Path) -> None:
    scene = _scene_in(folder)
    scene.depth = np.full((len(_FRAMES), 40, 50), 2000, dtype=np.uint16)
    scene.depth[:, 3:9, 2:7] = 0
    write_bag(scene, folder / "a.mcap", cloud_message, "/points", with_info=False)


def _tum(folder: Path) -> None:
    scene = _scene_in(folder)
    as_tum(scene, folder / "a")
    (folder / "a" / "target.tum").write_text(scene.pose_lines())


def _npz(folder: Path) -> None:
    scene = _scene_in(folder)
    with np.load(as_npz(scene, folder / "a.npz")) as stored:
        arrays = dict(stored)
    arrays["true_T_cam_model"] = arrays["T_cam_world"]
    np.savez(folder / "a.npz", allow_pickle=False, **arrays)


def _stack(suffix: str) -> Callable[[Path], None]:
    def build(folder: Path) -> None:
        scene = _scene_in(folder)
        path = folder / f"a{suffix}"
        if suffix == ".npy":
            np.save(path, scene.depth)
        else:
            # Or four frames are taken for the channels of one.
            tifffile.imwrite(path, scene.depth, photometric="minisblack")
        (folder / "depth_camera.toml").write_text(scene.camera_toml)
        (folder / "a.toml").write_text(_SAID)

    return build


def _images(suffix: str) -> Callable[[Path], None]:
    def build(folder: Path) -> None:
        folder_of(suffix)(_scene_in(folder), folder / "a")

    return build


def _clouds(data: str) -> Callable[[Path], None]:
    def build(folder: Path) -> None:
        (folder / "a").mkdir(parents=True)
        for name in ("10.25", "10.5", "11.0"):
            write_pcd(folder / "a" / f"{name}.pcd", points(), data)

    return build


def _data_set(folder: Path) -> None:
    write_data_set(folder / "set")


def _read_data_set(folder: Path) -> None:
    scene = folder / "set" / "test" / "000007"
    found = open_sequence(scene, table=RecordingTable(object=9))
    for _ in Intake(found, RegionTable(masks="visib"), skip_bad_frames=False):
        pass
    _seen(scene, "--object", 9)


def _whole_settings(folder: Path) -> None:
    write_scene(folder / "a", _FRAMES, toml=_SAID)


def _beside(name: str, *options: object) -> Callable[[Path], None]:
    return lambda folder: _seen(folder / name, *options)


def _result(folder: Path) -> None:
    """A recording and what was found in it."""
    folder.mkdir()
    small = PIPELINE.replace("128", "64").replace("range_sigma_m = 0.01", "range_sigma_m = 0.005")
    (folder / "six.toml").write_text(small)
    pcnav("simulate", folder / "six.toml", "-o", folder / "sequence")
    settings = folder / "sequence" / "sequence.toml"
    mesh = shipped_mesh("boxsat")
    lines = settings.read_text().splitlines()
    kept = [line for line in lines if not line.startswith("target_mesh")]
    place = kept.index("[sequence]") + 1
    # Copies lie elsewhere.
    kept.insert(place, f'target_mesh = "{mesh}"')
    settings.write_text("\n".join(kept) + "\n")
    (folder / "p.toml").write_text('target_mesh = "boxsat"\n[filter]\n[perception]\n')
    _run_it(folder, "result")


def _run_it(folder: Path, name: str) -> None:
    how = ("--pipeline", folder / "p.toml", "-o", folder / name, "--no-report")
    pcnav("run", folder / "sequence", *how)


def _use_result(folder: Path) -> None:
    """Forecast it, and export it in every format."""
    result = folder / "result"
    words = ("--point", "bus_x_plus", "--ahead", 4, "--step", 2, "-o", folder / "f.csv")
    commands: list[tuple[object, ...]] = [("forecast", result, *words)]
    for form in ("tum", "kitti", "csv", "bop", "oem", "aem", "npz", "mcap"):
        told = ("--sequence", folder / "sequence", "--epoch", "2026-03-01T12:00:00")
        commands.append(("export", result, "--to", form, "-o", folder / f"x.{form}", *told))
    refused = None
    for command in commands:
        try:
            pcnav(*command)
        except RefusedError as error:
            refused = error
    if refused is not None:
        raise refused


_BAGS = ("a.bag", "a.mcap", "a")
_RESULT = ("result/*.json", "result/*.csv", "result/*.npz", "result/*.toml", "result/*.tum")
RECORDING_SUBJECTS = (
    *(Subject(f"bag {name}", _bag(name), (name, f"{name}/*"), _beside(name)) for name in _BAGS),
    Subject(
        "bag of compressed depth",
        _bag("a.mcap", message=compressed_message, topic=f"{TOPIC}/compressedDepth"),
        ("*.mcap",),
        _beside("a.mcap"),
    ),
    Subject("bag of clouds", _cloud_bag, ("*.mcap",), _beside("a.mcap")),
    Subject("TUM RGB-D", _tum, ("a/*.t*", "a/depth/*"), _beside("a")),
    Subject("npz stack", _npz, ("*.npz",), _beside("a.npz")),
    Subject("npy stack", _stack(".npy"), ("*",), _beside("a.npy")),
    Subject("tiff stack", _stack(".tif"), ("*",), _beside("a.tif")),
    *(
        Subject(f"folder of {suffix}", _images(suffix), ("a/*",), _beside("a"))
        for suffix in (".png", ".exr", ".npy", ".tiff")
    ),
    *(
        Subject(f"clouds {data}", _clouds(data), ("a/*",), _beside("a", "--camera", *CAMERA))
        for data in ("binary", "ascii")
    ),
    Subject(
        "BOP data set",
        _data_set,
        ("set/test/000007/*.json", "set/test/000007/mask_visib/*", "set/models/*"),
        _read_data_set,
    ),
    Subject("sequence.toml whole", _whole_settings, ("a/*.toml",), _beside("a")),
    Subject("result", _result, _RESULT, _use_result),
    Subject(
        "estimation",
        _result,
        ("sequence/*.toml", "sequence/scene_camera.json", "p.toml", "sequence/depth/*"),
        lambda folder: _run_it(folder, "again"),
    ),
)
"""Every format of other tools, the tables that say the rest, and what a result is used for."""
