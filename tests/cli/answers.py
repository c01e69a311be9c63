"""What the command line answers, as users meet it: every test goes through the real entry point."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import trimesh

from pcnav.config.shipped import shipped_mesh
from tests.commands import Answer

FRAMES = 6
PIPELINE = """
seed = 7
target_mesh = "boxsat"
[scenario]
frames = 6
frame_rate_hz = 4.0
[orbit]
r_hill_m = [18.0, 0.0, 0.0]
[body]
attitude_rotvec_deg = [25.0, 40.0, -30.0]
omega_body_deg_s = [4.0, -2.8, 5.0]
inertia_ratios = [0.577, 0.735, -0.02, 0.06, -0.045]
[camera]
width_px = 128
height_px = 128
horizontal_fov_deg = 36.0
[noise]
range_sigma_m = 0.01
"""


def satellite(name: str) -> Path:
    """The mesh of a shipped satellite."""
    mesh = shipped_mesh(name)
    assert mesh is not None
    return mesh


def content(folder: Path) -> dict[str, bytes]:
    """Every file of a folder by its path within."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in files}


def expect_refusal(answer: Answer, *words: str | Path) -> None:
    """One line of error, every word in it, and exit code 2."""
    assert answer.code == 2, answer
    # What led to it may have been warned of.
    lines = [line for line in answer.error_lines if not line.startswith("WARNING: ")]
    assert len(lines) == 1, answer.err
    (line,) = lines
    assert line.startswith("error: ")
    for word in words:
        assert str(word) in line
    assert answer.out == ""


def png(number: int) -> str:
    return f"depth/{number:06d}.png"


def truncate(sequence: Path) -> None:
    file = sequence / png(4)
    file.write_bytes(file.read_bytes()[:-40])


def camera(number: int, field: str, value: object) -> Callable[[Path], None]:
    """Sets a field of scene_camera.json."""

    def change(sequence: Path) -> None:
        file = sequence / "scene_camera.json"
        scene: dict[str, dict[str, Any]] = json.loads(file.read_text())
        scene[str(number)][field] = value
        file.write_text(json.dumps(scene))

    return change


def boxsat(scale: float, path: Path) -> Path:
    mesh = trimesh.load_mesh(satellite("boxsat"))
    mesh.apply_scale(scale)
    mesh.export(path)
    return path


def written(path: Path, words: bytes) -> Path:
    path.write_bytes(words)
    return path
