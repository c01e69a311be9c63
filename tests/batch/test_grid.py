"""Grid files: the cases they stand for, and the seeds of the runs."""

import itertools
import shlex
from pathlib import Path

import pytest

from pcnav.batch.axes import AXES, grid_case, scenario_of, with_axes
from pcnav.batch.grid import GridPlan, grid_runs, grid_seed, named_grid, read_grid
from pcnav.config.depth import PerceptionMode
from pcnav.config.pipeline_file import Pipeline
from pcnav.core.errors import InputError
from tests.batch.grid_files import CROSS, grid, written

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
