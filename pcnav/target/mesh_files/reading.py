"""Reading a mesh file of any common format."""

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias, cast

import numpy as np
import numpy.typing as npt
import trimesh

from pcnav.config.length_unit import LengthUnit
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.errors import InputError
from pcnav.target.mesh_files import obj
from pcnav.target.mesh_files.cleaning import cleaned
from pcnav.target.mesh_files.formats import mesh_format, stated_faces
from pcnav.target.mesh_files.gltf import buffer_files, check_gltf
from pcnav.target.mesh_files.units import declared_scale, unit_doubt

_MAX_COORDINATE_M = 1e6
_MAX_TRIANGLES = 10_000_000
_MAX_UNPACKED = 4_000_000_000
"""Bytes in an archive, which 3MF and 3DXML files are."""
_MAX_REASON = 120
"""Characters of what a loader says that a message repeats."""
_GLTF = ("glb", "gltf")
_TAKES_SKIP_MATERIALS = (*_GLTF, "obj")

Geometry: TypeAlias = trimesh.Trimesh | trimesh.Scene | tuple[npt.ArrayLike, npt.ArrayLike]
"""A mesh in memory; of two arrays vertices (n, 3) and faces (m, 3)."""


@dataclass(frozen=True)
class MeshOrigin:
    """What a mesh comes from."""

    n_faces: int
    """Triangles of the file, without those that are none."""
    metres_per_unit: float
    """The scale by which it was read."""
    unit_from: str
    """"stated" by the user, "declared" by the file, or "assumed", which metres are."""
    stated_unit: LengthUnit | None = None
    unit_doubt: str | None = None
    """A question, where no unit is stated and the size is one that hardly any target has."""

    @property
    def unit_text(self) -> str:
        """The unit of the file, and where it is known from."""
        scale = self.metres_per_unit
        names = [unit.plural for unit in LengthUnit if np.isclose(unit.metres, scale)]
        return f"{names[0] if names else f'{scale:g} m'}, {self.unit_from}"


@dataclass(frozen=True)
class MeshFile:
    """What a mesh file holds."""

    mesh: trimesh.Trimesh
    """Clean triangles, m, in the axes of the file."""
    origin: MeshOrigin


@dataclass(frozen=True)
class _Part:
    """One body where the file puts it, in units of the file."""

    vertices: FloatArray
    faces: IntArray
    declared: float | None
    """Metres per unit, where the file says it."""


def read_mesh(path: Path, unit: LengthUnit | None = None) -> trimesh.Trimesh:
    """The surface that a mesh file holds, see `read_mesh_file`."""
    return read_mesh_file(path, unit).mesh


def read_mesh_file(path: Path, unit: LengthUnit | None = None) -> MeshFile:
    """The surface of an STL, PLY, OBJ, GLB, glTF, 3MF, OFF or DAE file: one mesh of triangles.

    Bodies and instances stand where the file puts them, polygons are cut into triangles, colours
    and textures dropped; what `cleaned` does follows. Coordinates are in ``unit``, else in the one
    that the file declares, else in metres. The axes are the file's. Raises `InputError` when the
    file is missing, holds no triangles that can be read, or coordinates that are no numbers.
    """
    if not path.is_file():
        raise InputError(path, "file", "expected a mesh file, found none")
    return _assembled(path, _parts(path, mesh_format(path)), unit)


def mesh_of_program(geometry: Geometry, name: str, unit: LengthUnit | None = None) -> MeshFile:
    """The surface that a program has in memory, read as `read_mesh_file` reads one of a file.

    ``name`` is what an `InputError` calls it, which is raised for what holds no triangles.
    """
    where, given = Path(name), cast(object, geometry)
    if isinstance(geometry, tuple):
        vertices, faces = (np.asarray(array) for array in geometry)
        if vertices.shape[1:] != (3,) or faces.shape[1:] != (3,) or faces.dtype.kind not in "iu":
            got = f"got {vertices.dtype} {vertices.shape} and {faces.dtype} {faces.shape}"
            expected = "expected vertices (n, 3) and faces (m, 3), which are indices"
            raise InputError(where, "mesh", f"{expected}; {got}")
        corners = np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.intp)
        parts = [_Part(*corners, None)] if len(faces) else []
    elif not isinstance(given, trimesh.Trimesh | trimesh.Scene):
        expected = "expected a path, a trimesh.Trimesh or Scene, or (vertices, faces)"
        raise InputError(where, "mesh", f"{expected}, got {type(geometry).__name__}")
    else:
        scene = geometry if isinstance(geometry, trimesh.Scene) else trimesh.Scene([geometry])
        parts = [part for part in _parts_of_scene(where, scene) if len(part.faces)]
    if not parts:
        raise InputError(where, "mesh", "expected at least one triangle, found none")
    return _assembled(where, parts, unit)


