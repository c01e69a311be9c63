"""Pipelines and meshes by path or shipped name."""

from pathlib import Path
from typing import TYPE_CHECKING

from pcnav.core.errors import InputError

if TYPE_CHECKING:  # heavy imports sit inside the functions, so that --help answers at once
    from pcnav.config.pipeline_file import Pipeline


def named_pipeline(name: str) -> "tuple[Path, Pipeline]":
    """A pipeline by path, that of a result among them, or shipped name."""
    from pcnav.config.pipeline_file import read_pipeline
    from pcnav.config.shipped import shipped_pipeline, shipped_pipeline_names
    from pcnav.runs.places import located

    path = Path(name)
    if not path.is_file():
        shipped = shipped_pipeline(name)
        if shipped is None:
            known = ", ".join(shipped_pipeline_names())
            raise InputError(path, "pipeline", f"expected a TOML file or one of: {known}")
        path = shipped
    return path, located(read_pipeline(path), path.parent)


def named_mesh(name: str) -> Path:
    """A mesh by path or shipped name."""
    from pcnav.config.shipped import shipped_mesh

    path = Path(name)
    found = path if path.is_file() else shipped_mesh(name)
    if found is None:
        raise InputError(path, "mesh", _known_meshes())
    return found


def mesh_of_pipeline(pipeline: Path, name: str) -> Path:
    """The mesh a pipeline file names: a path relative to the file, or a shipped name."""
    from pcnav.config.shipped import shipped_mesh

    path = pipeline.parent / name
    found = path if path.is_file() else shipped_mesh(name)
    if found is None:
        raise InputError(pipeline, "target_mesh", f"{_known_meshes()}, got {name}")
    return found


def _known_meshes() -> str:
    from pcnav.config.shipped import shipped_mesh_names

    return f"expected a mesh file or one of: {', '.join(shipped_mesh_names())}"
