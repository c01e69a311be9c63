"""Targets that have no rectangle to be recognised by: stages, capsules, dishes, trusses, bodies."""

import tempfile
from collections.abc import Callable, Mapping
from functools import lru_cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from trimesh import creation
from trimesh.transformations import rotation_matrix, translation_matrix

from pcnav.config.pipeline_file import read_pipeline
from pcnav.config.shipped import shipped_pipeline
from pcnav.core.errors import InputError
from pcnav.simulation.random_truth import Satellite
from pcnav.target.satellite import load_target

_X, _Y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
_RANGE_SIGMA = 0.002
"""Noise along the rays over the diameter."""
_PIPELINE = "boxsat"
"""Whose camera and settings all are seen and followed with."""


def _at(
    mesh: trimesh.Trimesh,
    x: float,
    y: float,
    z: float,
    turn_deg: float = 0.0,
    axis: tuple[float, float, float] = _X,
) -> trimesh.Trimesh:
    turned = rotation_matrix(np.deg2rad(turn_deg), axis)
    mesh.apply_transform(translation_matrix((x, y, z)) @ turned)
    return mesh


def _joined(*meshes: trimesh.Trimesh) -> trimesh.Trimesh:
    joined = trimesh.util.concatenate(meshes)
    assert isinstance(joined, trimesh.Trimesh), "it is made of nothing else"
    return joined


def _tube(radius: float, height: float, sections: int = 48) -> trimesh.Trimesh:
    made: trimesh.Trimesh = creation.cylinder(radius, height, sections=sections)
    return made


def _bar(begin: tuple[float, ...], end: tuple[float, ...], radius: float) -> trimesh.Trimesh:
    made: trimesh.Trimesh = creation.cylinder(radius, segment=np.array([begin, end]), sections=12)
    return made


def _stage() -> trimesh.Trimesh:
    profile = [(0, -2), (0.55, -2), (0.25, -1.5), (0.9, -1.4), (0.9, 1.2), (0.4, 1.7), (0, 1.7)]
    return creation.revolve(np.array(profile, dtype=np.float64), sections=48)


def _stage_with_equipment() -> trimesh.Trimesh:
    raceway = _at(_tube(0.12, 2.2, 16), 0.95, 0.0, -0.1)
    return _joined(_stage(), raceway, _at(creation.icosphere(3, 0.28), -0.3, 0.95, 0.6))


def _capsule() -> trimesh.Trimesh:
    profile = [(0, -0.75), (0.9, -0.65), (1.1, -0.4), (0.45, 0.9), (0.3, 1.0), (0, 1.0)]
    hatch = _at(_tube(0.3, 0.12), 0.78, 0.0, 0.35, 62.0, _Y)
    body = creation.revolve(np.array(profile, dtype=np.float64), sections=48)
    return _joined(body, hatch, _at(_tube(0.14, 0.5, 16), -0.9, 0.35, 0.3))


def _hexagonal() -> trimesh.Trimesh:
    dish = _at(creation.cone(0.5, 0.3, sections=32), 0.35, 0.15, 1.0, 180.0)
    mast = _bar((-0.4, 0.3, 0.7), (-0.9, 0.9, 1.8), 0.05)
    return _joined(_tube(0.8, 1.4, 6), dish, mast, _at(creation.icosphere(3, 0.2), 0.2, -0.8, -0.4))


def _octagonal() -> trimesh.Trimesh:
    boom = _bar((0.6, 0.3, -0.4), (1.9, 0.9, -0.4), 0.06)
    horn = _at(creation.cone(0.35, 0.7, sections=32), -0.1, 0.2, 0.9)
    return _joined(_tube(0.7, 1.8, 8), boom, horn, _at(creation.icosphere(3, 0.22), 1.9, 0.9, -0.4))


def _dish() -> trimesh.Trimesh:
    r = np.linspace(0.0, 1.4, 14)
    inner = np.column_stack([r, 0.25 * r**2])
    profile = np.vstack([inner, inner[::-1] - (0.0, 0.06)])
    struts = [
        _bar((1.2 * c, 1.2 * s, 0.36), (0.0, 0.0, 1.1), 0.035)
        for c, s in ((1.0, 0.0), (-0.5, 0.87), (-0.5, -0.87))
    ]
    feed = _at(_tube(0.16, 0.3, 24), 0.0, 0.0, 1.1)
    bus = _at(_tube(0.5, 0.9, 24), 0.35, 0.0, -0.5)
    return _joined(creation.revolve(profile, sections=48), *struts, feed, bus)


def _truss() -> trimesh.Trimesh:
    corners = [(0.35 * c, 0.35 * s) for c, s in ((1.0, 0.0), (-0.5, 0.87), (-0.5, -0.87))]
    levels = np.linspace(-1.6, 1.6, 5)
    bars = [_bar((*c, -1.6), (*c, 1.6), 0.06) for c in corners]
    for low, high in pairwise(levels):
        for k, c in enumerate(corners):
            after = corners[(k + 1) % 3]
            bars += [_bar((*c, low), (*after, high), 0.045), _bar((*c, low), (*after, low), 0.045)]
    return _joined(
        *bars, _at(_tube(0.45, 0.5, 24), 0.0, 0.0, 1.7), _at(_tube(0.2, 0.9), 0.5, 0, -1)
    )


def _sphere_with_booms() -> trimesh.Trimesh:
    ends = ((1.8, 0.2, 0.1), (-1.2, 1.2, 0.3), (-0.4, -1.5, 0.8), (0.3, 0.4, -1.9))
    booms = [_bar((0.0, 0.0, 0.0), end, 0.06) for end in ends]
    return _joined(creation.icosphere(4, 0.7), *booms, _at(creation.icosphere(3, 0.2), *ends[0]))