def _assembled(path: Path, parts: Sequence[_Part], unit: LengthUnit | None) -> MeshFile:
    """One clean mesh, m, of the bodies of a file."""
    scales = [1.0 if part.declared is None else part.declared for part in parts]
    source = "assumed" if all(part.declared is None for part in parts) else "declared"
    if unit is not None:
        scales, source = [unit.metres] * len(parts), "stated"
    vertices = np.concatenate([p.vertices * s for p, s in zip(parts, scales, strict=True)])
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = np.concatenate([p.faces + k for p, k in zip(parts, starts, strict=False)])
    _check(path, vertices, faces)
    mesh = cleaned(vertices, faces)
    if len(mesh.faces) == 0:
        raise InputError(path, "faces", "expected faces with an area, found only degenerate ones")
    diameter_m = float(np.linalg.norm(np.ptp(mesh.bounds, axis=0)))
    doubt = unit_doubt(diameter_m, scales[0]) if unit is None else None
    origin = MeshOrigin(len(mesh.faces), scales[0], source, unit, doubt)
    return MeshFile(mesh, origin)


def companion_files(path: Path) -> tuple[Path, ...]:
    """The files beside a mesh file without which it cannot be read. Raises `InputError`."""
    return buffer_files(path) if path.suffix.lower() == ".gltf" else ()


def _check(path: Path, vertices: FloatArray, faces: IntArray) -> None:
    """Raises `InputError` for triangles that are none."""
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(path, "faces", "expected corners that are vertices of the file")
    used = vertices[faces]
    if not np.all(np.isfinite(used)):
        raise InputError(path, "vertices", "expected finite coordinates, found nan or inf")
    # Vertices are merged on a grid of integers, which ends somewhere.
    if np.abs(used).max() > _MAX_COORDINATE_M:
        expected = f"expected coordinates within {_MAX_COORDINATE_M:g} m of the origin"
        raise InputError(path, "vertices", f"{expected}: in which unit are they (--mesh-unit)?")


def _parts(path: Path, kind: str) -> list[_Part]:
    """The bodies of a file, at least one."""
    if kind in _GLTF:
        check_gltf(path)
    try:
        if zipfile.is_zipfile(path):
            _check_archive(path)
        if kind == "obj" and obj.has_polygons(content := path.read_bytes()):
            parts = [_Part(*obj.read_polygons(content), None)]
        else:
            parts = _parts_of_scene(path, _scene(path, kind))
    except InputError:
        raise
    except MemoryError as error:
        raise InputError(path, "file", "expected a mesh that fits into memory") from error
    except Exception as error:  # The loaders raise whatever a damaged file leads them to.
        reason = "".join(mark if mark.isprintable() else " " for mark in str(error))[:_MAX_REASON]
        expected = f"expected a readable {kind.upper()} mesh ({reason or type(error).__name__})"
        raise InputError(path, "file", expected) from error
    parts = [part for part in parts if len(part.faces)]
    if not parts:
        raise InputError(path, "faces", "expected at least one face, found none")
    stated, found = stated_faces(path, kind), sum(len(part.faces) for part in parts)
    if found < stated:
        raise InputError(path, "faces", f"expected the {stated} that it states, found {found}")
    return parts


def _check_archive(path: Path) -> None:
    """Raises `InputError` for an archive that would fill the memory."""
    with zipfile.ZipFile(path) as archive:
        if sum(entry.file_size for entry in archive.infolist()) > _MAX_UNPACKED:
            expected = f"expected at most {_MAX_UNPACKED:,} bytes when unpacked"
            raise InputError(path, "file", expected)


def _scene(path: Path, kind: str) -> trimesh.Scene:
    # Without this an OBJ that names an absent material file logs a warning for each material.
    options: dict[str, Any] = {"skip_materials": True} if kind in _TAKES_SKIP_MATERIALS else {}
    return trimesh.load_scene(path, file_type=kind, process=False, **options)


def _parts_of_scene(path: Path, scene: trimesh.Scene) -> list[_Part]:
    """The bodies of a scene, once for each of their instances."""
    nodes = [(node, *scene.graph[node]) for node in scene.graph.nodes_geometry]
    bodies = {name: each for name, each in scene.geometry.items() if _is_surface(each)}
    count = sum(len(bodies[name].faces) for _, _, name in nodes if name in bodies)
    if count > _MAX_TRIANGLES:
        expected = f"expected at most {_MAX_TRIANGLES:,} triangles, found {count:,}: reduce them"
        raise InputError(path, "faces", expected)
    if not bodies and scene.geometry:
        points = sum(len(getattr(each, "vertices", ())) for each in scene.geometry.values())
        expected = "expected a surface of triangles, found"
        expected = f"{expected} a cloud of {points:,} points: reconstruct its surface first"
        raise InputError(path, "faces", expected)
    return [
        _placed(bodies[name], np.asarray(T, dtype=np.float64))
        for _, T, name in nodes
        if name in bodies
    ]


def _is_surface(geometry: object) -> bool:
    return isinstance(geometry, trimesh.Trimesh) and len(geometry.faces) > 0


def _placed(body: trimesh.Trimesh, T_file_body: FloatArray) -> _Part:
    vertices = np.asarray(body.vertices, dtype=np.float64)
    if vertices.shape[1:] != (3,):
        raise ValueError("a vertex without three coordinates")
    # Exactly as they are, where nothing moves them.
    if not np.array_equal(T_file_body, np.eye(4)):
        vertices = vertices @ T_file_body[:3, :3].T + T_file_body[:3, 3]
    faces = np.asarray(body.faces, dtype=np.intp)
    if np.linalg.det(T_file_body[:3, :3]) < 0.0:
        faces = faces[:, ::-1]
    return _Part(vertices, faces, declared_scale(body))
