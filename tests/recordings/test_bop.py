"""Reading BOP scenes: values, defaults and one-line errors."""

import json
import logging
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pcnav.core.camera import PinholeCamera
from pcnav.core.distortion import Distortion, DistortionModel
from pcnav.core.errors import InputError
from pcnav.recordings.bop import read_bop
from pcnav.recordings.sequence import DEFAULT_RANGE_SIGMA_M, stated_or_default_sigma

MakeScene = Callable[..., Path]


def expect_fault(path: Path, file: str, field: str, words: str) -> None:
    """Opening and reading every frame must fail in one line with file, field and expectation."""
    with pytest.raises(InputError) as caught:
        for _ in read_bop(path):
            pass
    error = caught.value
    assert error.file == path / file
    assert error.field.startswith(field)
    assert words in error.expected
    assert "\n" not in str(error)


def edit_scene(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    file = path / "scene_camera.json"
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))


def test_frame_values(scene: Path, caplog: pytest.LogCaptureFixture) -> None:
    sequence = read_bop(scene)
    assert not caplog.records
    assert len(sequence) == 3
    assert sequence.path == scene
    assert sequence.info.name == "small"
    assert sequence.info.range_sigma_m == 0.02
    assert sequence.info.mean_motion_rad_s == 0.0
    assert sequence.info.target_mesh is None
    frames = list(sequence)
    assert [frame.index for frame in frames] == [0, 1, 2]
    frame = frames[1]
    assert frame.time_s == 0.5
    assert frame.camera == PinholeCamera(8, 6, 20.0, 21.0, 3.5, 2.5)
    assert frame.depth_m.dtype == np.float32
    # 0.5 mm per unit; 65535 with no surface about it is a hole.
    np.testing.assert_allclose(frame.depth_m[2, 3], (19 * 100 + 1) * 0.0005, rtol=1e-7)
    assert frame.depth_m[0, 0] == 0.0
    assert frame.depth_m[1, 1] == 0.0
    expected = np.array([[0, -1, 0, 1.0], [1, 0, 0, 0], [0, 0, 1, -0.25], [0, 0, 0, 1]])
    np.testing.assert_allclose(frame.T_cam_world, expected)


def test_invalid_depth_when_the_sequence_says_so(tmp_path: Path, make_scene: MakeScene) -> None:
    toml = "[sensor]\nrange_sigma_m = 0.02\ninvalid_depth = 1900\n"
    sequence = read_bop(make_scene(tmp_path / "folder", toml=toml))
    depth_m = sequence.frame(0).depth_m
    assert depth_m[2, 3] == 0.0
    assert np.count_nonzero(depth_m) == 45
    assert sequence.info.name == "folder"


def test_sensor_of_the_sequence(tmp_path: Path, make_scene: MakeScene) -> None:
    toml = (
        '[sensor]\ndepth_is = "range"\ncamera_position_sd_m = 0.001\n'
        "camera_attitude_sd_deg = 0.5\nrow_readout_s = 0.02\n"
        'distortion_model = "fisheye"\ndistortion = [0.1, 0, -0.2, 0]\n'
    )
    sequence = read_bop(make_scene(tmp_path / "folder", toml=toml))
    assert sequence.info.range_sigma_m is None
    assert sequence.info.camera_position_sd_m == 0.001
    assert sequence.info.camera_attitude_sd_rad == pytest.approx(0.008726646, rel=1e-6)
    assert sequence.info.row_readout_s == 0.02
    assert sequence.form.depth_is == "range"
    assert sequence.form.distortion_model == "fisheye"
    assert sequence.form.distortion == (0.1, 0.0, -0.2, 0.0)
    assert stated_or_default_sigma(sequence.info) == DEFAULT_RANGE_SIGMA_M
    assert stated_or_default_sigma(sequence.info, 0.1) == 0.1


def test_numbers_need_not_follow_one_another(tmp_path: Path, make_scene: MakeScene) -> None:
    numbers = (4, 9, 10, 123)
    folder = make_scene(tmp_path / "s", numbers)
    edit_scene(folder, lambda c: c.update({k: c.pop(k) for k in sorted(c, reverse=True)}))
    sequence = read_bop(folder)
    assert [frame.index for frame in sequence] == [0, 1, 2, 3]
    assert [frame.time_s for frame in sequence] == [2.0, 4.5, 5.0, 61.5]
    for index, number in enumerate(numbers):
        assert sequence.frame(index).depth_m[0, 1] == pytest.approx((100 + number) * 0.0005)


