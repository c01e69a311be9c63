"""The target satellite: its mesh, rectangle catalogue, symmetry group and mass properties."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh
from rich.table import Table

from pcnav.config.length_unit import LengthUnit
from pcnav.config.shipped import shipped_mesh
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import rotation_angle
from pcnav.dynamics.mass_prior import MassBelief
from pcnav.target.catalogue import (
    EQUIVALENT_TOLERANCE,
    MINIMUM_SIDE_FRACTION,
    RECTANGLE_TOLERANCE,
    Rectangle,
    rectangles_among,
)
from pcnav.target.facets import planar_faces
from pcnav.target.flatness import flat_extent
from pcnav.target.mesh import mesh_diameter
from pcnav.target.mesh_files.reading import (
    Geometry,
    MeshFile,
    MeshOrigin,
    mesh_of_program,
    read_mesh_file,
)
from pcnav.target.mesh_files.units import length_text
from pcnav.target.rival_turns import rival_turns
from pcnav.target.round_mesh import rounded
from pcnav.target.roundness import Roundness
from pcnav.target.self_matches import SelfMatch, SelfMatcher, near_symmetries
from pcnav.target.sidecar import MassTable, RectangleName, Sidecar, read_sidecar, write_sidecar
from pcnav.target.symmetry import (
    Resolution,
    Symmetry,
    find_symmetry,
    half_turns,
    symmetry_name,
)
from pcnav.target.unknown_density import unknown_density
from pcnav.target.visible_shell import visible_shell

__all__ = [
    "Rectangle",
    "Target",
    "describe",
    "load_target",
    "target_mesh_of",
    "write_target_toml",
]

_LOG = logging.getLogger("pcnav")
_SAME_ANGLE_RAD, _SAME_SHIFT_FRACTION = 0.05, 0.03
"""A motion so near to a symmetry is that symmetry."""
_NAME_POSITION_FRACTION = 0.01
_NAME_COSINE = np.cos(np.radians(5.0))


@dataclass(frozen=True, repr=False)
class Target:
    """All that is known of a satellite before it is seen. Metres, model frame."""

    name: str
    mesh_path: Path
    """Of one whose mesh a program had in memory no file: its name."""
    mesh: trimesh.Trimesh
    rectangles: tuple[Rectangle, ...]
    """Largest area first."""
    symmetry_transforms: FloatArray
    """(n, 4, 4) proper rigid motions of the model frame that map the mesh onto itself as far as a
    sensor can tell; [0] is I. Of a round target each may be followed by any turn, too."""
    mass: MassBelief
    """As stated, or of a density that nobody knows."""
    mesh_origin: MeshOrigin
    """What the mesh comes from."""
    roundness: Roundness | None = None
    """About which axes it can be turned without a trace; None for a target that is not round."""
    as_given: trimesh.Trimesh | None = None
    """The whole mesh, m, of one that a program had in memory."""
    stated_mass: MassTable = field(default_factory=MassTable)
    """What of its mass was stated."""

    def __repr__(self) -> str:
        size = f"{length_text(self.diameter_m)} across ({self.mesh_origin.unit_text})"
        symmetry = f"symmetry {self.symmetry_name}"
        return f"<Target {self.name}: {size}, {len(self.mesh.faces)} faces, {symmetry}>"

    @staticmethod
    def from_mesh(
        mesh: Geometry | Path | str, unit: LengthUnit | str | None = None, name: str = "target"
    ) -> "Target":
        """The target of a mesh.

        Args:
            mesh: path of a file, name of a shipped satellite, a ``trimesh.Trimesh`` or ``Scene``,
                or a tuple of vertices (n, 3) and faces (m, 3).
            unit: of its coordinates: "mm", "cm", "in", "ft" or "m"; without it the one that the
                mesh, or the TOML file beside it, states, else metres.
            name: of a mesh that is no file.

        Raises `InputError` for what is no mesh, and for an unknown unit.
        """
        stated = None if unit is None else LengthUnit.named(unit)
        if isinstance(mesh, Path | str):
            shipped = None if Path(mesh).is_file() else shipped_mesh(str(mesh))
            found = load_target(shipped or Path(mesh), stated)
        else:
            mesh_file = mesh_of_program(mesh, name, stated)
            found = _target_of(Path(name), mesh_file, Path(name), Sidecar())
            found = replace(found, as_given=mesh_file.mesh)
        if found.mesh_origin.unit_doubt is not None:
            _LOG.warning("%s: %s", found.name, found.mesh_origin.unit_doubt)
        return found

    @property
    def com_model(self) -> FloatArray:
        """(3,) nominal mass centre, m."""
        return self.mass.com_model

    @property
    def inertia_ratios(self) -> FloatArray:
        """(5,) nominal Iyy, Izz, Ixy, Ixz, Iyz over Ixx about the nominal mass centre."""
        return self.mass.inertia_ratios

    @cached_property
    def diameter_m(self) -> float:
        """Diameter of the sphere about the mesh's bounding box."""
        return mesh_diameter(self.mesh)

    def scaled(self, factor: float) -> "Target":
        """The same target, larger by a factor about the model's origin."""
        mesh = self.mesh.copy()
        mesh.apply_scale(factor)
        motions = self.symmetry_transforms.copy()
        motions[:, :3, 3] *= factor
        roundness = self.roundness
        if roundness is not None:
            roundness = replace(roundness, point_model=factor * roundness.point_model)
        return replace(
            self,
            mesh=mesh,
            rectangles=tuple(rectangle.scaled(factor) for rectangle in self.rectangles),
            symmetry_transforms=motions,
            mass=self.mass.scaled(factor),
            roundness=roundness,
        )

    @cached_property
    def flat_extent_m(self) -> float:
        """How far its largest flat part extends."""
        return flat_extent(self.mesh)

    @cached_property
    def half_turns(self) -> FloatArray:
        """(3, 4, 4) half turns of the model frame about the principal axes of the surface: what is
        nearly a symmetry of a satellite is mostly one of them."""
        return half_turns(self.mesh)

    @cached_property
    def rival_turns(self) -> FloatArray:
        """(n, 4, 4) turns of the model frame that a start has to rule out, the half turns first,
        see `rival_turns`; symmetries may be among them."""
        return rival_turns(self.mesh, self.half_turns)

    @cached_property
    def matcher(self) -> SelfMatcher:
        """Compares surfaces with that of the target."""
        return SelfMatcher(self.mesh, Resolution.usual(self.diameter_m).tolerance_m)

    @cached_property
    def near_symmetries(self) -> tuple[SelfMatch, ...]:
        """The motions of the model frame, none of them a symmetry, after which the target looks
        nearly as before, that which changes least first: the poses ``T_cam_model @ match.T_model``
        are those a right one is mistaken for, and ``match.differing_share`` of the surface tells
        them apart. Found when first asked for, in a few seconds at most."""
        found = near_symmetries(self.matcher)
        if not found:
            return ()
        motions = np.stack([match.T_model for match in found])
        alike = self.leave_no_trace(motions, _SAME_ANGLE_RAD, _SAME_SHIFT_FRACTION)
        return tuple(match for match, same in zip(found, alike, strict=True) if not same)

    @property
    def symmetry_name(self) -> str:
        """Of its symmetry, for tables: "C1" is none."""
        return symmetry_name(self.symmetry_transforms, self.roundness)

    @property
    def is_symmetric(self) -> bool:
        """Whether it has equivalent attitudes."""
        return len(self.symmetry_transforms) > 1 or self.roundness is not None

    def equivalent_pose(self, T_frame_model: FloatArray, near: Sequence[FloatArray]) -> FloatArray:
        """(4, 4) of the poses that show the target as a pose (4, 4) does, the one nearest in
        attitude to any of ``near`` (4, 4 each); that pose itself where there are none."""
        if not near or not self.is_symmetric:
            return T_frame_model
        equivalent = T_frame_model @ self.symmetry_transforms
        relative = np.swapaxes(equivalent[:, None, :3, :3], -1, -2) @ np.stack(near)[:, :3, :3]
        if self.roundness is not None:
            turns = self.roundness.towards(relative)
            relative = np.swapaxes(turns[..., :3, :3], -1, -2) @ relative
            equivalent = equivalent[:, None] @ turns
        else:
            equivalent = np.broadcast_to(equivalent[:, None], (*relative.shape[:2], 4, 4))
        angles = rotation_angle(relative)
        return np.asarray(equivalent[np.unravel_index(np.argmin(angles), angles.shape)])

    def leave_no_trace(
        self, motions: FloatArray, angle_rad: float, shift_fraction: float
    ) -> BoolArray:
        """(n,) which motions (n, 4, 4) of the model frame are closer to a symmetry than an angle
        and, in the middle of the target, a share of the diameter."""
        relative = np.linalg.inv(self.symmetry_transforms) @ motions[:, None]
        if self.roundness is not None:
            turns = self.roundness.towards(relative[..., :3, :3])
            relative = np.linalg.inv(turns) @ relative
        middle = np.asarray(self.mesh.bounds).mean(axis=0)
        moved = relative[..., :3, :3] @ middle + relative[..., :3, 3] - middle
        near = np.linalg.norm(moved, axis=-1) < shift_fraction * self.diameter_m
        # The trace of a rotation is 1 + 2 cos(angle).
        trace = np.trace(relative[..., :3, :3], axis1=-2, axis2=-1)
        near &= trace > 1.0 + 2.0 * np.cos(angle_rad)
        return np.asarray(near.any(axis=1))

    def shows_alike(
        self, a: FloatArray, b: FloatArray, angle_rad: float, shift_fraction: float
    ) -> bool:
        """Whether two poses (4, 4) show the target alike: its symmetry taken into account, they
        are closer than an angle and a share of the diameter."""
        return bool(self.leave_no_trace(np.linalg.inv(a)[None] @ b, angle_rad, shift_fraction)[0])


