"""The satellites and pipelines that come with pcnav, wherever it is installed.

In a checkout they lie in ``meshes/`` and ``pipelines/`` beside the package; a wheel carries the
same folders inside it, as ``pcnav/data/meshes`` and ``pcnav/data/pipelines``.
"""

from pathlib import Path

from pcnav.files.toml_file import read_toml

_PACKAGE = Path(__file__).resolve().parent.parent
_MESH_SUFFIXES = (".glb", ".obj", ".ply", ".stl")
_PIPELINE_SUFFIXES = (".toml",)
_GRID_TABLE = "batch"
"""A file with this table is a grid of cases, any other one a pipeline."""


def shipped_mesh(name: str) -> Path | None:
    """The mesh file of a shipped satellite, named with or without its suffix; None if unknown."""
    return _find(name, _files("meshes", _MESH_SUFFIXES))


def shipped_pipeline(name: str) -> Path | None:
    """A shipped pipeline or grid file, named with or without ``.toml``; None if unknown."""
    return _find(name, _files("pipelines", _PIPELINE_SUFFIXES))


def shipped_mesh_names() -> tuple[str, ...]:
    """Names of the shipped satellites, in alphabetical order."""
    return tuple(path.stem for path in _files("meshes", _MESH_SUFFIXES))


def shipped_pipeline_names() -> tuple[str, ...]:
    """Names of the shipped pipelines, in alphabetical order."""
    return tuple(
        path.stem for path in _files("pipelines", _PIPELINE_SUFFIXES) if not _is_grid(path)
    )


def shipped_grid_names() -> tuple[str, ...]:
    """Names of the shipped grids of cases, in alphabetical order."""
    files = _files("pipelines", _PIPELINE_SUFFIXES)
    return tuple(path.stem for path in files if _is_grid(path))


def _is_grid(path: Path) -> bool:
    return _GRID_TABLE in read_toml(path)


def _find(name: str, files: tuple[Path, ...]) -> Path | None:
    return next((path for path in files if name in (path.stem, path.name)), None)


def _files(folder: str, suffixes: tuple[str, ...]) -> tuple[Path, ...]:
    """The files of a shipped folder by name; none where the folder is absent."""
    found = _folder(folder)
    if not found.is_dir():
        return ()
    return tuple(sorted(path for path in found.iterdir() if path.suffix.lower() in suffixes))


def _folder(name: str) -> Path:
    """Where a shipped folder lies: inside an installed package, or beside it in a checkout."""
    installed = _PACKAGE / "data" / name
    return installed if installed.is_dir() else _PACKAGE.parent / name
