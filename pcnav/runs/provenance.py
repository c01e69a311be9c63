"""What a run was made with: library versions and the pipeline file as run."""

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

import tomli_w

import pcnav
from pcnav.config.pipeline_file import Pipeline

_DISTRIBUTIONS = {
    "numpy": ("numpy",),
    "scipy": ("scipy",),
    # One import name, two distributions: the small one exists for Linux x86-64 only.
    "open3d": ("open3d-cpu", "open3d"),
    "trimesh": ("trimesh",),
    "filterpy": ("filterpy",),
}
_PEERS = {
    "kiss-icp": ("kiss-icp",),
    "small_gicp": ("small_gicp",),
}
"""Whose numbers end up in comparisons only."""


def library_versions() -> dict[str, str]:
    """Versions of pcnav, Python and the libraries whose numbers end up in a result."""
    own = {"pcnav": pcnav.__version__, "python": platform.python_version()}
    return own | _versions(_DISTRIBUTIONS)


def library_versions_with_peers() -> dict[str, str]:
    """`library_versions` and those of the libraries that pcnav is compared with."""
    return library_versions() | _versions(_PEERS)


def pipeline_toml(
    pipeline: Pipeline, versions: Mapping[str, str], *, of_a_run: bool = False
) -> str:
    """A pipeline, every default spelled out, as TOML that `read_pipeline` reads back.

    The versions go into comments at the top, so the file can be run again as it is.
    ``of_a_run`` leaves out the tables that describe a simulation or another estimator.
    """
    comments = "".join(f"# {name} {text}\n" for name, text in versions.items())
    return comments + "\n" + tomli_w.dumps(pipeline.stated(of_a_run))


def _versions(distributions: Mapping[str, tuple[str, ...]]) -> dict[str, str]:
    """By name, of the first distribution that is installed."""
    versions = {}
    for name, candidates in distributions.items():
        found = map(_installed_version, candidates)
        versions[name] = next((text for text in found if text), "not installed")
    return versions


def _installed_version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""
