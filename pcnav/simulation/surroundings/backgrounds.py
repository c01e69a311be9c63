"""Backgrounds of a simulated target: wall, Earth, table, and things that stand about."""

from collections.abc import Callable, Mapping

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from pcnav.config.surroundings import BackgroundKind, BackgroundTable
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.simulation.surroundings.part import Part, Stage, ball, box, joined, sheet
from pcnav.target.mesh import plane_axes

_EARTH_BEHIND_M = 4e5
_WALL_WIDTHS = 8.0
"""Width of a wall over its distance from the camera: it fills any view up to 150 degrees."""
_TABLE_DIAMETERS = 4.0
_RINGS, _SPOKES = 96, 256
"""Of the mesh of the Earth's near side."""
_CLUTTER_DIAMETERS = (0.2, 0.7)
_CLUTTER_REACH = (0.6, 1.5)
"""Where things stand, from the target's middle, in its diameters."""


def backgrounds(table: BackgroundTable, stage: Stage, rng: np.random.Generator) -> list[Part]:
    """The parts of a background; none where there is none."""
    on_kind, on_clutter = rng.spawn(2)
    make = _MADE.get(table.kind)
    parts = [] if make is None else [make(table, stage, on_kind)]
    if table.clutter_count:
        parts.append(_clutter(table, stage, on_clutter))
    return parts


def _wall(table: BackgroundTable, stage: Stage, rng: np.random.Generator) -> Part:
    middle = stage.middle_cam
    behind = stage.diameter_m if table.behind_m is None else table.behind_m
    distance = float(middle[2]) + behind
    angle = rng.uniform(0.0, 2.0 * np.pi)
    tilt = exp_rotation(np.deg2rad(table.tilt_deg) * np.array([np.cos(angle), np.sin(angle), 0.0]))
    width = _WALL_WIDTHS * distance
    mesh = sheet(width, width, table.roughness_m, rng)
    # Its normal looks at the camera.
    facing = tilt @ np.diag([1.0, -1.0, -1.0])
    mesh.apply_transform(make_transform(facing, np.array([middle[0], middle[1], distance])))
    return Part(mesh, stage.at_rest(), table.return_fraction)


def _earth(table: BackgroundTable, stage: Stage, rng: np.random.Generator) -> Part:
    """The near side of the sphere, as far as the camera sees it."""
    behind = _EARTH_BEHIND_M if table.behind_m is None else table.behind_m
    radius, altitude = table.earth_radius_m, float(stage.middle_cam[2]) + behind
    # The horizon is at acos(R / (R + h)) from the point below the camera.
    horizon = float(np.arccos(radius / (radius + altitude)))
    mesh = _cap(radius, 1.001 * horizon)
    # The cap's top is at +z of its own frame; that looks at the camera.
    turned = np.diag([1.0, -1.0, -1.0])
    mesh.apply_transform(make_transform(turned, np.array([0.0, 0.0, radius + altitude])))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    axis = np.array([np.cos(angle), np.sin(angle), 0.0])
    mesh.apply_transform(
        make_transform(exp_rotation(np.deg2rad(table.earth_offset_deg) * axis), np.zeros(3))
    )
    return Part(mesh, stage.at_rest(), table.return_fraction)


def _cap(radius_m: float, half_angle_rad: float) -> trimesh.Trimesh:
    """The part of a sphere about the origin within an angle of +z."""
    polar = half_angle_rad * np.arange(1, _RINGS + 1) / _RINGS
    azimuth = 2.0 * np.pi * np.arange(_SPOKES) / _SPOKES
    flat = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)
    rings = np.empty((_RINGS, _SPOKES, 3))
    rings[..., :2] = np.sin(polar)[:, None, None] * flat
    rings[..., 2] = np.cos(polar)[:, None]
    vertices = radius_m * np.vstack([[0.0, 0.0, 1.0], rings.reshape(-1, 3)])
    here = np.arange(_SPOKES)
    there = np.roll(here, -1)
    inner = (1 + np.arange(_RINGS - 1)[:, None] * _SPOKES) + np.zeros_like(here)
    a, b = (inner + here).ravel(), (inner + there).ravel()
    c, d = a + _SPOKES, b + _SPOKES
    top = np.stack([np.zeros_like(here), 1 + here, 1 + there], axis=1)
    faces = np.vstack([top, np.stack([a, c, d], axis=1), np.stack([a, d, b], axis=1)])
    return trimesh.Trimesh(vertices, faces, process=False)


def _table(table: BackgroundTable, stage: Stage, rng: np.random.Generator) -> Part:
    width = _TABLE_DIAMETERS * stage.diameter_m
    width = width if table.table_width_m is None else table.table_width_m
    mesh = sheet(width, width, table.roughness_m, rng)
    mesh.apply_transform(stage.T_cam_model[0] @ table_top(table, stage))
    pose = stage.with_target() if table.table_moves else stage.at_rest()
    return Part(mesh, pose, table.return_fraction)


def table_top(table: BackgroundTable, stage: Stage) -> FloatArray:
    """(4, 4) T_model_table: z is up, the origin below the target's middle."""
    up = np.array(table.table_up_model) / np.linalg.norm(table.table_up_model)
    vertices = np.asarray(stage.mesh.vertices)
    middle = np.asarray(stage.mesh.bounds).mean(axis=0)
    lowest = float((vertices @ up).min())
    return make_transform(plane_axes(up[None])[0], middle + (lowest - middle @ up) * up)


def _clutter(table: BackgroundTable, stage: Stage, rng: np.random.Generator) -> Part:
    """Things that do not touch the target: each is farther off than both are wide."""
    on_table = table.kind is BackgroundKind.TABLE
    T_cam_place = stage.T_cam_model[0] @ table_top(table, stage)
    if not on_table:
        # Beside and behind the target: the camera's image plane, turned towards it.
        T_cam_place = make_transform(np.eye(3), stage.middle_cam)
    shapes = []
    for _ in range(table.clutter_count):
        size = rng.uniform(*_CLUTTER_DIAMETERS, 3) * stage.diameter_m
        angle, reach = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(*_CLUTTER_REACH)
        out = reach * stage.diameter_m + 0.5 * float(np.linalg.norm(size[:2]))
        place = np.array([out * np.cos(angle), out * np.sin(angle), 0.5 * size[2]])
        R = exp_rotation(np.array([0.0, 0.0, rng.uniform(0.0, 2.0 * np.pi)]))
        if not on_table:
            place[2] = rng.uniform(-0.5, 1.0) * stage.diameter_m
            R = Rotation.random(rng=rng).as_matrix()
        shapes.append(_thing(int(rng.integers(3)), size, make_transform(R, place)))
    mesh = joined(shapes)
    mesh.apply_transform(T_cam_place)
    moves = on_table and table.table_moves
    return Part(mesh, stage.with_target() if moves else stage.at_rest(), table.return_fraction)


def _thing(kind: int, size: FloatArray, T: FloatArray) -> trimesh.Trimesh:
    if kind == 0:
        return box(size, T)
    if kind == 1:
        radius, height = 0.5 * float(size[0]), float(size[2])
        made: trimesh.Trimesh = trimesh.creation.cylinder(radius, height, transform=T)
        return made
    return ball(T[:3, 3], 0.5 * float(size[2]))


_MADE: Mapping[BackgroundKind, Callable[[BackgroundTable, Stage, np.random.Generator], Part]] = {
    BackgroundKind.WALL: _wall,
    BackgroundKind.EARTH: _earth,
    BackgroundKind.TABLE: _table,
}
