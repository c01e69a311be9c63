"""Grids with files of their own, grids of other kinds of recordings, and those that are shipped."""

import importlib.util
import shutil
import sys
import tomllib
from pathlib import Path

import pandas as pd
import pytest

from pcnav.batch.axes import AXES
from pcnav.batch.grid import named_grid, read_grid
from pcnav.config.shipped import shipped_mesh
from pcnav.core.errors import InputError
from pcnav.estimators.registry import ESTIMATORS
from pcnav.recordings.recording import RecordingKind
from tests.batch.grid_files import BATCH, CROSS, grid, written

OWN = """
[base]
satellite = "mine.obj"
estimator = "pcnav"
[[grid]]
cross = { range_m = [15, 20] }
"""


@pytest.fixture
def own_files(tmp_path: Path) -> Path:
    """A grid with a mesh and a pipeline of the user's own beside it."""
    mesh = shipped_mesh("boxsat")
    assert mesh is not None
    folder = tmp_path / "own"
    folder.mkdir()
    shutil.copy(mesh, folder / "mine.obj")
    written(folder, "[camera]\nwidth_px = 80\nheight_px = 60\n", "settings.toml")
    return written(folder, BATCH + 'pipeline = "settings.toml"\n' + OWN)


def test_the_grid_as_run_reads_back_wherever_it_lies(own_files: Path, tmp_path: Path) -> None:
    plan = read_grid(own_files)
    copy = read_grid(written(tmp_path, plan.to_toml(), "as_run.toml"))
    assert copy.runs == plan.runs
    assert copy.to_toml() == plan.to_toml()
    assert copy.basis.mesh_of(copy.cases[0]) == own_files.parent / "mine.obj"
    assert copy.basis.pipeline_of(copy.cases[0]).camera.width_px == 80


def test_the_grid_as_run_changes_with_what_it_stands_on(own_files: Path) -> None:
    texts = [read_grid(own_files).to_toml()]
    written(own_files.parent, "[camera]\nwidth_px = 81\nheight_px = 60\n", "settings.toml")
    texts.append(read_grid(own_files).to_toml())
    with (own_files.parent / "mine.obj").open("a", encoding="utf-8") as file:
        file.write("# another one\n")
    texts.append(read_grid(own_files).to_toml())
    assert len(set(texts)) == 3
    shipped = named_grid("accuracy").to_toml()
    assert "folder" not in tomllib.loads(shipped)["as_run"]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("[15, 20]", "[15, 4]"), r"range_m: expected above 5.01 m \(half of mine\) up to 60.5 m"),
        (("[15, 20]", "[61, 15]"), r"up to 60.5 m \(16 bits of depth\), got 61"),
        (('"mine.obj"', '"none.obj"'), "satellite: expected a mesh file or one of boxsat"),
        (
            ('"settings.toml"', '"hu2024"'),
            "satellite: expected none: hu2024 simulates stereo_tracks, this axis is for depth",
        ),
        (('"pcnav"', '"inertia_bank"'), "estimator: expected some of depth, pcnav, .*kiss_icp for"),
        (('pipeline = "settings.toml"', ""), "satellite: expected one of .*, got mine.obj"),
        (
            ('satellite = "mine.obj"\n', ""),
            "satellite: expected this axis, as settings.toml has no",
        ),
    ],
)
def test_all_that_cases_need_is_looked_at_first(
    own_files: Path, change: tuple[str, str], told: str
) -> None:
    read_grid(own_files).check()
    text = own_files.read_text(encoding="utf-8")
    assert change[0] in text
    with pytest.raises(InputError, match=told) as caught:
        read_grid(written(own_files.parent, text.replace(*change))).check()
    assert str(own_files) in str(caught.value)


def test_other_kinds_of_recordings_take_their_own_estimators_and_keys(tmp_path: Path) -> None:
    text = (
        BATCH + 'pipeline = "applsci2022"\n[base]\nframe_rate_hz = 2.0\n'
        '[[grid]]\ncross = { features.count = [20], estimator = ["image_motion", "depth"] }'
    )
    with pytest.raises(InputError, match="expected some of image_motion, attitude_inertia for im"):
        read_grid(written(tmp_path, text)).check()
    plan = read_grid(written(tmp_path, text.replace('"depth"', '"attitude_inertia"')))
    plan.check()
    assert plan.basis.kind_of(plan.cases[0]) == "images"
    assert plan.basis.pipeline_of(plan.cases[0]).scenario.frame_rate_hz == 2.0
    assert tomllib.loads(plan.to_toml())["as_run"]["meshes_sha256"] == {}


def test_a_missing_extra_is_said_before_anything_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan = grid(tmp_path, CROSS.replace("kiss_icp", "small_gicp"))
    # What Python does for a module that is set to None.
    monkeypatch.setitem(sys.modules, "small_gicp", None)
    with pytest.raises(InputError, match="expected the extra `peers` to be installed"):
        plan.check()
    grid(tmp_path, CROSS).check()


def test_the_shipped_grid_is_large_enough_and_has_every_estimator() -> None:
    plan = named_grid("accuracy")
    assert len(plan.cases) >= 48
    assert plan.file.batch.runs >= 5
    values = pd.DataFrame([dict(case.settings) for case in plan.cases])
    on_depth = {key for key, each in ESTIMATORS.items() if RecordingKind.DEPTH in each.takes}
    # The tracker is called pcnav in a grid: its measurements are then those of its name.
    assert set(values["estimator"]) == on_depth - {"depth"}
    assert set(values["satellite"]) == {"boxsat", "twinwing", "cubesat6u"}
    assert set(values) < set(AXES) and (values.nunique() > 1).all()
    if importlib.util.find_spec("small_gicp") is not None:
        plan.check()


def test_the_shipped_grids_together_use_every_axis() -> None:
    used = set[str]()
    for name in ("accuracy", "abroad"):
        values = pd.DataFrame([dict(case.settings) for case in named_grid(name).cases])
        used |= set(values.columns[values.nunique() > 1])
    assert used == set(AXES)
    named_grid("abroad").check()
