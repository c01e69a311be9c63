"""Every kind of run is made once."""

from collections.abc import Callable

import pytest

from tests.pipeline.made import Made, make


@pytest.fixture(scope="session")
def made_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Made]:
    """The recording and run of a case by its name."""
    found: dict[str, Made] = {}

    def made(name: str) -> Made:
        if name not in found:
            found[name] = make(name, tmp_path_factory.mktemp(name))
        return found[name]

    return made


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves the report empty: its figures take longer than all the rest."""
    monkeypatch.setattr("pcnav.report.run_report.write_report", lambda path, _: path.write_text(""))
