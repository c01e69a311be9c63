"""Writing a mesh so that it is read back as it is."""

from pathlib import Path

import trimesh

_DIGITS = 17
"""Of every coordinate: those that tell any two numbers apart."""


def write_mesh(mesh: trimesh.Trimesh, path: Path) -> None:
    """Write vertices and triangles, m, as OBJ."""
    text = trimesh.exchange.obj.export_obj(
        mesh, include_normals=False, include_color=False, include_texture=False, digits=_DIGITS
    )
    path.write_text(text, encoding="utf-8")
