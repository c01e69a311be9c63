"""Grid files: the cases they stand for, the seeds of the runs, and what is said of bad ones."""

import importlib.util
import itertools
import shlex
import shutil
import sys
import tomllib
from pathlib import Path

import pandas as pd
import pytest

from pcnav import cli
from pcnav.batch.axes import AXES, grid_case, scenario_of, with_axes
from pcnav.batch.grid import GridPlan, grid_runs, grid_seed, named_grid, read_grid
from pcnav.config.depth import PerceptionMode
from pcnav.config.pipeline_file import Pipeline, read_pipeline
from pcnav.config.shipped import shipped_grid_names, shipped_mesh, shipped_pipeline_names
from pcnav.core.errors import InputError
from pcnav.estimators.registry import ESTIMATORS
from pcnav.recordings.recording import RecordingKind

BATCH = '[batch]\nname = "small"\nruns = 3\nseed = 5\nframes = 8\n'
CROSS = """
[base]
satellite = "boxsat"
[[grid]]
cross = { range_m = [15, 20.5], tumble_deg_s = [1, 2, 3], estimator = ["pcnav", "kiss_icp"] }
"""
ZIP = """
[base]
estimator = "pcnav"
[[grid]]
zip = { satellite = ["boxsat", "cubesat6u"], range_m = [20, 2] }
cross = { resolution_px = [64, 128] }
[[grid]]
zip = { satellite = ["twinwing"], range_m = [25] }
cross = { resolution_px = [64] }
"""


def written(folder: Path, text: str, name: str = "grid.toml") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def grid(folder: Path, text: str) -> GridPlan:
    return read_grid(written(folder, BATCH + text))


def names(plan: GridPlan) -> list[str]:
    return [case.name for case in plan.cases]


def test_a_cross_has_every_combination_in_the_order_of_the_file(tmp_path: Path) -> None:
    plan = grid(tmp_path, CROSS)
    expected = [
        f"satellite=boxsat range_m={range_m} tumble_deg_s={rate} estimator={estimator}"
        for range_m, rate, estimator in itertools.product(
            ("15", "20.5"), ("1", "2", "3"), ("pcnav", "kiss_icp")
        )
    ]
    assert names(plan) == expected
    assert ("range_m", 15.0) in plan.cases[0].settings


def test_a_zip_goes_row_by_row_and_each_row_is_crossed(tmp_path: Path) -> None:
    rows = [
        ("boxsat", 20.0, 64),
        ("boxsat", 20.0, 128),
        ("cubesat6u", 2.0, 64),
        ("cubesat6u", 2.0, 128),
        ("twinwing", 25.0, 64),
    ]
    axes = ("satellite", "range_m", "resolution_px", "estimator")
    assert [case.settings for case in grid(tmp_path, ZIP).cases] == [
        tuple(zip(axes, (*row, "pcnav"), strict=True)) for row in rows
    ]


def test_seeds_are_those_of_scenario_and_index_alone(tmp_path: Path) -> None:
    plan = grid(tmp_path, CROSS)
    assert len(plan.runs) == 3 * len(plan.cases)
    seeds = {(run.case.name, run.index): run.seed for run in plan.runs}

    turned = CROSS.replace("[15, 20.5]", "[20.5, 15]").replace(
        '["pcnav", "kiss_icp"]', '["small_gicp", "kiss_icp"]'
    )
    other = grid(tmp_path, turned)
    shared = [run for run in other.runs if (run.case.name, run.index) in seeds]
    assert len(shared) == len(plan.runs) // 2
    assert all(run.seed == seeds[run.case.name, run.index] for run in shared)

    by_scenario: dict[tuple[str, int], set[int]] = {}
    for run in (*plan.runs, *other.runs):
        by_scenario.setdefault((scenario_of(run.case), run.index), set()).add(run.seed)
    assert len(by_scenario) == 6 * 3
    assert all(len(found) == 1 for found in by_scenario.values())
    assert len(set.union(*by_scenario.values())) == 6 * 3