def _asteroid() -> trimesh.Trimesh:
    mesh = creation.icosphere(4, 1.0)
    rng = np.random.default_rng(11)
    radius = np.ones(len(mesh.vertices))
    for scale in (1.3, 2.4, 4.5):
        wave, phase = scale * rng.standard_normal((12, 3)), rng.uniform(0.0, 2.0 * np.pi, 12)
        radius += 0.1 / scale * np.sum(np.cos(mesh.vertices @ wave.T + phase), axis=1)
    stretched = mesh.vertices * radius[:, None] * (1.3, 1.0, 0.8)
    return trimesh.Trimesh(stretched, mesh.faces, process=False)


def _ring_station() -> trimesh.Trimesh:
    spokes = [_bar((-1.3, 0.0, 0.0), (1.3, 0.0, 0.0), 0.07), _bar((0, -1.3, 0), (0, 1.3, 0), 0.07)]
    hub = _at(_tube(0.3, 1.4, 32), 0.0, 0.0, 0.35)
    ball = _at(creation.icosphere(3, 0.3), 1.3, 0.3, 0.15)
    return _joined(creation.torus(1.3, 0.14), *spokes, hub, ball)


def _rocket() -> trimesh.Trimesh:
    fins = [
        _at(creation.cone(0.5, 0.9, sections=3), 0.55 * c, 0.55 * s, -1.4)
        for c, s in ((1.0, 0.0), (-0.3, 0.95), (-0.6, -0.8))
    ]
    nose = _at(creation.cone(0.45, 1.0, sections=40), 0.0, 0.0, 1.2)
    return _joined(_tube(0.45, 2.6, 40), nose, *fins)


def _docked() -> trimesh.Trimesh:
    small = _at(creation.capsule(1.1, 0.35, count=[24, 24]), 0.75, 0.25, 0.6, 60.0, _Y)
    return _joined(_tube(0.6, 2.4, 40), small, _at(creation.icosphere(3, 0.45), -0.3, 0.0, -1.4))


def _tank_cluster() -> trimesh.Trimesh:
    places = ((0.6, 0.0, 0.2), (-0.45, 0.55, -0.1), (-0.35, -0.6, 0.35))
    sizes = (0.55, 0.42, 0.36)
    tanks = [
        _at(creation.icosphere(4, size), *place) for place, size in zip(places, sizes, strict=True)
    ]
    return _joined(*tanks, _bar((0.6, 0, 0.2), (-0.45, 0.55, -0.1), 0.12), _tube(0.18, 2.4, 24))


def _drum_with_curved_wing() -> trimesh.Trimesh:
    """The wing is a sheet without thickness: an open shell."""
    angles, across = np.linspace(-0.7, 0.7, 24), np.array([0.0, 1.9])
    angle, y = (each.ravel() for each in np.meshgrid(angles, across, indexing="ij"))
    vertices = np.column_stack([1.3 * (np.cos(angle) - 1.0), y, 1.3 * np.sin(angle)])
    first = 2 * np.arange(len(angles) - 1)
    faces = np.vstack(
        [
            np.column_stack([first, first + 1, first + 2]),
            np.column_stack([first + 1, first + 3, first + 2]),
        ]
    )
    wing = trimesh.Trimesh(vertices, faces, process=False)
    return _joined(_tube(0.7, 1.3, 40), _at(wing, 0.0, 0.72, 0.1))


def _egg_with_counterweight() -> trimesh.Trimesh:
    egg = creation.icosphere(4, 1.0).apply_scale((0.7, 0.85, 1.2))
    boom = _bar((0.0, 0.6, 0.4), (0.3, 1.9, 0.9), 0.07)
    return _joined(egg, boom, _at(creation.cone(0.3, 0.5, sections=24), 0.3, 1.9, 0.9))


def _helix_antenna() -> trimesh.Trimesh:
    t = np.linspace(0.0, 6.0 * np.pi, 55)
    path = np.column_stack([0.3 * np.cos(t), 0.3 * np.sin(t), 0.06 * t + 0.5])
    coil = [_bar(tuple(a), tuple(b), 0.04) for a, b in pairwise(path)]
    return _joined(_tube(0.8, 1.0, 7), *coil, _at(creation.icosphere(3, 0.3), 0.5, 0.6, -0.3))


SHAPES: Mapping[str, Callable[[], trimesh.Trimesh]] = {
    "stage": _stage,
    "stage with equipment": _stage_with_equipment,
    "capsule": _capsule,
    "hexagonal bus": _hexagonal,
    "octagonal bus": _octagonal,
    "dish": _dish,
    "truss": _truss,
    "sphere with booms": _sphere_with_booms,
    "asteroid": _asteroid,
    "ring station": _ring_station,
    "rocket": _rocket,
    "docked capsule": _docked,
    "tank cluster": _tank_cluster,
    "curved wing": _drum_with_curved_wing,
    "egg and counterweight": _egg_with_counterweight,
    "helix antenna": _helix_antenna,
}
"""By name; lengths in metres."""


@lru_cache(maxsize=32)
def shape(name: str) -> Satellite:
    """A target of this chapter, as `load_target` reads it. Raises `InputError` without one."""
    pipeline = shipped_pipeline(_PIPELINE)
    if name not in SHAPES or pipeline is None:
        raise InputError(name, "shape", f"expected one of {', '.join(SHAPES)}")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name.replace(' ', '_')}.ply"
        SHAPES[name]().export(path)
        target = load_target(path)
    found = read_pipeline(pipeline)
    noise = found.noise.model_copy(update={"range_sigma_m": _RANGE_SIGMA * target.diameter_m})
    return Satellite(target, found.model_copy(update={"noise": noise}))
