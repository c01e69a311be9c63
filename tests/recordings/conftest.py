"""A small scene in our own format, built without the package's writer."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

SIZE = (8, 6)
Scene = dict[str, dict[str, Any]]


def camera_entry(number: int) -> dict[str, Any]:
    """One entry of scene_camera.json: a quarter turn about z and a shift of 1 m."""
    return {
        "cam_K": [20.0, 0.0, 3.5, 0.0, 21.0, 2.5, 0.0, 0.0, 1.0],
        "depth_scale": 0.5,
        "timestamp_s": 0.5 * number,
        "cam_R_w2c": [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0],
        "cam_t_w2c": [1000.0, 0.0, -250.0],
    }


def units(number: int) -> np.ndarray:
    """Stored depth of one frame."""
    image = np.arange(48, dtype=np.uint16).reshape(SIZE[1], SIZE[0]) * 100 + number
    image[0, 0] = 0
    image[1, 1] = 65535
    return image


def write_scene(
    folder: Path, numbers: tuple[int, ...] = (0, 1, 2), toml: str | None = None
) -> Path:
    (folder / "depth").mkdir(parents=True)
    scene = {str(number): camera_entry(number) for number in numbers}
    (folder / "scene_camera.json").write_text(json.dumps(scene))
    for number in numbers:
        Image.fromarray(units(number)).save(folder / "depth" / f"{number:06d}.png")
    text = '[sequence]\nname = "small"\n[sensor]\nrange_sigma_m = 0.02\n' if toml is None else toml
    if text:
        (folder / "sequence.toml").write_text(text)
    return folder


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Three frames, 0.5 s apart."""
    return write_scene(tmp_path / "scene")


@pytest.fixture
def make_scene() -> Callable[..., Path]:
    """The builder itself, for scenes that differ."""
    return write_scene
