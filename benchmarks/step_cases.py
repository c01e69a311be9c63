"""What steps are timed on: shipped satellites, meshes of many faces, and larger images."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import trimesh

from benchmarks.scenes import Case, load, record, shortened
from pcnav.config.length_unit import LengthUnit

_ROWS_OF_FACES = {"8,000 faces": 45, "500,000 faces": 354}
"""Of points from pole to pole, and half as many as around: a row of faces has four for each."""
_SIZES_PX = ((640, 480), (1280, 720))
_DIAMETER_M = 6.0


def bumpy_body(rows: int) -> trimesh.Trimesh:
    """A closed body without symmetry, curved all over, of about ``4 rows^2`` faces."""
    mesh = trimesh.creation.uv_sphere(radius=0.5 * _DIAMETER_M, count=[rows, rows])
    x, y, z = (mesh.vertices / (0.5 * _DIAMETER_M)).T
    bumps = 0.12 * x * y + 0.15 * x**3 - 0.1 * y * z**2 + 0.08 * np.sin(5.0 * z + 2.0 * x)
    mesh.vertices = mesh.vertices * np.array([1.0, 0.8, 0.62]) * (1.0 + bumps)[:, None]
    return mesh


def step_cases(frames: int, folder: Path) -> Iterator[Case]:
    """Each case, simulated when it is asked for."""
    for name in ("boxsat", "cubesat6u"):
        yield load(record(name, shortened(name, frames), folder / name))
    usual = shortened("boxsat", frames)
    for name, rows in _ROWS_OF_FACES.items():
        mesh = folder / f"{rows}.ply"
        bumpy_body(rows).export(mesh)
        pipeline = usual.model_copy(
            update={"target_mesh": str(mesh), "mesh_unit": LengthUnit.METRE}
        )
        yield load(record(name, pipeline, folder / str(rows)))
    for width_px, height_px in _SIZES_PX:
        size = {"width_px": width_px, "height_px": height_px}
        pipeline = usual.model_copy(update={"camera": usual.camera.model_copy(update=size)})
        yield load(record("boxsat", pipeline, folder / str(width_px)))
