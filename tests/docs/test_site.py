"""The documentation site: what is on it, and that its pages say what the code says."""

import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

from pcnav.cli import app
from pcnav.config.pipeline_file import Pipeline
from pcnav.estimators.registry import ESTIMATORS
from pcnav.files.toml_file import tables_of

TOCTREE = re.compile(r"^```\{toctree\}\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INCLUDED = re.compile(r"^```\{literalinclude\} (\S+)$", re.MULTILINE)
LINK = re.compile(r"\]\(([^)\s]+)\)")


def pages(docs: Path) -> dict[str, str]:
    """The text of every page by its name."""
    found = sorted(docs.rglob("*.md"))
    return {str(path.relative_to(docs).with_suffix("")): path.read_text() for path in found}


@pytest.fixture
def docs(repository: Path) -> Path:
    return repository / "docs"


@pytest.fixture
def made(docs: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The extension that makes parts of pages from the code."""
    pytest.importorskip("sphinx")
    monkeypatch.syspath_prepend(str(docs / "_ext"))
    import from_the_code  # type: ignore[import-not-found]

    monkeypatch.delitem(sys.modules, "from_the_code")
    return from_the_code


def test_every_page_is_in_the_navigation(docs: Path) -> None:
    found = pages(docs)
    listed = {
        re.sub(r".*<(.*)>", r"\1", line)
        for text in found.values()
        for block in TOCTREE.findall(text)
        for line in block.splitlines()
        if line and not line.startswith(":")
    }
    assert {"start", "formats", "estimators/depth"} <= listed
    assert listed == set(found) - {"index"}


def test_every_example_stands_on_a_page(docs: Path) -> None:
    shown = {each for text in pages(docs).values() for each in INCLUDED.findall(text)}
    assert shown == {f"examples/{path.name}" for path in (docs / "examples").glob("*.py")}


def test_the_readme_shows_the_example_that_is_run(repository: Path) -> None:
    shown = (repository / "README.md").read_text().partition("```python\n")[2].partition("```")[0]
    example = (repository / "docs" / "examples" / "numpy_loop.py").read_text()
    assert example.partition('"""\n\n')[2] == shown


def test_links_of_the_readme_and_the_pages_lead_somewhere(repository: Path) -> None:
    files = [*repository.glob("*.md"), *(repository / "docs").rglob("*.md")]
    assert len(files) > 10
    for file in files:
        for link in LINK.findall(file.read_text(encoding="utf-8")):
            place = link.partition("#")[0]
            if place and "://" not in place:
                assert (file.parent / place).exists(), (file.name, link)


def test_what_the_pages_repeat_of_the_grid_is_what_its_tables_say(docs: Path) -> None:
    """The median errors of boxsat, and how often it is locked wrong."""
    grid, trust = (pages(docs)[name] for name in ("accuracy", "trust"))
    names = {
        **{"pcnav": "pcnav", "small_gicp": "small_gicp", "KISS-ICP, no model": "kiss_icp"},
        "Open3D point-to-plane ICP": "open3d_icp",
    }
    rows = [line.strip("| ").split(" | ") for line in grid.splitlines() if "| boxsat |" in line]
    by_estimator = {row[1]: row for row in rows}
    for title, key in names.items():
        (line,) = re.findall(rf"^\| {title} \| (.*) \|$", trust, re.MULTILINE)
        position, attitude, wrong, _ = line.split(" | ")
        numbers = [[float(x) for x in re.findall(r"[\d.]+", text)] for text in by_estimator[key]]
        assert [float(x) for x in re.findall(r"[\d.]+", position)] == numbers[2]
        told = [float(x) for x in re.findall(r"[\d.]+", attitude)]
        assert told == pytest.approx(numbers[4], abs=6e-5)
        assert float(wrong.removesuffix(" %")) == pytest.approx(numbers[7][0], abs=0.05)


def test_the_settings_page_has_every_key_of_every_table(docs: Path, made: ModuleType) -> None:
    page = made.made_page((docs / "settings.md").read_text(encoding="utf-8"))
    for table, model in tables_of(Pipeline).items():
        part = page.partition(f"\n## [{table}]\n")[2].partition("\n## ")[0]
        rows = {line.split("`")[1] for line in part.splitlines() if line.startswith("| `")}
        assert rows == set(model.model_fields), table
    assert "`0.9999`" in page.partition("`gate_probability`")[2].partition("\n")[0]


def test_the_pages_of_commands_and_estimators_have_all_of_them(
    docs: Path, made: ModuleType
) -> None:
    commands = made.made_page((docs / "commands.md").read_text(encoding="utf-8"))
    for command in app.registered_commands:
        assert command.callback is not None
        assert f"## pcnav {command.callback.__name__}\n" in commands
    assert "| `-o`, `--out` |" in commands
    estimators = made.made_page((docs / "estimators" / "index.md").read_text(encoding="utf-8"))
    assert all(f"| `{name}` | {entry.title} |" in estimators for name, entry in ESTIMATORS.items())
    with pytest.raises(KeyError):
        made.made_page("<!-- made: nothing of the kind -->")


def test_a_page_that_loads_from_outside_is_found(
    docs: Path, made: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    import self_contained  # type: ignore[import-not-found]

    monkeypatch.delitem(sys.modules, "self_contained")
    found = self_contained.fetched_from_outside
    for bad in (
        '<script src="https://example.org/a.js"></script>',
        "<link rel='stylesheet' href='//example.org/a.css'>",
        "@import url(https://example.org/font.css);",
        "src: url('https://example.org/font.woff2')",
        '<img alt="x" src="http://example.org/a.png">',
    ):
        assert found(bad), bad
    for good in (
        '<a href="https://example.org">there</a>',
        '<script src="_static/a.js"></script>',
        '<img src="frame.png">',
        'url("data:image/svg+xml;base64,AAAA")',
    ):
        assert not found(good), good
