"""Fixtures that several files of these tests share."""

import re
import shutil
import sys
from pathlib import Path

import pytest

from pcnav import cli
from tests.cli.answers import PIPELINE, satellite


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six frames of the shipped satellite and a result made of them: sequence/ and result/."""
    folder = tmp_path_factory.mktemp("recorded")
    (folder / "six.toml").write_text(PIPELINE)
    sequence = folder / "sequence"
    for arguments in (
        ("simulate", folder / "six.toml", "-o", sequence),
        ("run", sequence, "-o", folder / "result"),
    ):
        with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as ended:
            # Nothing here looks at the pictures of its report, which take most of the time.
            patch.setattr("pcnav.report.figures.svg_bytes", lambda figure: b"")
            patch.setattr(sys, "argv", ["pcnav", *map(str, arguments)])
            cli.main()
        assert not ended.value.code
    # A copy of the sequence may lie anywhere.
    words = (sequence / "sequence.toml").read_text()
    mesh = f'target_mesh = "{satellite("boxsat").as_posix()}"'
    (sequence / "sequence.toml").write_text(re.sub('target_mesh = ".*"', mesh, words))
    return folder


@pytest.fixture
def sequence(recorded: Path, tmp_path: Path) -> Path:
    """A copy of the sequence to break."""
    copy = tmp_path / "sequence"
    shutil.copytree(recorded / "sequence", copy)
    return copy
