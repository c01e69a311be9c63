"""What a run was made with: library versions and the pipeline file as run."""

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

import tomli_w

import pcnav
from pcnav.config import Pipeline

_DISTRIBUTIONS = {
    "numpy": ("numpy",),
    "scipy": ("scipy",),
    # One import name, two distributions: the small one exists for Linux x86-64 only.
    "open3d": ("open3d-cpu", "open3d"),
    "trimesh": ("trimesh",),
    "filterpy": ("filterpy",),
}


def library_versions() -> dict[str, str]:
    """Versions of pcnav, Python and the libraries whose numbers end up in a result."""
    versions = {"pcnav": pcnav.__version__, "python": platform.python_version()}
    for name, distributions in _DISTRIBUTIONS.items():
        found = [_installed_version(distribution) for distribution in distributions]
        versions[name] = next((text for text in found if text), "not installed")
    return versions


def pipeline_toml(pipeline: Pipeline, versions: Mapping[str, str]) -> str:
    """The pipeline as run, every default spelled out, as TOML that `read_pipeline` reads back.

    The versions go into comments at the top, so the file can be run again as it is. Keys whose
    value is None are left out: TOML has no null, and None is their default.
    """
    comments = "".join(f"# {name} {text}\n" for name, text in versions.items())
    return comments + "\n" + tomli_w.dumps(pipeline.model_dump(mode="json", exclude_none=True))


def _installed_version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""