def test_a_seed_depends_on_the_batch_not_on_the_order_of_axes() -> None:
    case = grid_case((("range_m", 10.0), ("satellite", "boxsat"), ("estimator", "pcnav")))
    turned = grid_case((("estimator", "kiss_icp"), ("satellite", "boxsat"), ("range_m", 10)))
    assert grid_seed(1, case, 0) == grid_seed(1, turned, 0)
    assert len({grid_seed(seed, case, index) for seed in (0, 1) for index in (0, 1)}) == 4
    # The same on every machine and in every version: results of a batch can be added to.
    assert grid_seed(1, case, 0) == 58248975


def test_keys_are_unique_and_name_files() -> None:
    pairs = itertools.product((15.0, 20.5), ("pcnav", "kiss_icp"))
    cases = [grid_case((("range_m", range_m), ("estimator", name))) for range_m, name in pairs]
    runs = grid_runs(cases, 3, seed=5)
    keys = {run.key for run in runs}
    assert len(keys) == len(runs)
    assert all(set(key) <= set("abcdefghijklmnopqrstuvwxyz0123456789.-") for key in keys)
    assert runs[0].key.startswith("15-pcnav-")
    long = grid_runs([grid_case((("satellite", "/a/b" * 80 + ".obj"),))], 1, 0)
    assert len(long[0].key) < 90
    close = grid_runs([grid_case((("range_m", value),)) for value in (0.1, 0.1 + 1e-9)], 1, 0)
    assert close[0].key != close[1].key


def test_the_printed_command_finds_the_run_again(tmp_path: Path) -> None:
    plan = grid(tmp_path, CROSS)
    run = plan.runs[7]
    words = shlex.split(plan.basis.command(run))
    assert words[:2] == ["pcnav", "table"]
    again = named_grid(words[2])
    options = dict(zip(words[3::2], words[4::2], strict=True))
    assert again.run_named(options["--case"], int(options["--run"])) == run


def test_part_of_a_name_is_enough_where_only_one_case_has_it(tmp_path: Path) -> None:
    plan = grid(tmp_path, CROSS)
    found = plan.run_named("estimator=pcnav tumble_deg_s=2 range_m=15", 2)
    assert (found.case, found.index) == (plan.cases[2], 2)
    for case, index, told in (
        ("range_m=15", 0, "6 cases fit"),
        ("range_m=16", 0, "no case fits"),
        ("range_m=1", 0, "no case fits"),
        (plan.cases[0].name, 3, "expected a number from 0 to 2"),
        (plan.cases[0].name, -1, "expected a number from 0 to 2"),
    ):
        with pytest.raises(InputError, match=told):
            plan.run_named(case, index)


def changed(pipeline: Pipeline, *values: tuple[str, str | float | int]) -> Pipeline:
    return with_axes(pipeline, grid_case(values), "grid.toml")


def test_every_axis_reaches_the_pipeline_and_nothing_else() -> None:
    base = Pipeline()
    values: dict[str, tuple[str, str | float | int]] = {
        "frame_rate_hz": ("scenario.frame_rate_hz", 4.0),
        "range_sigma_m": ("noise.range_sigma_m", 0.3),
        "dropout_share": ("noise.dropout_fraction", 0.3),
        "outlier_share": ("noise.outlier_fraction", 0.3),
        "mixed_pixel_share": ("noise.mixed_pixel_fraction", 0.3),
        "false_return_share": ("noise.false_return_fraction", 0.3),
        "footprint": ("noise.footprint", "half"),
        "stamp_jitter_s": ("noise.stamp_jitter_s", 0.02),
        "background": ("background.kind", "wall"),
        "occluder": ("occluder.kind", "arm"),
        "occluded_share": ("occluder.share_fraction", 0.3),
        "motion": ("motion.kind", "hand"),
        "first_pose": ("scenario.states_first_pose", True),
        "features.count": ("features.count", 5),
        "perception.mode": ("perception.mode", "paper"),
    }
    for axis, (place, value) in values.items():
        table, key = place.split(".")
        expected = base.model_dump()
        expected[table][key] = value
        assert changed(base, (axis, value)).model_dump() == expected
    wide = base.model_copy(
        update={"camera": base.camera.model_copy(update={"width_px": 320, "height_px": 240})}
    )
    camera = changed(wide, ("resolution_px", 100)).camera
    assert (camera.width_px, camera.height_px, camera.horizontal_fov_deg) == (100, 75, 25.0)
    # These decide what is drawn or who looks at it; see tests/batch/test_depth_run.py.
    elsewhere = {"satellite", "range_m", "tumble_deg_s", "estimator"}
    several = {"resolution_px", "frame_offset_sigma", "range_noise_growth", "distortion_k1"}
    assert set(AXES) == set(list(values)[:-2]) | several | elsewhere
    assert changed(base, *((axis, 3.0) for axis in ("range_m", "tumble_deg_s"))) == base


