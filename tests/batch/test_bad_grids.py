"""What is said of grid files that are wrong."""

from pathlib import Path

import pytest

from pcnav.batch.grid import named_grid, read_grid
from pcnav.config.pipeline_file import read_pipeline
from pcnav.config.shipped import shipped_grid_names, shipped_pipeline_names
from pcnav.core.errors import InputError
from tests.batch.grid_files import BATCH, CROSS, grid, written
from tests.commands import Pcnav

BAD = {
    "an unknown axis": (
        '[[grid]]\ncross = { distance = [1], estimator = ["pcnav"] }',
        "grid.1.cross.distance: unknown axis; expected one of satellite, range_m",
    ),
    "an unknown axis in base": ("[base]\nsize = 3\n[[grid]]\n", "base.size: unknown axis"),
    "an empty axis": (
        '[[grid]]\ncross = { range_m = [], estimator = ["pcnav"] }',
        "grid.1.cross.range_m: expected a list of values, got an empty one",
    ),
    "an empty block": ("[[grid]]\n", "grid.1: expected an axis in cross or zip"),
    "no block": ("[base]\nrange_m = 3\n", "grid: missing"),
    "a value instead of a list": (
        '[[grid]]\ncross = { range_m = 3, estimator = ["pcnav"] }',
        "grid.1.cross.range_m: expected a list of values, got 3",
    ),
    "a list in base": (
        "[base]\nrange_m = [3]\n[[grid]]\n",
        "base.range_m: Input should be a valid number, got [3]",
    ),
    "a word for a number": (
        '[[grid]]\ncross = { range_m = [3, "far"], estimator = ["pcnav"] }',
        "grid.1.cross.range_m: Input should be a valid number, got 'far'",
    ),
    "true for a number": (
        '[[grid]]\ncross = { range_sigma_m = [true], estimator = ["pcnav"] }',
        "grid.1.cross.range_sigma_m: Input should be a valid number, got True",
    ),
    "a number out of range": (
        '[[grid]]\ncross = { dropout_share = [1.5], estimator = ["pcnav"] }',
        "grid.1.cross.dropout_share: Input should be less than or equal to 1, got 1.5",
    ),
    "infinity": (
        '[[grid]]\ncross = { range_m = [inf], estimator = ["pcnav"] }',
        "grid.1.cross.range_m: Input should be a finite number, got inf",
    ),
    "half a pixel": (
        '[[grid]]\ncross = { resolution_px = [64.5], estimator = ["pcnav"] }',
        "grid.1.cross.resolution_px: Input should be a valid integer, got 64.5",
    ),
    "a number for a word": (
        '[[grid]]\ncross = { satellite = [3], estimator = ["pcnav"] }',
        "grid.1.cross.satellite: Input should be a valid string, got 3",
    ),
    "an unknown estimator": (
        '[[grid]]\ncross = { estimator = ["pcnav", "icp"] }',
        "grid.1.cross.estimator: expected some of depth, pcnav, pcnav_rectangles",
    ),
    "a key that no pipeline has": (
        '[[grid]]\ncross = { noise.loudness = [1], estimator = ["pcnav"] }',
        "grid.1.cross.noise.loudness: unknown axis; expected one of satellite, range_m",
    ),
    "a value that the key cannot have": (
        '[[grid]]\ncross = { "features.count" = [5, 0], estimator = ["pcnav"] }',
        "grid.1.cross.features.count: Input should be greater than 0, got 0",
    ),
    "a key that holds no single value": (
        '[[grid]]\ncross = { orbit.r_hill_m = [[1, 2, 3]], estimator = ["pcnav"] }',
        "grid.1.cross.orbit.r_hill_m: expected a number or a word, got [1, 2, 3]",
    ),
    "no estimator": (
        "[[grid]]\ncross = { range_m = [20] }",
        "grid.1.estimator: expected this axis in the block or in [base]",
    ),
    "an axis in one block only": (
        '[[grid]]\ncross = { estimator = ["pcnav"] }\n'
        '[[grid]]\ncross = { range_m = [3], estimator = ["kiss_icp"] }',
        "grid.1.range_m: expected this axis in the block or in [base]",
    ),
    "lists of different lengths": (
        '[[grid]]\nzip = { range_m = [3, 4], estimator = ["pcnav"] }',
        "grid.1.zip: expected lists of one length, range_m has 2, estimator has 1",
    ),
    "an axis twice": (
        '[[grid]]\nzip = { range_m = [3] }\ncross = { range_m = [4], estimator = ["pcnav"] }',
        "grid.1.zip.range_m: expected an axis once",
    ),
    "a case twice in a block": (
        '[base]\nsatellite = "boxsat"\n'
        '[[grid]]\ncross = { range_m = [3, 3.0], estimator = ["pcnav"] }',
        "grid.1: expected no case twice: satellite=boxsat range_m=3 estimator=pcnav is in grid.1",
    ),
    "a case in two blocks": (
        '[base]\nestimator = "pcnav"\n[[grid]]\ncross = { range_m = [3, 4] }\n'
        "[[grid]]\ncross = { range_m = [5, 4] }",
        "grid.2: expected no case twice: range_m=4 estimator=pcnav is in grid.1 too",
    ),
    "an unknown key of a block": ("[[grid]]\nproduct = { range_m = [3] }", "unknown key"),
    "neither pipeline nor satellite": (
        '[[grid]]\ncross = { estimator = ["pcnav"] }',
        "batch.pipeline: expected a pipeline, or the axis satellite",
    ),
}


