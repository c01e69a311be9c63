"""What can be said of a glTF file by its header, before anything large is read."""

import importlib.util
import json
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from pcnav.core.errors import InputError

_MAGIC, _JSON = b"glTF", b"JSON"
_MAX_HEADER = 200_000_000
_MAX_ELEMENTS = 100_000_000
"""In one accessor: no mesh that can be worked with has as many."""
_DRACO = "KHR_draco_mesh_compression"
_MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_TRIANGLES = (4, 5, 6)
"""Modes of primitives made of triangles: single, strips, fans."""


def check_gltf(path: Path) -> None:
    """Raises `InputError`, which says what to do, for a file that trimesh cannot or must not read.

    That is one compressed in a way for which nothing is installed, without its buffers, of points
    and lines alone, or with more elements than memory holds.
    """
    header = _header(path)
    used = {
        str(name) for key in ("extensionsRequired", "extensionsUsed") for name in _list(header, key)
    }
    required = {str(name) for name in _list(header, "extensionsRequired")}
    if required.intersection(_MESHOPT):
        expected = (
            "expected no meshopt compression: decompress it, with `gltf-transform copy IN OUT` or "
            "by importing and exporting it in Blender"
        )
        raise InputError(path, "extensionsRequired", expected)
    if _DRACO in used and importlib.util.find_spec("DracoPy") is None:
        expected = (
            "its meshes are compressed by Draco: expected the extra `formats` to be installed, "
            "which brings DracoPy"
        )
        raise InputError(path, "extensionsUsed", expected)
    for number, buffer in enumerate(_list(header, "buffers")):
        name = _external(buffer)
        if name is not None and not (path.parent / name).is_file():
            expected = f"expected the file {name} beside it, found none"
            raise InputError(path, f"buffers.{number}.uri", expected)
    positions = {
        primitive.get("attributes", {}).get("POSITION") for primitive in _primitives(header)
    }
    for number, accessor in enumerate(_list(header, "accessors")):
        count = accessor.get("count") if isinstance(accessor, dict) else None
        if not isinstance(count, int) or not 0 <= count <= _MAX_ELEMENTS:
            expected = f"expected a number up to {_MAX_ELEMENTS:,}"
            raise InputError(path, f"accessors.{number}.count", expected)
        if number in positions and (accessor.get("normalized") or "sparse" in accessor):
            expected = "expected plain coordinates, found quantised or sparse ones: "
            expected += "write them out with `gltf-transform dequantize IN OUT` or from Blender"
            raise InputError(path, f"accessors.{number}", expected)
    modes = {primitive.get("mode", _TRIANGLES[0]) for primitive in _primitives(header)}
    if modes and not modes.intersection(_TRIANGLES):
        raise InputError(path, "meshes", "expected triangles, found points or lines alone")


def buffer_files(path: Path) -> tuple[Path, ...]:
    """The files beside a glTF file that it takes its geometry from. Raises `InputError`."""
    names = (_external(buffer) for buffer in _list(_header(path), "buffers"))
    return tuple(path.parent / name for name in names if name is not None)


def _external(buffer: object) -> str | None:
    """Name of the file that a buffer lies in; None where it lies in the glTF file itself."""
    uri = buffer.get("uri") if isinstance(buffer, dict) else None
    if not isinstance(uri, str) or uri.startswith("data:"):
        return None
    return unquote(uri)


def _header(path: Path) -> dict[str, Any]:
    """The JSON of a glTF or GLB file."""
    with path.open("rb") as file:
        content = file.read(20)
        if content[:4] == _MAGIC:
            size = int.from_bytes(content[12:16], "little")
            if content[16:20] != _JSON or size > _MAX_HEADER:
                raise InputError(path, "file", "expected a GLB file of version 2")
            content = file.read(size)
        elif path.suffix.lower() == ".glb":
            raise InputError(path, "file", "expected a GLB file, which begins with glTF")
        else:
            content += file.read(_MAX_HEADER)
    try:
        header = json.loads(content.decode("utf-8-sig").rstrip("\0 "))
    except (ValueError, RecursionError) as error:
        raise InputError(path, "file", "expected the JSON header of a glTF file") from error
    if not isinstance(header, dict):
        raise InputError(path, "file", "expected the JSON header of a glTF file")
    return header


def _primitives(header: dict[str, Any]) -> list[dict[str, Any]]:
    """What the meshes of a file are made of."""
    meshes = [mesh for mesh in _list(header, "meshes") if isinstance(mesh, dict)]
    found = [primitive for mesh in meshes for primitive in _list(mesh, "primitives")]
    return [each for each in found if isinstance(each, dict) and _is_table(each, "attributes")]


def _is_table(table: dict[str, Any], key: str) -> bool:
    return isinstance(table.get(key), dict)


def _list(table: dict[str, Any], key: str) -> list[Any]:
    found = table.get(key, [])
    return found if isinstance(found, list) else []
