"""Which files hold a mesh that can be read, and what to do about those that do not."""

import re
from pathlib import Path

from trimesh.exchange.load import mesh_formats

from pcnav.core.errors import InputError

_POINTS = {"xyz", "pcd", "las", "laz", "pts", "e57"}
_SOLIDS = {
    *("step", "stp", "iges", "igs", "brep", "fcstd", "sldprt", "sldasm", "catpart", "catproduct"),
    *("ipt", "iam", "prt", "asm", "x_t", "x_b", "f3d", "3dm", "jt", "dwg"),
}
_SCENES = {
    *("fbx", "blend", "3ds", "max", "ma", "mb", "c4d", "lwo", "skp", "usd", "usda", "usdc"),
    *("usdz", "x3d", "wrl", "vrml", "abc", "x", "ply2", "vtk", "vtp", "vtu"),
}
_ARCHIVES = {"zip", "7z", "rar", "tar", "gz", "bz2", "xz", "tgz"}
_STATED = {
    "ply": re.compile(rb"^element face (\d+)", re.MULTILINE),
    "off": re.compile(rb"\A\s*OFF\s+(?:#[^\n]*\s+)*\d+\s+(\d+)"),
}
_HEADER_BYTES = 65_536
_READ = "STL, PLY, OBJ, GLB, glTF, 3MF, OFF or DAE"


def mesh_format(path: Path) -> str:
    """The format of a mesh file by its suffix, as trimesh calls it.

    Raises `InputError`, which says what to do, for one that holds no mesh of triangles or that
    nothing here reads.
    """
    kind = path.suffix.lower().lstrip(".")
    if kind in _POINTS:
        expected = f"expected a surface of triangles, got points (.{kind}): reconstruct it first"
    elif kind in mesh_formats():
        return kind
    elif kind in _SOLIDS:
        expected = (
            f"expected triangles, got CAD solids (.{kind}): export them as STL, 3MF or GLB "
            "from a CAD program"
        )
    elif kind in _SCENES:
        expected = (
            f"expected {_READ}, got .{kind}: export it as GLB or OBJ from Blender or the program "
            "that wrote it"
        )
    elif kind in _ARCHIVES:
        expected = f"expected the mesh itself, got an archive (.{kind}): unpack it"
    else:
        expected = f"expected {_READ}, got {f'.{kind}' if kind else 'no suffix'}"
    raise InputError(path, "file", expected)


def stated_faces(path: Path, kind: str) -> int:
    """How many faces a file says that it holds; 0 where its format does not tell."""
    if kind not in _STATED:
        return 0
    with path.open("rb") as file:
        found = _STATED[kind].search(file.read(_HEADER_BYTES))
    return 0 if found is None else int(found[1])
