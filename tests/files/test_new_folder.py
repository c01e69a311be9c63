"""A folder is whole or not there, and nobody loses another one for it."""

from pathlib import Path

import pytest

from pcnav.core.errors import InputError
from pcnav.files.new_folder import new_folder


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_folder_that_somebody_makes_meanwhile_stays(tmp_path: Path, overwrite: bool) -> None:
    out = tmp_path / "run"
    with (
        pytest.raises(InputError, match="overwrite"),
        new_folder(out, overwrite, "states.csv") as staging,
    ):
        (staging / "states.csv").write_text("ours")
        out.mkdir()
        (out / "thesis.tex").write_text("theirs")
    assert (out / "thesis.tex").read_text() == "theirs"
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