def test_axes_of_several_keys() -> None:
    base = Pipeline()
    noise = changed(base, ("frame_offset_sigma", 5.0), ("range_sigma_m", 0.1)).noise
    assert noise.frame_offset_sd_m == pytest.approx(0.5)
    for growth in ("constant", "linear", "quadratic"):
        noise = changed(base, ("range_noise_growth", growth), ("range_m", 12.0)).noise
        assert noise.sigma_at(12.0) == pytest.approx(0.02)
        power = {"constant": 0, "linear": 1, "quadratic": 2}[growth]
        assert noise.sigma_at(36.0) == pytest.approx(0.02 * 3.0**power)
    camera = changed(base, ("distortion_k1", -0.1)).camera
    assert camera.distortion == (-0.1, 0.0, 0.0, 0.0)
    assert camera.pinhole.distortion is not None


def test_a_word_that_an_axis_does_not_know_is_refused() -> None:
    for axis, word in (("background", "sea"), ("motion", "walk"), ("first_pose", "yes")):
        with pytest.raises(ValueError, match="got"):
            AXES[axis].value_of(word)
    assert AXES["background"].value_of("wall") == "wall"
    assert AXES["first_pose"].value_of(True) is True


def test_any_key_of_a_pipeline_is_an_axis(tmp_path: Path) -> None:
    plan = grid(
        tmp_path,
        '[base]\nsatellite = "boxsat"\n"filter.gate_probability" = 0.99\n'
        '[[grid]]\ncross = { perception.mode = ["paper"], range_m = [15, 20], '
        'noise.quantisation_m = [0.001, 0.01], estimator = ["pcnav"] }',
    )
    assert names(plan)[1] == (
        "satellite=boxsat range_m=15 estimator=pcnav filter.gate_probability=0.99 "
        "perception.mode=paper noise.quantisation_m=0.01"
    )
    pipeline = plan.basis.pipeline_of(plan.cases[1])
    assert pipeline.perception.mode is PerceptionMode.PAPER
    assert (pipeline.noise.quantisation_m, pipeline.filter.gate_probability) == (0.01, 0.99)
    assert read_grid(written(tmp_path, plan.to_toml(), "as_run.toml")).cases == plan.cases


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
    assert shipped_grid_names() == ("abroad", "accuracy")
    assert "accuracy" not in shipped_pipeline_names()
    path = named_grid("accuracy").basis.folder / "accuracy.toml"
    with pytest.raises(InputError, match=r"accuracy\.toml: batch: expected a pipeline; this is a"):
        read_pipeline(path)


@pytest.mark.parametrize(
    "command", [["simulate", "accuracy"], ["run", "S", "--pipeline", "accuracy"]]
)
def test_commands_for_pipelines_refuse_a_grid_in_one_line(
    tmp_path: Path,
    command: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["pcnav", *command, "-o", str(tmp_path / "out")])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert "this is a grid of cases, which is for `pcnav table`" in lines[0]
    assert not (tmp_path / "out").exists()


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
    with pytest.raises(InputError, match="expected the extra `bench` to be installed"):
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
