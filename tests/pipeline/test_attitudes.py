"""Runs on attitudes, recorded or from images of one camera: the result folder and its report."""

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcnav.config.pipeline_file import EstimatorKind, EstimatorTable, Pipeline
from pcnav.config.scenario import ScenarioTable
from pcnav.config.shipped import shipped_pipeline
from pcnav.core.errors import InputError
from pcnav.evaluation.observability.sources import observability_of_pipeline, observability_of_run
from pcnav.pipeline import run
from pcnav.recordings.attitudes import read_attitudes, write_attitudes
from pcnav.recordings.recording import RecordingKind
from pcnav.simulation.simulate import simulate
from tests.pipeline.made import Made, shipped


@pytest.fixture(scope="module")
def recording(made_of: Callable[[str], Made]) -> Path:
    return made_of("attitude_inertia").recording


@pytest.fixture(scope="module")
def result(made_of: Callable[[str], Made]) -> Path:
    return made_of("attitude_inertia").result


@pytest.fixture(scope="module")
def depth_result(made_of: Callable[[str], Made]) -> Path:
    return made_of("depth").result


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_inertia_ratios_follow_from_recorded_attitudes(recording: Path, result: Path) -> None:
    last, true = _rows(result / "states.csv")[-1], _rows(recording / "truth.csv")[-1]
    for name in ("i_yy", "i_zz", "i_xy", "i_xz", "i_yz"):
        error, sd = float(last[name]) - float(true[name]), float(last[f"sd_{name}"])
        assert sd < 0.02
        assert abs(error) < 4.0 * sd
    metrics = json.loads((result / "metrics.json").read_text())
    assert metrics["nis"]["mean_per_degree_of_freedom"] == pytest.approx(1.0, abs=0.15)
    # An attitude has three degrees of freedom: so many innovations, and one of the first is none.
    assert metrics["nis"]["degrees_of_freedom"] == 3 * metrics["nis"]["frames"] == 3 * 160
    rows = _rows(result / "states.csv")
    assert {(bool(row["nis"]), row["nis_dof"]) for row in rows} == {(False, "0"), (True, "3")}


@pytest.mark.usefixtures("undrawn")
def test_states_of_a_depth_run_are_attitudes_too(depth_result: Path, tmp_path: Path) -> None:
    states = depth_result / "states.csv"
    known = [bool(row["q_w"]) for row in _rows(states)]
    assert not known[0] and known[-1]
    recording = read_attitudes(states)
    assert recording.has_attitude.tolist() == known
    # Their errors belong together, which the table does not say: the attitude is taken as it is.
    attitude_only = Pipeline(estimator=EstimatorTable(kind=EstimatorKind.ATTITUDE_INERTIA))
    run(states, tmp_path / "result", attitude_only)
    rows = _rows(tmp_path / "result" / "states.csv")
    assert [row["status"] == "acquiring" for row in rows] == [not each for each in known]
    depth = _rows(states)[-1]
    angle = Rotation.from_quat([float(depth[f"q_{x}"]) for x in "xyzw"]).inv() * Rotation.from_quat(
        [float(rows[-1][f"q_{x}"]) for x in "xyzw"]
    )
    assert np.degrees(angle.magnitude()) < 0.2


@pytest.mark.study
def test_images_of_one_camera_give_inertia(tmp_path: Path) -> None:
    kind = EstimatorTable(kind=EstimatorKind.ATTITUDE_INERTIA)
    pipeline = shipped("applsci2022", 61, estimator=kind)
    # A frame every five seconds: five minutes.
    pipeline = pipeline.model_copy(update={"scenario": ScenarioTable(frames=61, frame_rate_hz=0.2)})
    simulate(pipeline, kind=RecordingKind.IMAGES).write(tmp_path / "tracks")
    run(tmp_path / "tracks", tmp_path / "result", pipeline)
    metrics = json.loads((tmp_path / "result" / "metrics.json").read_text())
    assert metrics["errors"]["inertia_ratios"]["last_third"]["rms"] < 0.05
    assert metrics["nees"]["omega_body"]["mean_per_degree_of_freedom"] < 2.0
    page = (tmp_path / "result" / "report.html").read_text()
    assert "Attitudes come from the images" in page
    assert "Observability of this motion" in page
    report = observability_of_run(tmp_path / "result")
    assert report.estimator.startswith("image_motion")


def test_observability_of_the_pipeline_is_that_of_its_run(result: Path) -> None:
    path = shipped_pipeline("deng2024")
    assert path is not None
    promised = observability_of_pipeline(shipped("deng2024", 161), path)
    found = observability_of_run(result)
    assert promised.rank.rank == found.rank.rank == 11
    ratio = promised.predicted_sd[-1] / found.predicted_sd[-1]
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)


@pytest.mark.study
@pytest.mark.usefixtures("undrawn")
def test_a_gap_is_coasted_through(recording: Path, tmp_path: Path) -> None:
    seen = read_attitudes(recording)
    write_attitudes(tmp_path / "gap", seen)
    lines = (tmp_path / "gap" / "attitudes.csv").read_text().splitlines()
    for k in range(121, 151):
        lines[k] = lines[k].split(",")[0] + ",,,,"
    (tmp_path / "gap" / "attitudes.csv").write_text("\n".join(lines) + "\n")
    run(tmp_path / "gap", tmp_path / "result", shipped("deng2024", 161))
    rows = _rows(tmp_path / "result" / "states.csv")
    assert [row["status"] for row in rows[118:153]] == (
        ["locked"] * 2 + ["coasting"] * 30 + ["locked"] * 3
    )
    sd = [float(row["sd_theta_x_rad"]) for row in rows]
    assert sd[149] > sd[119]
    attitude = Rotation.from_quat([float(rows[149][f"q_{x}"]) for x in "xyzw"])
    off = Rotation.from_matrix(seen.R_world_body[149]).inv() * attitude
    assert np.degrees(off.magnitude()) < 4.0


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda text: text.replace("q_w", "w"), "expected a column q_w"),
        (lambda text: text.replace("\n0.5,0.", "\n0.5,7.", 1), "unit quaternion"),
        (lambda text: text.replace("\n0.5,", "\n0.0,", 1), "times that increase"),
        (lambda text: text.splitlines()[0] + "\n", "at least one row"),
    ],
)
def test_a_damaged_table_is_named(recording: Path, tmp_path: Path, change, told: str) -> None:
    table = tmp_path / "attitudes.csv"
    table.write_text(change((recording / "attitudes.csv").read_text()))
    with pytest.raises(InputError, match=told) as raised:
        run(table, tmp_path / "result", shipped("deng2024", 161))
    assert "attitudes.csv" in str(raised.value)
    assert not (tmp_path / "result").exists()
