"""Damaged recordings and wrong first poses, through the real entry point."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.cli.answers import camera, expect_refusal, png, truncate
from tests.commands import Pcnav


def store_eight_bits(sequence: Path) -> None:
    Image.fromarray(np.zeros((128, 128), dtype=np.uint8)).save(sequence / png(0))


def resize_one(sequence: Path) -> None:
    Image.fromarray(np.zeros((64, 128), dtype=np.uint16)).save(sequence / png(3))


def text(name: str, old: str, new: str) -> Callable[[Path], None]:
    """Replaces text in a file of the sequence; an empty `old` stands for the whole text."""

    def change(sequence: Path) -> None:
        before = (sequence / name).read_text()
        assert old in before
        (sequence / name).write_text(before.replace(old, new, 1) if old else new)

    return change


def folder_instead(name: str) -> Callable[[Path], None]:
    """Puts a folder where a file belongs."""

    def change(sequence: Path) -> None:
        (sequence / name).unlink()
        (sequence / name).mkdir()

    return change


def file_instead(sequence: Path) -> None:
    shutil.rmtree(sequence)
    sequence.write_text("")


def not_text(name: str) -> Callable[[Path], None]:
    """Puts a byte into a file that UTF-8 does not have."""

    def change(sequence: Path) -> None:
        (sequence / name).write_bytes((sequence / name).read_bytes() + b"# caf\xe9\n")

    return change


REFLECTION = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0]
SHEAR = [1.0, 0.2, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
SCENE = "scene_camera.json"
BROKEN: dict[str, tuple[Callable[[Path], object], tuple[str, ...]]] = {
    "missing image": (lambda s: (s / png(2)).unlink(), (png(2), "file", "frame 2")),
    "image cut short": (truncate, (png(4), "file", "whole PNG")),
    "8-bit image": (store_eight_bits, (png(0), "pixels", "16-bit")),
    "image size changes": (resize_one, (png(3), "image size", "128 x 128", "128 x 64")),
    "folder for an image": (
        folder_instead(png(1)),
        (png(1), "file", "PNG"),
    ),
    "no images": (lambda s: shutil.rmtree(s / "depth"), ("depth", "folder")),
    "short matrix": (camera(1, "cam_K", [1.0] * 8), (SCENE, "1.cam_K", "9 items")),
    "not a rotation": (camera(2, "cam_R_w2c", SHEAR), (SCENE, "2.cam_R_w2c", "rotation matrix")),
    "reflection": (camera(2, "cam_R_w2c", REFLECTION), (SCENE, "2.cam_R_w2c", "determinant 1")),
    "nan time": (camera(1, "timestamp_s", float("nan")), (SCENE, "1.timestamp_s", "finite")),
    "nan translation": (
        camera(1, "cam_t_w2c", [0.0, float("nan"), 0.0]),
        (SCENE, "1.cam_t_w2c", "finite"),
    ),
    "no depth scale": (camera(0, "depth_scale", 0), (SCENE, "0.depth_scale", "greater than 0")),
    "no frames": (text(SCENE, "", "{}"), (SCENE, "frames", "at least one frame")),
    "comment in JSON": (text(SCENE, "{", "// mine\n{"), (SCENE, "file", "JSON")),
    "folder for a file": (
        folder_instead(SCENE),
        (SCENE, "file", "readable"),
    ),
    "unknown key": (
        text("sequence.toml", "range_sigma_m", "noise_m = 1.0\nrange_sigma_m"),
        ("sequence.toml", "sensor.noise_m", "unknown key"),
    ),
    "not UTF-8": (not_text("sequence.toml"), ("sequence.toml", "file", "utf-8")),
    "mesh moved": (
        text("sequence.toml", "boxsat.obj", "gone.obj"),
        ("sequence.toml", "sequence.target_mesh", "gone.obj"),
    ),
    "no mesh": (
        lambda s: (s / "sequence.toml").write_text("[sensor]\nrange_sigma_m = 0.01\n"),
        ("sequence", "target_mesh", "--target"),
    ),
    "truth damaged": (
        text("truth.csv", "\n0.25,", "\nx,"),
        ("truth.csv", "line 3", "expected a number"),
    ),
    "no scene": (shutil.rmtree, ("sequence", "folder", SCENE)),
    "file for the folder": (
        file_instead,
        ("sequence", "folder", SCENE),
    ),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_bad_sequence_is_one_line_and_leaves_nothing(
    pcnav: Pcnav, sequence: Path, tmp_path: Path, fault: str
) -> None:
    damage, words = BROKEN[fault]
    damage(sequence)
    expect_refusal(pcnav("run", sequence, "-o", tmp_path / "new" / "result"), *words)
    assert {path.name for path in tmp_path.iterdir()} <= {"sequence"}


# Bad meshes.


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--initial-pose", "1 2 3"), ("--initial-pose", "tx ty tz qx qy qz qw")),
        (("--initial-pose", "nowhere.tum"), ("nowhere.tum", "tx ty tz qx qy qz qw")),
        (("--initial-pose-sd", "0.1", "5"), ("--initial-pose-sd", "expected --initial-pose")),
        (
            ("--initial-pose", "-0.1 0 18 0 0 0 1", "--initial-pose-sd", "0", "5"),
            ("position_sd_m", "greater than 0"),
        ),
    ],
)
def test_a_wrong_first_pose_is_one_line(
    pcnav: Pcnav, sequence: Path, tmp_path: Path, options: tuple[str, ...], words: tuple[str, ...]
) -> None:
    answer = pcnav("run", sequence, "-o", tmp_path / "result", *options)
    expect_refusal(answer, *words)
    assert not (tmp_path / "result").exists()


# What exists already.
