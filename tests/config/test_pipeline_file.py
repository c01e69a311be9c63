"""The pipeline file: what it may say and how it refuses the rest, in one line."""

import tomllib
from pathlib import Path

import pytest
import tomli_w
from pydantic import BaseModel, ValidationError

from pcnav.config.depth import Measurements, PerceptionMode, PerceptionTable
from pcnav.config.pipeline_file import EstimatorKind, EstimatorTable, Pipeline, read_pipeline
from pcnav.config.scenario import OrbitModel
from pcnav.config.sensors import CameraTable
from pcnav.config.table import Table
from pcnav.core.errors import InputError


def refusal(folder: Path, text: str) -> InputError:
    """What `read_pipeline` says of a file with this text."""
    path = folder / "p.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_pipeline(path)
    assert caught.value.file == path
    assert "\n" not in str(caught.value)
    return caught.value


def test_an_empty_file_gives_the_defaults(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text("", encoding="utf-8")
    assert read_pipeline(path) == Pipeline()


def test_what_a_file_says_replaces_the_default_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_text(
        'seed = 4\n[orbit]\nmodel = "two_body"\nr_hill_m = [1, 2.5, -3]\n'
        '[perception]\nmode = "paper"\n',
        encoding="utf-8",
    )
    pipeline = read_pipeline(path)
    assert pipeline.seed == 4
    assert pipeline.orbit.model is OrbitModel.TWO_BODY
    assert pipeline.orbit.r_hill_m == (1.0, 2.5, -3.0)
    assert pipeline.perception.mode is PerceptionMode.PAPER
    default = Pipeline()
    assert pipeline.orbit.v_hill_m_s == default.orbit.v_hill_m_s
    assert pipeline.filter == default.filter


@pytest.mark.parametrize(
    ("text", "field", "word"),
    [
        ("[noise]\nrange_sigma = 0.1\n", "noise.range_sigma", "did you mean range_sigma_m?"),
        ("[filter]\nransac_success_probability = 1\n", "filter", "expected in [perception]"),
        ("[orbit]\nzzz = 1\n", "orbit.zzz", "expected one of model, mean_motion_rad_s"),
        ("[nose]\n", "nose", "did you mean noise?"),
        ("seed = -1\n", "seed", "-1"),
        ("[noise]\nrange_sigma_m = -0.1\n", "noise.range_sigma_m", "-0.1"),
        ("[noise]\ndropout_fraction = 1.5\n", "noise.dropout_fraction", "1.5"),
        ("[noise]\nquantisation_m = 0.0\n", "noise.quantisation_m", "greater than 0"),
        ("[noise]\nrange_sigma_m = nan\n", "noise.range_sigma_m", "finite"),
        ("[orbit]\nr_hill_m = [1.0, 2.0]\n", "orbit.r_hill_m", "missing"),
        ("[orbit]\nr_hill_m = [1.0, 2.0, inf]\n", "orbit.r_hill_m.2", "finite"),
        ('[orbit]\nmodel = "keplerian"\n', "orbit.model", "hill"),
        ("[camera]\nhorizontal_fov_deg = 170.0\n", "camera.horizontal_fov_deg", "170"),
        ('[camera]\nwidth_px = "wide"\n', "camera.width_px", "wide"),
        ("[filter]\niterations = 0\n", "filter.iterations", "1"),
        ("[filter]\ngate_probability = 1.0\n", "filter.gate_probability", "less than 1"),
        ("[perception]\nminimum_plane_points = 9\n", "perception.minimum_plane_points", "10"),
        ('[perception]\nmeasurements = "planes"\n', "perception.measurements", "refined"),
        ("scenario = 3\n", "scenario", "3"),
        ("[body]\ninertia_ratios = [1.0, 2.5, 0, 0, 0]\n", "body.inertia_ratios", "physical"),
        ("[body]\ninertia_ratios = [1.0, 1.0, 1.2, 0, 0]\n", "body.inertia_ratios", "physical"),
        ("[camera]\nboresight_hill = [0, 0, 0]\n", "camera.boresight_hill", "a direction"),
        ("[camera]\nboresight_hill = [1, 0, 1e308]\n", "camera.boresight_hill", "a magnitude"),
        ("[camera]\nheight_px = 9223372036854775808\n", "camera.height_px", "16384"),
        ("[stereo]\nboresight_hill = [0, 0, 0]\n", "stereo.boresight_hill", "a direction"),
        ("seed = \n", "file", "valid TOML"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, field: str, word: str) -> None:
    error = refusal(tmp_path, text)
    # Pydantic appends how it read a tuple's entry; what matters is where it points.
    assert error.field.startswith(field)
    assert word in str(error)


@pytest.mark.parametrize(
    ("text", "measured_by"),
    [
        ("", Measurements.REFINED),
        ('measurements = "refined"', Measurements.REFINED),
        ('measurements = "both"', Measurements.BOTH),
        ('measurements = "rectangles"', Measurements.RECTANGLES),
        ('mode = "paper"', Measurements.RECTANGLES),
        ('mode = "paper"\nmeasurements = "rectangles"', Measurements.RECTANGLES),
    ],
)
def test_frames_are_measured_by_what_the_file_says_or_its_mode_has(
    tmp_path: Path, text: str, measured_by: Measurements
) -> None:
    path = tmp_path / "p.toml"
    path.write_text(f"[perception]\n{text}\n", encoding="utf-8")
    assert read_pipeline(path).perception.measured_by is measured_by


def test_modalities_are_a_list_without_repetition(tmp_path: Path) -> None:
    path = tmp_path / "pipeline.toml"
    path.write_text('[perception]\nmodalities = ["outline"]\n', encoding="utf-8")
    assert read_pipeline(path).perception.modalities == ("outline",)
    for wrong in ("[]", '["ranges", "ranges"]', '["shadows"]'):
        path.write_text(f"[perception]\nmodalities = {wrong}\n", encoding="utf-8")
        with pytest.raises(InputError, match="modalities"):
            read_pipeline(path)


@pytest.mark.parametrize("measurements", ["refined", "both"])
def test_paper_mode_has_nothing_but_rectangles(tmp_path: Path, measurements: str) -> None:
    error = refusal(tmp_path, f'[perception]\nmode = "paper"\nmeasurements = "{measurements}"\n')
    assert error.field == "perception"
    assert 'expected measurements absent or "rectangles"' in str(error)
    with pytest.raises(ValidationError, match="rectangles only"):
        PerceptionTable(mode=PerceptionMode.PAPER, measurements=Measurements(measurements))


def test_an_absent_file_and_one_that_is_no_text(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="readable TOML"):
        read_pipeline(tmp_path / "absent.toml")
    path = tmp_path / "p.toml"
    path.write_bytes(b"seed = 1\n\xff\xfe")
    with pytest.raises(InputError, match="valid TOML"):
        read_pipeline(path)


def test_tables_cannot_be_changed() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        Pipeline().noise.range_sigma_m = 1.0  # type: ignore[misc]


def test_every_number_carries_its_unit() -> None:
    units = (
        "_m",
        "_s",
        "_hz",
        "_mrad",
        "_deg",
        "_px",
        "_rad_s",
        "_deg_s",
        "_m_s",
        "_s3",
        "_s2",
        "_m2",
    )
    bare = {  # counts, shares, directions and ratios have none
        "frames",
        "boresight_hill",
        "inertia_ratios",
        "ransac_success_probability",
        "minimum_plane_points",
        "inertia_ratio_sd",
        "gate_probability",
        "iterations",
        "eccentricity",
        "count",
        "beams",
        "rings",
        "prism_turns",
        "distortion",
        "pixel_aspect",
        "normals_body",
        "hypotheses",
        "prior",
        "attitude_xyzw",
        "max_iterations",
        "max_features",
        "max_rejections",
        "min_matches",
        "min_agreeing",
        "ambiguous_chi_square",
        "min_significance",
        "key_share",
        "rate_change",
        "window_frames",
        "degree",
        "quality",
        "pyramid_levels",
        "min_correlation",
        "sun_hill",
        "ambient",
        "texture_contrast",
        "noise_levels",
        "supersampling",
        "inertia_ratios_zz",
        "table_up_model",
        "clutter_count",
        "footprint",  # a word, whose type has the letters of int
        "footprint_rays",
        "mask_object",
        "object",
        "start",
        "every",
        "mesh_scale_sd",
        "focal_sd",
        "range_scale_sd",
    }
    checked = 0
    for table in Pipeline.model_fields.values():
        if not (isinstance(table.annotation, type) and issubclass(table.annotation, BaseModel)):
            continue
        for name, field in table.annotation.model_fields.items():
            text = str(field.annotation)
            if "float" not in text and "int" not in text:
                continue
            checked += 1
            assert name.endswith((*units, "_fraction", "_sigma")) or name in bare, name
    assert checked > 20


def test_shipped_pipelines_are_valid(repository: Path) -> None:
    paths = sorted((repository / "pipelines").glob("*.toml"))
    read = 0
    for path in paths:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        if set(table) <= set(Pipeline.model_fields):
            read_pipeline(path)
            read += 1
    assert read >= 4


def test_keys_of_the_last_release_are_read_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "old.toml"
    path.write_text("[image_motion]\nfewest_matches = 9\nfewest_sd = 3.0\nlargest_sd_deg = 5.0\n")
    with caplog.at_level("WARNING", logger="pcnav"):
        table = read_pipeline(path).image_motion
    assert (table.min_matches, table.min_significance, table.max_sd_deg) == (9, 3.0, 5.0)
    assert [record.args[:2] for record in caplog.records if isinstance(record.args, tuple)] == [
        ("fewest_matches", "min_matches"),
        ("fewest_sd", "min_significance"),
        ("largest_sd_deg", "max_sd_deg"),
    ]


def test_an_old_key_beside_its_new_name_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "both.toml"
    path.write_text("[image_motion]\nfewest_matches = 9\nmin_matches = 10\n")
    with pytest.raises(InputError, match="fewest_matches"):
        read_pipeline(path)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("a = " + "[" * 3000 + "]" * 3000, "nested"),
        ("a = " + "{a = " * 3000 + "1" + "}" * 3000, "nested"),
        (".".join(["a"] * 50_000) + " = 1", "nested"),
        ("[" + " . ".join(["a"] * 50) + "]", "nested"),
        ("seed = " + "1" * 5000, "valid TOML"),
        ("# " + "x" * 1_000_000, "1,000,000 bytes"),
    ],
)
def test_a_file_beyond_all_bounds_is_refused_in_one_line(
    tmp_path: Path, text: str, word: str
) -> None:
    error = refusal(tmp_path, text)
    assert error.field == "file"
    assert str(error).startswith(f"{error.file}: file: expected") and word in str(error)
    assert len(str(error)) < 300


def test_a_wrong_value_is_repeated_in_part_only(tmp_path: Path) -> None:
    error = refusal(tmp_path, f'[camera]\nwidth_px = "{"x" * 5000}"\n')
    assert error.field == "camera.width_px" and len(str(error)) < 300


def test_settings_may_stand_beside_the_kind(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    texts = (
        '[estimator]\nkind = "principal_axes"\narc_s = 7.0\n',
        '[estimator]\nkind = "principal_axes"\n[principal_axes]\narc_s = 7.0\n',
    )
    read = []
    for text in texts:
        path.write_text(text)
        read.append(read_pipeline(path))
    assert read[0] == read[1] and read[0].principal_axes.arc_s == 7.0
    path.write_text(tomli_w.dumps(read[0].stated(of_a_run=True)))
    assert read_pipeline(path) == read[0]
    for text, field, word in (
        (texts[0] + "[principal_axes]\narc_s = 8.0\n", "file", "arc_s stands in"),
        (texts[0].replace("arc_s", "arcs"), "principal_axes.arcs", "unknown key"),
        ("[estimator]\narc_s = 7.0\n", "estimator", "unknown key arc_s"),
    ):
        error = refusal(tmp_path, text)
        assert error.field == field and word in str(error)


def test_a_run_states_only_what_it_reads() -> None:
    pipeline = Pipeline(seed=3, estimator=EstimatorTable(kind=EstimatorKind.DEPTH))
    assert set(pipeline.stated(of_a_run=True)) == {"seed", "estimator", "perception", "filter"}
    assert set(pipeline.stated()) >= {"scenario", "noise", "principal_axes"}


def test_an_estimator_may_bring_its_own_settings(tmp_path: Path) -> None:
    class Own(Table):
        window: int = 3

    path = tmp_path / "p.toml"
    path.write_text('[estimator]\nkind = "momentum"\nwindow = 5\n[stereo]\nbaseline_m = 2.0\n')
    pipeline = read_pipeline(path)
    assert pipeline.estimator.settings(Own).window == 5
    assert pipeline.stated(of_a_run=True)["estimator"] == {"kind": "momentum", "window": 5}
    path.write_text('[estimator]\nkind = "momentum"\nwindows = 5\n')
    with pytest.raises(InputError, match=r"estimator\.windows: unknown key"):
        read_pipeline(path).estimator.settings(Own, path)


def test_a_pipeline_shows_what_differs_from_the_defaults() -> None:
    shown = repr(Pipeline(seed=3, camera=CameraTable(width_px=64)))
    assert shown == "Pipeline(seed=3, camera=CameraTable(width_px=64))"
    assert repr(Pipeline()) == "Pipeline()"