def load_target(mesh_path: Path, mesh_unit: LengthUnit | None = None) -> Target:
    """Everything pcnav needs to know of the satellite in a mesh file, see `read_mesh_file`.

    Its coordinates are in ``mesh_unit``, else in the unit that the TOML file beside it states, else
    in the one the mesh declares, else in metres.

    Names and mass properties come from the TOML file of the same name beside the mesh, as far as
    it states them; otherwise the mass is any that fits into the shape (`unknown_density`).

    A mesh without a true rectangle is catalogued by the equivalent rectangles (named
    equivalent_1, ...) of the faces that are rectangles to 15 %: equal in centroid, axes and second
    moments. One without any is found and followed by the whole of its surface. A body that is round
    to a sensor is round, however few sides its mesh has (`rounded`). Raises `InputError` when
    either file is unusable.
    """
    mesh_path = Path(mesh_path)
    sidecar_path, sidecar = _sidecar_of(mesh_path)
    mesh_file = read_mesh_file(mesh_path, mesh_unit or sidecar.mesh_unit)
    return _target_of(mesh_path, mesh_file, sidecar_path, sidecar)


def _target_of(
    mesh_path: Path, mesh_file: MeshFile, sidecar_path: Path, sidecar: Sidecar
) -> Target:
    mesh, symmetry = _as_it_is_round(visible_shell(mesh_file.mesh))
    diameter = mesh_diameter(mesh)
    minimum_side = MINIMUM_SIDE_FRACTION * diameter
    faces = planar_faces(mesh, 0.8 * minimum_side**2)
    rectangles = rectangles_among(faces, minimum_side, RECTANGLE_TOLERANCE, "rectangle")
    rectangles = rectangles or rectangles_among(
        faces, minimum_side, EQUIVALENT_TOLERANCE, "equivalent"
    )
    return Target(
        name=sidecar.name or mesh_path.stem,
        mesh_path=mesh_path,
        mesh=mesh,
        rectangles=_named(rectangles, sidecar.rectangles.names, diameter, sidecar_path),
        symmetry_transforms=symmetry.motions,
        mass=_mass(mesh, sidecar.mass, sidecar_path),
        mesh_origin=mesh_file.origin,
        roundness=symmetry.roundness,
        stated_mass=sidecar.mass,
    )


