"""The house: which room may use which, and what stays out of an estimate."""

import ast
from pathlib import Path

import pytest

ROOMS = (
    *("core", "files", "dynamics", "config", "target", "filtering", "recordings", "runs"),
    *("perception", "simulation", "estimators", "evaluation", "report", "navigation"),
    *("pipeline", "following", "tracker", "viewer", "batch", "cli"),
)
"""In the order of the data flow: a room imports from itself and from those before it."""

BLIND = {"perception", "estimators", "filtering"}
"""Rooms in which estimates are made: the truth and what knows it stay out."""
KNOWS_THE_TRUTH = {"pcnav.simulation", "pcnav.evaluation", "pcnav.recordings.truth", "studies"}


def modules(repository: Path) -> list[Path]:
    """The files of the package."""
    return sorted((repository / "pcnav").rglob("*.py"))


def imports_of(path: Path) -> set[str]:
    """Full names of everything a file imports, also inside its functions."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    return names


def room_of(path: Path, repository: Path) -> str:
    """The folder below the package, or the file that stands at its top."""
    return path.relative_to(repository / "pcnav").with_suffix("").parts[0].rpartition("_")[2]


def test_every_folder_is_a_room_and_imports_point_left(repository: Path) -> None:
    checked = 0
    for path in modules(repository):
        if path.parent == repository / "pcnav" and path.stem.startswith("__"):
            continue
        own = room_of(path, repository)
        assert own in ROOMS, f"{path.name} stands in no room"
        for name in imports_of(path):
            if name.startswith("pcnav.") and name.count(".") > 1:
                other = name.split(".")[1].rpartition("_")[2]
                assert ROOMS.index(other) <= ROOMS.index(own), f"{path} imports {name}"
                checked += 1
    assert checked > 500


def test_truth_stays_out_of_estimates(repository: Path) -> None:
    for path in modules(repository):
        if room_of(path, repository) in BLIND:
            for name in imports_of(path):
                assert not any(name.startswith(known) for known in KNOWS_THE_TRUTH), path


@pytest.mark.parametrize(
    ("library", "where"),
    [
        ("kiss_icp", "pcnav/estimators/peers"),
        ("open3d", "pcnav/core/_open3d.py"),
        ("studies", "studies"),
    ],
)
def test_some_libraries_have_one_door(repository: Path, library: str, where: str) -> None:
    users = {
        path.relative_to(repository).as_posix()
        for path in modules(repository)
        if any(name.split(".")[0] == library for name in imports_of(path))
    }
    assert all(user.startswith(where) for user in users), users