def test_plain_scene_is_read_with_one_warning(
    tmp_path: Path, make_scene: MakeScene, caplog: pytest.LogCaptureFixture
) -> None:
    folder = make_scene(tmp_path / "plain", (3, 5), toml="")

    def strip(content: dict[str, Any]) -> None:
        for entry in content.values():
            for key in ("timestamp_s", "cam_R_w2c", "cam_t_w2c"):
                del entry[key]
            entry["elev"] = 3

    edit_scene(folder, strip)
    with caplog.at_level(logging.WARNING, logger="pcnav"):
        sequence = read_bop(folder)
    assert len(caplog.records) == 1
    message = caplog.records[0].getMessage()
    for words in ("sequence.toml", "timestamp_s", "at rest", "noise is unknown"):
        assert words in message
    assert [frame.time_s for frame in sequence] == [0.0, 1.0]
    np.testing.assert_array_equal(sequence.frame(1).T_cam_world, np.eye(4))
    assert sequence.info.name == "plain"


def test_target_mesh_is_relative_to_the_sequence(tmp_path: Path, make_scene: MakeScene) -> None:
    toml = '[sequence]\ntarget_mesh = "../sat.ply"\n[sensor]\nrange_sigma_m = 0.02\n'
    folder = make_scene(tmp_path / "s", toml=toml)
    expect_fault(folder, "sequence.toml", "sequence.target_mesh", "mesh file")
    other = tmp_path / "other.ply"
    assert read_bop(folder, target_mesh=other).info.target_mesh == other
    (tmp_path / "sat.ply").touch()
    assert read_bop(folder).info.target_mesh == tmp_path / "sat.ply"


def test_initial_priors(tmp_path: Path, make_scene: MakeScene) -> None:
    head = "[sensor]\nrange_sigma_m = 0.02\n[initial]\n"
    toml = head + "com_model_m = [0.1, 0, -0.2]\ninertia_ratios_sd = [0.1, 0.2, 0.3, 0.4, 0.5]\n"
    prior = read_bop(make_scene(tmp_path / "good", toml=toml)).info.initial
    assert prior is not None
    np.testing.assert_array_equal(prior.com_model_m, [0.1, 0.0, -0.2])
    np.testing.assert_array_equal(prior.inertia_ratios_sd, [0.1, 0.2, 0.3, 0.4, 0.5])
    assert prior.com_sd_m is None
    for k, (line, field) in enumerate(
        (
            ("com_model_m = [0.1, 0.2]", "initial.com_model_m"),
            ("com_sd_m = [0.1, 0.0, 0.1]", "initial.com_sd_m.1"),
            ("inertia_ratios = [1, 3, 0, 0, 0]", "initial.inertia_ratios"),
            ("com_model_m = [0.1, nan, 0.2]", "initial.com_model_m.1"),
        )
    ):
        folder = make_scene(tmp_path / str(k), toml=head + line + "\n")
        expect_fault(folder, "sequence.toml", field, "")


@pytest.mark.parametrize(
    ("toml", "field"),
    [
        ("[sensor]\nrange_sigma_m = 0\n", "sensor.range_sigma_m"),
        ("[sensor]\nrange_sigma_m = -0.1\n", "sensor.range_sigma_m"),
        ("[sensor]\nrange_sigma_m = nan\n", "sensor.range_sigma_m"),
        ('[sensor]\nrange_sigma_m = "0.02"\n', "sensor.range_sigma_m"),
        ('[sensor]\ndepth_is = "depth"\n', "sensor.depth_is"),
        ("[sensor]\nrow_readout_s = -1\n", "sensor.row_readout_s"),
        ("[sensor]\ncamera_attitude_sd_deg = -1\n", "sensor.camera_attitude_sd_deg"),
        ("[sensor]\ndistortion = [0.1]\n", "sensor"),
        ("[sensor]\nrange_sigma_m = 0.02\nsigma = 1\n", "sensor.sigma"),
        ("[sensor]\nrange_sigma_m = 0.02\ninvalid_depth = -1\n", "sensor.invalid_depth"),
        ("[orbits]\n[sensor]\nrange_sigma_m = 0.02\n", "orbits"),
        (
            "[orbit]\nmean_motion_rad_s = -1\n[sensor]\nrange_sigma_m = 1\n",
            "orbit.mean_motion_rad_s",
        ),
        ("[sequence]\nname = 3\n[sensor]\nrange_sigma_m = 0.02\n", "sequence.name"),
        ("[sensor\n", "file"),
    ],
)
def test_sequence_file_faults(tmp_path: Path, make_scene: MakeScene, toml: str, field: str) -> None:
    expect_fault(make_scene(tmp_path / "s", toml=toml), "sequence.toml", field, "")


