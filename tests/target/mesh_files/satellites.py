"""A small satellite of several bodies, and files of it as public libraries write them."""

import numpy as np
import trimesh


def clean_parts() -> list[trimesh.Trimesh]:
    """A hexagonal bus, a panel on a boom and a dish: closed, apart from each other, no symmetry."""
    bus = trimesh.creation.cylinder(radius=0.8, height=1.6, sections=6)
    panel = trimesh.creation.box(extents=(0.04, 3.0, 1.1))
    panel.apply_translation([0.2, 2.6, 0.1])
    boom = trimesh.creation.box(extents=(0.1, 0.2, 0.1))
    boom.apply_translation([0.2, 0.95, 0.1])
    dish = trimesh.creation.icosphere(subdivisions=2, radius=0.4)
    dish.apply_scale([1.0, 1.0, 0.4])
    dish.apply_translation([0.1, -0.2, 1.1])
    return [bus, panel, boom, dish]


def joined(parts: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    """The parts as one mesh."""
    starts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    faces = [part.faces + start for part, start in zip(parts, starts, strict=False)]
    vertices = np.vstack([part.vertices for part in parts])
    return trimesh.Trimesh(vertices, np.vstack(faces), process=False)


def as_file(folder, name: str, mesh: trimesh.Trimesh, **options):
    """A mesh as trimesh writes it, in a folder that may get files beside it."""
    path = folder / name
    content = mesh.export(file_type=path.suffix.lstrip("."), **options)
    if isinstance(content, dict):
        # A glTF of several files calls itself model.gltf.
        for each, data in content.items():
            (folder / each.replace("model.gltf", name)).write_bytes(data)
        return path
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path
