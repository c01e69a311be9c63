"""What a run was made with: library versions and the pipeline file as run."""

import platform
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version

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
    lines = [f"# {name} {text}" for name, text in versions.items()]
    content = pipeline.model_dump(mode="json")
    lines += ["", *_toml_lines(content)]
    for name, table in content.items():
        if isinstance(table, dict):
            lines += ["", f"[{name}]", *_toml_lines(table)]
    return "\n".join(lines) + "\n"


def _installed_version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return ""


def _toml_lines(table: Mapping[str, object]) -> list[str]:
    """``key = value`` of the entries that are not tables themselves."""
    return [
        f"{key} = {_toml_value(value)}"
        for key, value in table.items()
        if value is not None and not isinstance(value, dict)
    ]


def _toml_value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml_value(item) for item in value) + "]"
    if isinstance(value, str):
        return _toml_string(value)
    raise TypeError(f"no TOML form for {type(value).__name__}")


def _toml_string(text: str) -> str:
    """A basic string: quotes, backslashes and control characters are escaped."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\U{ord(c):08x}" for c in escaped) + '"'
