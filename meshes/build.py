"""Builds the satellites that come with pcnav: a mesh and a TOML sidecar each.

    python meshes/build.py [-o FOLDER]

Every satellite is a list of closed solids set beside each other, so that a face of the bus stays
one clean rectangle whatever stands on it. Each part has a mass, spread evenly over its volume;
equipment inside the bus is spheres that weigh but do not show. The mass centre and the inertia in
the sidecar are the sums over all of these, hence physically possible. Lengths in metres, masses in
kilograms, model frame: the bus is centred at the origin.
"""

import argparse
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import trimesh
from trimesh.exchange.obj import export_obj

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.rigid_body import ratios_from_inertia
from pcnav.target.sidecar import MassTable, RectangleName, Sidecar, write_sidecar

Vector = tuple[float, float, float]

CIRCLE_SECTIONS = 48
MESH_DIGITS = 9
"""Decimals of a vertex, m: enough to be exact, few enough to be the same on every machine."""
TOML_DIGITS = 6


@dataclass(frozen=True)
class Part:
    """A closed solid of the satellite."""

    mesh: trimesh.Trimesh
    mass_kg: float
    faces: Mapping[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    """Centroid (3,) and outward normal (3,) of the faces that carry a name."""


@dataclass(frozen=True)
class Ball:
    """Equipment inside the bus: a uniform sphere that adds mass but no surface."""

    centre_m: Vector
    radius_m: float
    mass_kg: float


@dataclass(frozen=True)
class Satellite:
    """What becomes one mesh and one sidecar."""

    name: str
    about: str
    parts: tuple[Part, ...]
    equipment: tuple[Ball, ...]


def box(
    size: Vector,
    centre: Vector,
    mass_kg: float,
    names: Mapping[str, str] | None = None,
    rotation_deg: Vector = (0.0, 0.0, 0.0),
) -> Part:
    """A box turned by a rotation vector about its centre; `names` maps "+x" ... "-z" to names."""
    pose = make_transform(exp_rotation(np.radians(rotation_deg)), np.array(centre))
    faces = {}
    for side, name in (names or {}).items():
        axis = "xyz".index(side[1])
        normal = pose[:3, axis] * (1.0 if side[0] == "+" else -1.0)
        faces[name] = (pose[:3, 3] + 0.5 * size[axis] * normal, normal)
    return Part(trimesh.creation.box(extents=size, transform=pose), mass_kg, faces)


def ring(inner: float, outer: float, low: Vector, high: Vector, mass_kg: float) -> Part:
    """A tube between the centres of its ends; a cylinder when the inner radius is 0."""
    segment = [low, high]
    if inner > 0.0:
        mesh = trimesh.creation.annulus(inner, outer, sections=CIRCLE_SECTIONS, segment=segment)
    else:
        mesh = trimesh.creation.cylinder(outer, sections=CIRCLE_SECTIONS, segment=segment)
    return Part(mesh, mass_kg)


def named_faces(stem: str, sides: str = "xyz") -> dict[str, str]:
    """Names such as bus_x_plus for the faces of a box across the given axes."""
    words = {"+": "plus", "-": "minus"}
    return {f"{sign}{axis}": f"{stem}_{axis}_{words[sign]}" for axis in sides for sign in "+-"}


def two_faces(stem: str, axis: str) -> dict[str, str]:
    """Names of the two large faces of a plate whose own normal is the given axis."""
    return {f"+{axis}": f"{stem}_front", f"-{axis}": f"{stem}_back"}


def boxsat() -> Satellite:
    """The demonstration target: two unlike panels in unlike planes, a ring and an antenna."""
    tilt = (0.0, 35.0, 0.0)
    # The panels hang 0.35 m and more off the bus's centre line, so that no half turn about an axis
    # of a panel comes near to mapping the bus onto itself.
    return Satellite(
        name="boxsat",
        about="Box bus, two unlike solar panels, docking ring, tilted antenna. Symmetry group C1.",
        parts=(
            box((1.6, 1.8, 2.2), (0.0, 0.0, 0.0), 540.0, named_faces("bus")),
            box((0.04, 4.0, 1.5), (0.35, 3.2, 0.25), 27.0, two_faces("panel_long", "x")),
            box((0.08, 0.3, 0.10), (0.35, 1.05, 0.25), 2.0),
            box((0.04, 3.0, 1.2), (-0.35, -2.7, -0.3), 16.2, two_faces("panel_short", "x"), tilt),
            box((0.08, 0.3, 0.10), (-0.35, -1.05, -0.3), 2.0, rotation_deg=tilt),
            ring(0.45, 0.55, (0.0, 0.0, 1.1), (0.0, 0.0, 1.3), 24.0),
            box((0.08, 0.08, 0.5), (0.35, -0.4, -1.35), 3.0),
            box(
                (0.8, 0.8, 0.04),
                (0.35, -0.4, -1.62),
                7.0,
                {"-z": "antenna_front", "+z": "antenna_back"},
                (25.0, 0.0, 0.0),
            ),
        ),
        equipment=(
            Ball((0.18, 0.12, -0.45), 0.42, 260.0),
            Ball((-0.45, -0.40, 0.55), 0.22, 65.0),
        ),
    )


def twinwing() -> Satellite:
    """A telecommunications layout: equal coplanar wings, a ring above and a nozzle below."""
    wing = (0.04, 3.4, 1.5)
    return Satellite(
        name="twinwing",
        about="Box bus, two equal coplanar wings, ring, nozzle. Symmetry group C2 about z.",
        parts=(
            box((1.5, 1.3, 2.1), (0.0, 0.0, 0.0), 620.0, named_faces("bus")),
            box(wing, (0.0, 2.75, 0.35), 23.0, two_faces("wing_plus", "x")),
            box((0.08, 0.4, 0.10), (0.0, 0.85, 0.35), 2.5),
            box(wing, (0.0, -2.75, 0.35), 23.0, two_faces("wing_minus", "x")),
            box((0.08, 0.4, 0.10), (0.0, -0.85, 0.35), 2.5),
            ring(0.40, 0.50, (0.0, 0.0, 1.05), (0.0, 0.0, 1.20), 18.0),
            ring(0.0, 0.25, (0.0, 0.0, -1.45), (0.0, 0.0, -1.05), 12.0),
        ),
        equipment=(
            Ball((0.0, 0.0, -0.40), 0.48, 380.0),
            Ball((0.30, -0.20, 0.60), 0.22, 70.0),
        ),
    )


def cubesat6u() -> Satellite:
    """A 6U CubeSat, 0.30 x 0.20 x 0.10 m, with two hinged panels and a lens."""
    parts = [
        box((0.10, 0.20, 0.30), (0.0, 0.0, 0.0), 9.0, named_faces("bus")),
        ring(0.0, 0.035, (-0.07, 0.0, 0.0), (-0.05, 0.0, 0.0), 0.3),
    ]
    for sign, word in ((1.0, "plus"), (-1.0, "minus")):
        plate = two_faces(f"panel_{word}", "x")
        parts.append(box((0.003, 0.18, 0.26), (0.035, sign * 0.20, 0.0), 0.25, plate))
        # The hinges keep the panel 1 cm off the bus.
        parts += [box((0.006, 0.01, 0.02), (0.035, sign * 0.105, z), 0.01) for z in (-0.08, 0.08)]
    return Satellite(
        name="cubesat6u",
        about="6U CubeSat, two deployed panels, lens. Symmetry group C2 about x.",
        parts=tuple(parts),
        equipment=(Ball((0.01, 0.02, -0.06), 0.03, 1.4),),
    )


SATELLITES = (boxsat, twinwing, cubesat6u)


def joined_mesh(satellite: Satellite) -> trimesh.Trimesh:
    """All parts as one mesh, vertices rounded to what the file holds."""
    solids = [part.mesh for part in satellite.parts]
    first = np.cumsum([0] + [len(solid.vertices) for solid in solids[:-1]])
    faces = [solid.faces + start for solid, start in zip(solids, first, strict=True)]
    # Adding zero turns -0.0 into 0.0.
    vertices = np.round(np.vstack([solid.vertices for solid in solids]), MESH_DIGITS) + 0.0
    return trimesh.Trimesh(vertices, np.vstack(faces), process=False)


def mass_properties(satellite: Satellite) -> tuple[FloatArray, FloatArray]:
    """Mass centre (3,), m, and inertia about it (3, 3), kg m^2, by the parallel axis theorem."""
    masses, centres, inertias = [], [], []
    for part in satellite.parts:
        masses.append(part.mass_kg)
        centres.append(np.array(part.mesh.center_mass))
        inertias.append(np.array(part.mesh.moment_inertia) * part.mass_kg / part.mesh.volume)
    for ball in satellite.equipment:
        masses.append(ball.mass_kg)
        centres.append(np.array(ball.centre_m))
        inertias.append(0.4 * ball.mass_kg * ball.radius_m**2 * np.eye(3))
    com = np.average(centres, axis=0, weights=masses)
    total = np.zeros((3, 3))
    for mass, centre, inertia in zip(masses, centres, inertias, strict=True):
        arm = centre - com
        total += inertia + mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return com, total


def sidecar(satellite: Satellite) -> Sidecar:
    """The contents of the satellite's TOML file."""
    com, inertia = mass_properties(satellite)
    a, b, c, d, e = rounded(ratios_from_inertia(inertia))
    # How far a real one would be from its plans nobody states: no deviations.
    mass = MassTable(com_model_m=rounded3(com), inertia_ratios=(a, b, c, d, e))
    names = tuple(
        RectangleName(name=name, centroid_model_m=rounded3(centroid), normal_model=rounded3(normal))
        for part in satellite.parts
        for name, (centroid, normal) in part.faces.items()
    )
    return Sidecar.of(satellite.name, mass, names)


def rounded(values: FloatArray) -> list[float]:
    """Values to the digits of the TOML file."""
    return [round(float(value), TOML_DIGITS) + 0.0 for value in values]


def rounded3(values: FloatArray) -> Vector:
    """Three of them."""
    x, y, z = rounded(values)
    return x, y, z


def build(folder: Path) -> None:
    """Write every satellite's OBJ and TOML file into a folder."""
    for make in SATELLITES:
        satellite = make()
        text, _ = export_obj(
            joined_mesh(satellite),
            include_normals=False,
            include_color=False,
            include_texture=False,
            return_texture=True,
            digits=MESH_DIGITS,
            header=f"{satellite.name}, metres. Built by meshes/build.py.",
        )
        (folder / f"{satellite.name}.obj").write_text(text + "\n", encoding="utf-8", newline="\n")
        comment = (
            f"{satellite.about}\nMetres, axes of the mesh file. Built by meshes/build.py; "
            "mass properties are the sums over\nits parts and equipment, each of uniform density."
        )
        write_sidecar(sidecar(satellite), folder / f"{satellite.name}.toml", comment)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Build the satellites that come with pcnav.")
    parser.add_argument("-o", "--output", type=Path, default=Path(__file__).parent)
    build(parser.parse_args().output)