def target_mesh_of(mesh_path: Path, mesh_unit: LengthUnit | None = None) -> trimesh.Trimesh:
    """The mesh alone of what `load_target` reads. Raises `InputError`."""
    return read_mesh_file(mesh_path, mesh_unit or _sidecar_of(mesh_path)[1].mesh_unit).mesh


def nominal_mass(mesh_path: Path, mesh_unit: LengthUnit | None = None) -> MassBelief:
    """The mass properties alone of what `load_target` reads. Raises `InputError`."""
    path, sidecar = _sidecar_of(mesh_path)
    return _mass(target_mesh_of(mesh_path, mesh_unit), sidecar.mass, path)


def _as_it_is_round(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, Symmetry]:
    """The mesh, with finer facets where it draws a round body with few, and its symmetry."""
    symmetry = find_symmetry(mesh)
    if symmetry.roundness is None:
        return mesh, symmetry
    finer = rounded(mesh, symmetry.roundness)
    again = symmetry if finer is mesh else find_symmetry(finer)
    return (mesh, symmetry) if again.roundness is None else (finer, again)


def _sidecar_of(mesh_path: Path) -> tuple[Path, Sidecar]:
    """Path and content of the TOML file beside a mesh; an empty one where there is none."""
    path = mesh_path.with_suffix(".toml")
    return path, read_sidecar(path) if path.exists() else Sidecar()


def _mass(mesh: trimesh.Trimesh, stated: MassTable, sidecar_path: Path) -> MassBelief:
    """As stated; what nobody stated is that of a density that nobody knows."""
    com, ratios = (
        None if value is None else np.array(value)
        for value in (stated.com_model_m, stated.inertia_ratios)
    )
    if com is not None:
        low, high = mesh.bounds
        if np.any(com < low) or np.any(com > high):
            expected = "expected a point within the bounds of the mesh"
            raise InputError(sidecar_path, "mass.com_model_m", expected)
    return unknown_density(mesh).about(com, ratios).told(stated.com_sd_m, stated.inertia_ratio_sd)


