"""What every test may rely on: no display, reproducible examples, the shared recordings."""

import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from pcnav import cli
from pcnav.core.camera import PinholeCamera
from pcnav.target.satellite import Target, load_target
from tests.commands import Answer, Pcnav

# Read by matplotlib when it is first imported, which is after this file.
os.environ["MPLBACKEND"] = "Agg"

# A deadline fails on a busy machine, not on a fault. Continuous integration draws the same examples
# every time, so that a red run is about the change; at a desk new examples keep being tried.
settings.register_profile("desk", deadline=None)
settings.register_profile("ci", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "desk")

_REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def repository() -> Path:
    """Root of the checkout the tests belong to."""
    return _REPOSITORY


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of recordings and meshes that are not part of the project; skips where it is absent.

    It is looked for beside the checkout, or where the variable PCNAV_SHARED says.
    """
    shared = os.environ.get("PCNAV_SHARED")
    data = (Path(shared) if shared else _REPOSITORY.parent / "shared") / "data"
    if not data.is_dir():
        pytest.skip(f"shared recordings are absent: no folder {data.name} in {data.parent.name}")
    return data


@pytest.fixture
def quick_drawings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports without pictures, which take most of a test's time, where it is not about them."""
    monkeypatch.setattr("pcnav.report.figures.svg_bytes", lambda figure: b"")


@pytest.fixture
def pcnav(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Pcnav]:
    """Call the entry point with arguments, in this process."""
    before = signal.getsignal(signal.SIGTERM)

    def call(*arguments: str | Path) -> Answer:
        capsys.readouterr()
        monkeypatch.setattr(sys, "argv", ["pcnav", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            cli.main()
        out, err = capsys.readouterr()
        return Answer(int(ended.value.code or 0), out, err)

    yield call
    signal.signal(signal.SIGTERM, before)


@pytest.fixture(scope="session")
def camera() -> PinholeCamera:
    """256 x 256 pixels, 25 degrees."""
    return PinholeCamera.from_field_of_view(256, 256, np.deg2rad(25.0))


@pytest.fixture(scope="session")
def boxsat() -> Target:
    """The shipped satellite without symmetry."""
    return load_target(_REPOSITORY / "meshes" / "boxsat.obj")


@pytest.fixture(scope="session")
def twinwing() -> Target:
    """The shipped satellite that half a turn maps onto itself."""
    return load_target(_REPOSITORY / "meshes" / "twinwing.obj")
