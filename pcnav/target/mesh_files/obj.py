"""OBJ files whose faces have more than three corners."""

import re
from collections import defaultdict

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.target.mesh_files.polygons import triangulated

_POLYGON = re.compile(rb"^[ \t]*f(?:[ \t]+[^\s#]+){4}", re.MULTILINE)


def has_polygons(content: bytes) -> bool:
    """Whether any face has more than three corners."""
    return b"\\\n" in content or _POLYGON.search(content) is not None


def read_polygons(content: bytes) -> tuple[FloatArray, IntArray]:
    """Vertices (n, 3) and triangles (m, 3) of an OBJ file; points and lines are left out.

    Raises `ValueError` for what is no number.
    """
    text = content.decode("utf-8", errors="replace").replace("\\\r\n", " ").replace("\\\n", " ")
    vertices: list[list[str]] = []
    polygons: defaultdict[int, list[list[int]]] = defaultdict(list)
    for line in text.splitlines():
        words = line.partition("#")[0].split()
        if not words:
            continue
        if words[0] == "v":
            vertices.append(words[1:4])
        elif words[0] == "f":
            corners = [int(word.partition("/")[0]) for word in words[1:]]
            # Counted from 1, or backwards from the last vertex so far.
            seen = len(vertices)
            corners = [seen + k if k < 0 else k - 1 for k in corners]
            if len(corners) >= 3:
                polygons[len(corners)].append(corners)
    points = np.array(vertices, dtype=np.float64).reshape(-1, 3)
    groups = [np.array(group, dtype=np.intp) for group in polygons.values()]
    if any(np.any((group < 0) | (group >= len(points))) for group in groups):
        raise ValueError("a face names a vertex that is not there")
    return points, triangulated(points, groups)