@pytest.mark.parametrize("fault", BAD)
def test_a_bad_grid_is_one_line_with_file_and_field(tmp_path: Path, fault: str) -> None:
    text, told = BAD[fault]
    with pytest.raises(InputError) as caught:
        grid(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'grid.toml'}: ")
    assert told in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("frames = 8\n", "batch: expected frames or duration_s, one of them"),
        ("runs = 3\n", "batch.runs: missing"),
        ("[batch]\n", "batch: expected a grid of cases with this table"),
        ('name = "small"\n', "batch.name: missing"),
    ],
)
def test_the_batch_table_is_checked(tmp_path: Path, change: str, told: str) -> None:
    with pytest.raises(InputError, match=r"grid\.toml") as caught:
        read_grid(written(tmp_path, BATCH.replace(change, "") + CROSS))
    assert told in str(caught.value)
    for wrong in ("runs = 0", "seed = -1", "frames = 1", "duration_s = 3.0", "length = 3"):
        key = wrong.split()[0]
        lines = [line for line in BATCH.splitlines() if not line.startswith(key)]
        with pytest.raises(InputError, match="batch"):
            read_grid(written(tmp_path, "\n".join([*lines, wrong, CROSS])))


def test_files_that_cannot_be_read_are_named(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"none.toml: grid: expected a TOML file or one of: abroad, acc"
    ):
        named_grid(str(tmp_path / "none.toml"))
    with pytest.raises(InputError, match=r"grid.toml: file: expected valid TOML"):
        read_grid(written(tmp_path, "[batch\n"))
    with pytest.raises(InputError, match=r"batch.pipeline: expected a file or one of .*, got mine"):
        grid(tmp_path, 'pipeline = "mine"\n' + CROSS)


def test_a_pipeline_is_no_grid_and_a_grid_no_pipeline() -> None:
    with pytest.raises(InputError, match=r"boxsat\.toml: batch: expected a grid of cases"):
        named_grid("boxsat")
    assert shipped_grid_names() == ("abroad", "accuracy", "scan_accuracy")
    assert "accuracy" not in shipped_pipeline_names()
    path = named_grid("accuracy").basis.folder / "accuracy.toml"
    with pytest.raises(InputError, match=r"accuracy\.toml: batch: expected a pipeline; this is a"):
        read_pipeline(path)


@pytest.mark.parametrize(
    "command", [["simulate", "accuracy"], ["run", "S", "--pipeline", "accuracy"]]
)
def test_commands_for_pipelines_refuse_a_grid_in_one_line(
    pcnav: Pcnav, tmp_path: Path, command: list[str]
) -> None:
    answer = pcnav(*command, "-o", tmp_path / "out")
    assert answer.code == 2
    (line,) = answer.err.splitlines()
    assert "this is a grid of cases, which is for `pcnav table`" in line
    assert not (tmp_path / "out").exists()