def _named(
    rectangles: tuple[Rectangle, ...],
    names: tuple[RectangleName, ...],
    diameter: float,
    sidecar_path: Path,
) -> tuple[Rectangle, ...]:
    """The rectangles with the names of the sidecar given to those it points at."""
    if not rectangles and names:
        expected = "expected none: the mesh has no rectangle to be named"
        raise InputError(sidecar_path, "rectangles.names", expected)
    named = list(rectangles)
    taken: set[int] = set()
    centroids = np.array([rectangle.T_model_rect[:3, 3] for rectangle in rectangles])
    normals = np.array([rectangle.T_model_rect[:3, 2] for rectangle in rectangles])
    two_sided = np.array([rectangle.two_sided for rectangle in rectangles])
    for k, entry in enumerate(names):
        direction = np.array(entry.normal_model) / np.linalg.norm(entry.normal_model)
        cosine = normals @ direction
        faces_it = np.where(two_sided, np.abs(cosine), cosine) >= _NAME_COSINE
        distance = np.linalg.norm(centroids - entry.centroid_model_m, axis=1)
        distance[~faces_it] = np.inf
        nearest = int(np.argmin(distance))
        where = f"rectangles.names.{k} ({entry.name})"
        if distance[nearest] > _NAME_POSITION_FRACTION * diameter:
            expected = "no rectangle of the mesh has this centroid and normal"
            raise InputError(sidecar_path, where, expected)
        if nearest in taken:
            raise InputError(sidecar_path, where, "another name already points at this rectangle")
        taken.add(nearest)
        named[nearest] = replace(named[nearest], name=entry.name)
    return tuple(named)


def write_target_toml(target: Target, path: Path) -> None:
    """Write what is known of a target as a sidecar TOML that `load_target` reads, atomically.

    Raises `InputError` when the file cannot be written.
    """
    names = tuple(
        RectangleName(
            name=rectangle.name,
            centroid_model_m=_vector3(rectangle.T_model_rect[:3, 3]),
            normal_model=_vector3(rectangle.T_model_rect[:3, 2]),
        )
        for rectangle in target.rectangles
    )
    a, b, c, d, e = (float(ratio) for ratio in target.inertia_ratios)
    mass = MassTable(
        com_model_m=_vector3(target.com_model),
        com_sd_m=target.stated_mass.com_sd_m,
        inertia_ratios=(a, b, c, d, e),
        inertia_ratio_sd=target.stated_mass.inertia_ratio_sd,
    )
    write_sidecar(Sidecar.of(target.name, mass, names, target.mesh_origin.stated_unit), path)


def _vector3(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = (float(value) + 0.0 for value in values)
    return x, y, z


def describe(target: Target) -> tuple[Table, Table]:
    """Two rich tables: what is known of the target, and its rectangle catalogue."""
    facts = Table(title=target.name)
    facts.add_column("property")
    facts.add_column("value")
    mesh = target.mesh
    closed = "watertight" if mesh.is_watertight else "open"
    hidden = target.mesh_origin.n_faces - len(mesh.faces)
    inner = f", {hidden} more that nobody sees" if hidden else f", {closed}"
    facts.add_row("mesh", f"{len(mesh.vertices)} vertices, {len(mesh.faces)} faces{inner}")
    low, high = target.mesh.bounds
    facts.add_row("size", f"{' x '.join(f'{side:.3f}' for side in high - low)} m")
    facts.add_row("diameter", f"{target.diameter_m:.3f} m")
    facts.add_row("unit of the file", target.mesh_origin.unit_text)
    facts.add_row("symmetry group", target.symmetry_name)
    facts.add_row("mass centre (model)", f"{_numbers(target.com_model)} m")
    com_sd, ratios_sd = target.mass.prior.sd
    facts.add_row("  standard deviation", f"{_numbers(com_sd)} m")
    facts.add_row("inertia Iyy Izz Ixy Ixz Iyz / Ixx", _numbers(target.inertia_ratios))
    facts.add_row("  standard deviation", _numbers(ratios_sd))
    rows = Table(title="rectangles")
    for heading in ("name", "length m", "width m", "centroid (model) m", "normal (model)", "sides"):
        rows.add_column(heading, justify="right" if heading.endswith("h m") else "left")
    for rectangle in target.rectangles:
        pose = rectangle.T_model_rect
        rows.add_row(
            rectangle.name,
            f"{rectangle.length_m:.4f}",
            f"{rectangle.width_m:.4f}",
            _numbers(pose[:3, 3]),
            _numbers(pose[:3, 2]),
            "both" if rectangle.two_sided else "one",
        )
    return facts, rows


def _numbers(values: FloatArray) -> str:
    return " ".join(f"{value:8.4f}" for value in np.round(values, 4) + 0.0)