def set_field(number: str, field: str, value: object) -> Callable[[dict[str, Any]], object]:
    return lambda content: content[number].__setitem__(field, value)


def drop_field(number: str, field: str) -> Callable[[dict[str, Any]], object]:
    return lambda content: content[number].pop(field)


NAN = float("nan")
K = "cam_K"


@pytest.mark.parametrize(
    ("change", "field", "words"),
    [
        (set_field("1", K, [1.0] * 8), "1.cam_K", "9 items"),
        (set_field("1", K, [20, 0, 3, 0, 20, NAN, 0, 0, 1]), "1.cam_K.5", "finite"),
        (set_field("1", K, [0, 0, 3, 0, 20, 2, 0, 0, 1]), "1.cam_K", "focal lengths above 0"),
        (set_field("1", K, [20, 0, 3, 0, -20, 2, 0, 0, 1]), "1.cam_K", "focal lengths above 0"),
        (set_field("2", K, [20, 0.1, 3, 0, 20, 2, 0, 0, 1]), "2.cam_K", "no skew"),
        (set_field("2", K, [20, 0, 3, 0, 20, 2, 0, 0, 2]), "2.cam_K", "0 0 1"),
        (set_field("2", K, "identity"), "2.cam_K", "array"),
        (drop_field("2", K), "2.cam_K", "missing"),
        (set_field("0", "depth_scale", 0), "0.depth_scale", "greater than 0"),
        (set_field("0", "depth_scale", -1.0), "0.depth_scale", "greater than 0"),
        (set_field("0", "depth_scale", float("inf")), "0.depth_scale", "finite"),
        (drop_field("1", "depth_scale"), "1.depth_scale", "missing"),
        (set_field("2", "timestamp_s", 1.7e12), "2.timestamp_s", "expected seconds"),
        (set_field("2", "timestamp_s", NAN), "2.timestamp_s", "finite"),
        (drop_field("1", "timestamp_s"), "1.timestamp_s", "other frames have it"),
        (set_field("1", "cam_R_w2c", [1.0] * 9), "1.cam_R_w2c", "rotation matrix"),
        (set_field("1", "cam_R_w2c", [1, 0, 0, 0, 1, 0, 0, 0, -1]), "1.cam_R_w2c", "determinant"),
        (set_field("1", "cam_R_w2c", [1, 0, 0, 0, 1, 0, 0, 0, NAN]), "1.cam_R_w2c.8", "finite"),
        (drop_field("0", "cam_R_w2c"), "0.cam_R_w2c", "other frames have it"),
        (set_field("0", "cam_t_w2c", [0.0, 1.0]), "0.cam_t_w2c", "3 items"),
        (lambda c: [e.pop("cam_t_w2c") for e in c.values()], "0.cam_t_w2c", "both"),
        (lambda c: c.update(frame=c["0"]), "'frame'", "frame number"),
        (lambda c: c.update({"00": c["0"]}), "frames", "once"),
        (lambda c: c.clear(), "frames", "at least one"),
    ],
)
def test_scene_camera_faults(
    scene: Path, change: Callable[[dict[str, Any]], object], field: str, words: str
) -> None:
    edit_scene(scene, change)
    expect_fault(scene, "scene_camera.json", field, words)


def test_folder_and_file_faults(tmp_path: Path, scene: Path) -> None:
    expect_fault(tmp_path / "none", ".", "folder", "expected a folder")
    file = scene / "scene_camera.json"
    text = file.read_text()
    for broken in (text[:100], "[1, 2]", "", "\xff"):
        file.write_bytes(broken.encode("latin-1"))
        expect_fault(scene, "scene_camera.json", "file", "")
    file.unlink()
    expect_fault(scene, "scene_camera.json", "file", "expected a readable file")


