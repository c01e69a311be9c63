"""What a user installs: one version, types, data, exact dependencies, a fast command."""

import ast
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path

import pytest
import typer
from hatchling.builders.wheel import WheelBuilder
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import pcnav
from pcnav.cli import app
from pcnav.config.shipped import (
    shipped_mesh,
    shipped_mesh_names,
    shipped_pipeline,
    shipped_pipeline_names,
)
from pcnav.core.errors import InputError
from tests.commands import PATIENCE_S

PYTHONS = ("3.11", "3.12", "3.13")
SYSTEMS = (("linux", "x86_64"), ("linux", "aarch64"), ("darwin", "arm64"), ("win32", "AMD64"))
HEAVY = ("matplotlib", "numpy", "open3d", "scipy", "trimesh", "viser")
EXTRAS = ("view", "batch", "peers", "images", "bags", "formats")
"""Of `pip install pcnav[...]`: what not every run needs."""


@pytest.fixture(scope="session")
def project(repository: Path) -> dict:
    """The [project] table of pyproject.toml."""
    return tomllib.loads((repository / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture(scope="session")
def pins(repository: Path) -> list[Requirement]:
    """The lines of constraints.txt."""
    lines = (repository / "constraints.txt").read_text(encoding="utf-8").splitlines()
    return [Requirement(line) for line in lines if line and not line.startswith("#")]


@pytest.fixture(scope="session")
def wheel(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel as the build backend makes it, built once."""
    folder = tmp_path_factory.mktemp("wheel")
    (built,) = WheelBuilder(str(repository)).build(directory=str(folder), versions=["standard"])
    return Path(built)


@pytest.fixture(scope="session")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that holds what the wheel installs."""
    folder = tmp_path_factory.mktemp("installed")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(folder)
    return folder


def run_python(code: str, search_path: Path) -> str:
    """Output of a fresh interpreter that finds pcnav in one folder and not in the checkout."""
    script = f"import sys; sys.path.insert(0, {str(search_path)!r})\n{code}"
    command = [sys.executable, "-W", "error", "-c", script]
    finished = subprocess.run(
        command, cwd=search_path, capture_output=True, text=True, check=False, timeout=PATIENCE_S
    )
    assert finished.returncode == 0, finished.stderr
    return finished.stdout


def environments() -> Iterator[dict[str, str]]:
    """Marker environments of every supported Python and system."""
    for python in PYTHONS:
        for system, machine in SYSTEMS:
            yield {
                "python_version": python,
                "python_full_version": f"{python}.0",
                "sys_platform": system,
                "platform_machine": machine,
                "platform_python_implementation": "CPython",
                "extra": "",
            }


def applies(requirement: Requirement, environment: dict[str, str]) -> bool:
    """Whether a requirement holds in an environment."""
    return requirement.marker is None or requirement.marker.evaluate(environment)


def test_version_is_stated_once(project: dict, repository: Path, wheel: Path) -> None:
    assert "version" not in project
    assert project["dynamic"] == ["version"]
    assert wheel.name.startswith(f"pcnav-{pcnav.__version__}-")
    stated = re.compile(rf"""version_*["']?\s*[:=]+\s*["']?{re.escape(pcnav.__version__)}["']""")
    files = [repository / "pyproject.toml", *sorted((repository / "pcnav").rglob("*.py"))]
    where = [file.name for file in files if stated.search(file.read_text(encoding="utf-8"))]
    assert where == ["__init__.py"]


def test_wheel_carries_types_licence_and_modules(repository: Path, installed: Path) -> None:
    assert (installed / "pcnav" / "py.typed").is_file()
    assert list(installed.glob("*.dist-info/licenses/LICENSE"))
    modules = {path.relative_to(repository) for path in (repository / "pcnav").rglob("*.py")}
    assert len(modules) > 10
    assert modules <= {path.relative_to(installed) for path in installed.rglob("*.py")}
    top_level = {path.name for path in installed.iterdir() if path.suffix != ".dist-info"}
    assert top_level == {"pcnav"}


def test_wheel_carries_every_study_with_its_text(repository: Path, installed: Path) -> None:
    listed = run_python("from pcnav.studies import STUDIES; print(*STUDIES)", installed).split()
    assert listed == sorted(path.parent.name for path in repository.glob("studies/*/study.py"))
    for name in listed:
        assert (installed / "pcnav" / "studies" / name / "text.md").is_file()


def test_wheel_finds_the_same_satellites_and_pipelines(installed: Path) -> None:
    code = (
        "from pcnav.config import shipped\n"
        "names = shipped.shipped_mesh_names(), shipped.shipped_pipeline_names()\n"
        "files = [*map(shipped.shipped_mesh, names[0]), *map(shipped.shipped_pipeline, names[1])]\n"
        "print(repr((names, [str(file) for file in files])))\n"
    )
    names, files = eval(run_python(code, installed))
    assert names == (shipped_mesh_names(), shipped_pipeline_names())
    for file in map(Path, files):
        assert file.is_relative_to(installed / "pcnav" / "data")
        assert file.stat().st_size > 0


def test_shipped_files_are_found_by_name_with_or_without_suffix(repository: Path) -> None:
    assert shipped_mesh_names()
    assert shipped_pipeline_names()
    for names, find in (
        (shipped_mesh_names(), shipped_mesh),
        (shipped_pipeline_names(), shipped_pipeline),
    ):
        for name in names:
            file = find(name)
            assert file is not None
            assert file.is_relative_to(repository)
            assert find(file.name) == file
    assert shipped_mesh("no-such-satellite") is None
    assert shipped_pipeline("../pyproject.toml") is None


def test_help_answers_without_the_heavy_libraries(repository: Path) -> None:
    code = (
        "from typer.testing import CliRunner\n"
        "from pcnav.cli import app\n"
        "answer = CliRunner().invoke(app, ['--help'])\n"
        "assert answer.exit_code == 0, answer.output\n"
        f"print('Usage' in answer.output, [name for name in {HEAVY!r} if name in sys.modules])\n"
    )
    assert run_python(code, repository).split(maxsplit=1) == ["True", "[]\n"]


def test_the_package_itself_costs_nothing_and_names_what_programs_use(repository: Path) -> None:
    heavy = run_python(
        f"import sys, pcnav\nprint([name for name in {HEAVY!r} if name in sys.modules])", repository
    )
    assert heavy == "[]\n"
    assert all(getattr(pcnav, name) is not None for name in pcnav.__all__)
    assert set(pcnav.__all__) == set(pcnav._HOMES) < set(dir(pcnav))
    tree = ast.parse(Path(pcnav.__file__).read_text(encoding="utf-8"))
    seen_by_types = {
        alias.name: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("pcnav.")
        for alias in node.names
    }
    assert seen_by_types == pcnav._HOMES


@pytest.fixture(scope="session")
def of_extras(project: dict) -> set[str]:
    """Top-level modules that the extras install, and the core does not."""
    named = {
        canonicalize_name(Requirement(line).name)
        for extra in EXTRAS
        for line in project["optional-dependencies"][extra]
    }
    found = {
        module
        for module, providers in packages_distributions().items()
        if named & {canonicalize_name(provider) for provider in providers}
    }
    assert {"viser", "pandas", "distributed", "pyarrow", "kiss_icp", "cv2"} <= found
    return found


def imported_at_once(file: Path) -> set[str]:
    """What a module imports as it is imported itself: not inside functions, nor for types alone."""
    names, left = set[str](), list(ast.parse(file.read_text(encoding="utf-8")).body)
    while left:
        node = left.pop()
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
        elif isinstance(node, ast.If) and "TYPE_CHECKING" not in ast.unparse(node.test):
            left += [*node.body, *node.orelse]
    return names


def test_the_core_takes_no_extra(repository: Path, of_extras: set[str]) -> None:
    """What a run, a program, a simulation, an export and their commands import, and what that
    does, and so on."""
    left = [
        *("pcnav.pipeline", "pcnav.tracker", "pcnav.simulation.simulate", "pcnav.cli"),
        *("pcnav.runs.export.registry", "pcnav.report.run_report", "pcnav.estimators.registry"),
    ]
    folders = sorted((repository / "pcnav" / "estimators").glob("*/estimator.py"))
    left += [f"pcnav.estimators.{path.parent.name}.estimator" for path in folders]
    left.append("pcnav.estimators.depth.tracker")
    seen = set[str]()
    while left:
        name = left.pop()
        place = repository.joinpath(*name.split("."))
        files = [
            path for path in (place.with_suffix(".py"), place / "__init__.py") if path.exists()
        ]
        if name in seen or (name.startswith("pcnav") and not files):
            continue
        seen.add(name)
        assert name.partition(".")[0] not in of_extras, name
        left += [each for file in files for each in imported_at_once(file)]
    assert {"pcnav.perception.planes", "pcnav.report.figures", "matplotlib.figure"} <= seen
    assert len(seen) > 300


@pytest.mark.parametrize(
    ("arguments", "extra"),
    [
        (("view", "run"), "view"),
        (("table", "accuracy", "-o", "out"), "batch"),
        (("study", "yu2019", "-o", "out"), "batch"),
    ],
)
def test_a_command_without_its_extra_names_it(
    arguments: tuple[str, ...], extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pcnav.core._extras.find_spec", lambda _: None)
    with pytest.raises(InputError, match=rf"expected the extra `{extra}` .* 'pcnav\[{extra}\]'"):
        typer.main.get_command(app)(list(arguments), standalone_mode=False)


def imported_modules(folder: Path) -> set[str]:
    """Top-level names of everything the modules of a folder import, anywhere in their code."""
    names: set[str] = set()
    for file in sorted(folder.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
                names.add(node.module.partition(".")[0])
    return names


def test_every_import_is_a_stated_dependency(project: dict, repository: Path) -> None:
    lines = list(project["dependencies"])
    for extra in EXTRAS:
        lines += project["optional-dependencies"][extra]
    stated = {canonicalize_name(Requirement(line).name) for line in lines}
    providers = packages_distributions()
    third_party = imported_modules(repository / "pcnav") - sys.stdlib_module_names - {"pcnav"}
    assert {"numpy", "kiss_icp", "trimesh"} <= third_party
    unstated = {
        name
        for name in third_party
        if not stated & {canonicalize_name(provider) for provider in providers.get(name, [])}
    }
    assert not unstated, "imported, but not among the dependencies of pyproject.toml"


def test_constraints_are_exact(pins: list[Requirement]) -> None:
    assert len(pins) > 50
    for pin in pins:
        assert pin.url is None
        assert re.fullmatch(r"==[^*,]+", str(pin.specifier)), pin


def test_constraints_pin_every_dependency_within_its_range(
    project: dict, pins: list[Requirement]
) -> None:
    stated = list(project["dependencies"])
    for extra in project["optional-dependencies"].values():
        stated += [line for line in extra if not line.startswith("pcnav[")]
    requirements = [Requirement(line) for line in [*stated, "hatchling", "editables"]]
    for environment in environments():
        pinned = {
            canonicalize_name(pin.name): str(pin.specifier).removeprefix("==")
            for pin in pins
            if applies(pin, environment)
        }
        for requirement in requirements:
            if applies(requirement, environment):
                version = pinned.get(canonicalize_name(requirement.name))
                assert version is not None, (requirement.name, environment)
                assert requirement.specifier.contains(version), (requirement, version)


def test_constraints_pin_all_that_the_dependencies_need(
    project: dict, pins: list[Requirement]
) -> None:
    pinned = {canonicalize_name(pin.name) for pin in pins}
    queue = [Requirement(line) for line in project["dependencies"]]
    for extra in EXTRAS:
        queue += [Requirement(line) for line in project["optional-dependencies"][extra]]
    seen: set[tuple[str, frozenset[str]]] = set()
    while queue:
        requirement = queue.pop()
        extras = ["", *requirement.extras]
        key = (canonicalize_name(requirement.name), frozenset(extras))
        marker = requirement.marker
        if key in seen or (marker is not None and not marker.evaluate({"extra": ""})):
            continue
        seen.add(key)
        assert key[0] in pinned, requirement
        try:
            needed = [Requirement(line) for line in requires(requirement.name) or []]
        except PackageNotFoundError:
            pytest.fail(f"{requirement.name} is a dependency but is not installed: run make setup")
        for need in needed:
            active = need.marker is None or any(need.marker.evaluate({"extra": e}) for e in extras)
            if active:
                need.marker = None
                queue.append(need)
    assert len(seen) > 50


def test_no_file_names_a_registry_or_a_path_of_one_machine(repository: Path) -> None:
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=repository,
        capture_output=True,
        text=True,
        check=False,
    )
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    # Written in pieces, so that this file does not name what it looks for.
    hosts = ["py" + "pi.org", "python" + "hosted.org", "npm" + "js.org", "deb." + "debian.org"]
    paths = ["/" + folder + "/" for folder in ("work", "root", "opt/" + "wheels", "opt/" + "pypi")]
    forbidden = re.compile("|".join(map(re.escape, [*hosts, *paths])).encode())
    files = [repository / name for name in listed.stdout.split("\0") if name]
    assert repository / "pyproject.toml" in files
    found = {
        str(file.relative_to(repository)): match.group().decode()
        for file in files
        if file.is_file() and (match := forbidden.search(file.read_bytes()))
    }
    assert not found


def test_the_public_names_are_there_and_cost_nothing_before_use(installed: Path) -> None:
    code = "import sys, pcnav\nprint([m for m in ('numpy', 'pydantic') if m in sys.modules])"
    assert run_python(code, installed).strip() == "[]"
    public = {name for name in dir(pcnav) if not name.startswith("_")}
    assert {"run", "open_recording", "make_estimator", "read_run", "evaluate"} <= public
    assert all(getattr(pcnav, name) is not None for name in public)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = pcnav.nothing