def test_missing_images(scene: Path) -> None:
    image = scene / "depth" / "000001.png"
    sequence = read_bop(scene)
    image.unlink()
    expect_fault(scene, "depth/000001.png", "file", "frame 1")
    # Lost after opening.
    with pytest.raises(InputError, match="expected a depth PNG"):
        sequence.frame(1)
    for other in (scene / "depth").iterdir():
        other.unlink()
    (scene / "depth").rmdir()
    expect_fault(scene, "depth", "folder", "depth images")


def test_every_truncation_is_detected(scene: Path) -> None:
    image = scene / "depth" / "000002.png"
    data = image.read_bytes()
    for length in range(len(data)):
        image.write_bytes(data[:length])
        expect_fault(scene, "depth/000002.png", "file", "expected a")


def test_damaged_pixels_are_detected(scene: Path) -> None:
    image = scene / "depth" / "000000.png"
    data = bytearray(image.read_bytes())
    start = data.index(b"IDAT") + 12
    data[start : start + 8] = b"\x00" * 8
    image.write_bytes(bytes(data))
    expect_fault(scene, "depth/000000.png", "file", "undamaged")


@pytest.mark.parametrize(
    ("mode", "words"), [("L", "8-bit grey"), ("RGB", "colour"), ("P", "palette")]
)
@pytest.mark.parametrize("number", [0, 2])
def test_wrong_pixels(scene: Path, mode: str, words: str, number: int) -> None:
    Image.new(mode, (8, 6)).save(scene / "depth" / f"{number:06d}.png")
    expect_fault(scene, f"depth/{number:06d}.png", "pixels", f"16-bit grey depth, got {words}")


def test_not_a_png_and_other_size(scene: Path) -> None:
    image = scene / "depth" / "000001.png"
    Image.fromarray(np.ones((6, 9), np.uint16)).save(image)
    expect_fault(
        scene, "depth/000001.png", "image size", "8 x 6 px as in the first frame, got 9 x 6"
    )
    Image.new("L", (8, 6)).save(image, "BMP")
    expect_fault(scene, "depth/000001.png", "file", "expected a PNG")


def test_index_out_of_range(scene: Path) -> None:
    sequence = read_bop(scene)
    for index in (-1, 3):
        with pytest.raises(IndexError):
            sequence.frame(index)


def test_long_scene_stays_small_in_memory(tmp_path: Path, make_scene: MakeScene) -> None:
    folder = make_scene(tmp_path / "s", (0,))
    entry = json.loads((folder / "scene_camera.json").read_text())["0"]
    content = {str(k): {**entry, "timestamp_s": float(k)} for k in range(5000)}
    (folder / "scene_camera.json").write_text(json.dumps(content))
    del content
    for k in range(1, 5000):
        (folder / "depth" / f"{k:06d}.png").hardlink_to(folder / "depth" / "000000.png")
    tracemalloc.start()
    sequence = read_bop(folder)
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(sequence) == 5000
    # 200 bytes a frame of arrays; the parsed dictionaries would take over 2 kB each.
    assert held < 2_000_000


def test_distortion_beside_the_camera_matrix_is_read(scene: Path) -> None:
    def bend(content: dict[str, Any]) -> None:
        for entry in content.values():
            entry["cam_dist"] = [-0.1, 0.02, 0.0, 0.001, 0.0]

    edit_scene(scene, bend)
    lens = read_bop(scene).frame(0).camera.distortion
    assert lens == Distortion(DistortionModel.OPENCV, (-0.1, 0.02, 0.0, 0.001, 0.0))
    # What the sequence itself states goes before it.
    text = (scene / "sequence.toml").read_text()
    stated = 'distortion_model = "fisheye"\ndistortion = [0.1, 0.0, 0.0, 0.0]\n'
    (scene / "sequence.toml").write_text(text + stated)
    lens = read_bop(scene).frame(0).camera.distortion
    assert lens == Distortion(DistortionModel.FISHEYE, (0.1, 0.0, 0.0, 0.0))


def test_distortion_of_another_number_of_terms_is_refused(scene: Path) -> None:
    def bend(content: dict[str, Any]) -> None:
        for entry in content.values():
            entry["cam_dist"] = [-0.1, 0.02, 0.0, 0.001, 0.0, 0.0]

    edit_scene(scene, bend)
    expect_fault(scene, "scene_camera.json", "0.cam_dist", "expected 4, 5 or 8 numbers")
    edit_scene(scene, lambda content: content["1"].pop("cam_dist"))
    expect_fault(scene, "scene_camera.json", "1.cam_dist", "missing")
