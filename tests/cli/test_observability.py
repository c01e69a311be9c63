"""Observability of pipelines and of runs: what the command prints."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.config.pipeline_file import EstimatorKind, EstimatorTable, Pipeline, read_pipeline
from pcnav.config.scenario import RecordingKind, ScenarioTable
from pcnav.config.shipped import shipped_mesh, shipped_pipeline
from pcnav.core.errors import InputError
from pcnav.evaluation.observability.sources import (
    observability_of_pipeline,
    observability_of_run,
    tables_of_run,
)
from pcnav.pipeline import run
from pcnav.recordings.opening import open_recording
from pcnav.runs.reader import read_run
from pcnav.runs.result_files import PIPELINE_FILE
from pcnav.simulation.simulate import simulate


def _short(name: str, frames: int) -> tuple[Path, Pipeline]:
    path = shipped_pipeline(name)
    assert path is not None
    pipeline = read_pipeline(path)
    rate = pipeline.scenario.frame_rate_hz
    return path, pipeline.model_copy(
        update={"scenario": ScenarioTable(frames=frames, frame_rate_hz=rate)}
    )


def test_depth_pipeline_in_a_spin_and_in_a_tumble():
    mesh = shipped_mesh("boxsat")
    path, spin = _short("yu2019", 400)
    report = observability_of_pipeline(spin, path, mesh)
    assert report.rank.rank == 8
    ratios = {name for name in report.not_observable if name.startswith("I")}
    assert ratios == {"Iyy/Ixx", "Izz/Ixx", "Ixy/Ixx"}
    path, tumble = _short("demo", 100)
    report = observability_of_pipeline(tumble, path, mesh)
    assert report.not_observable == ()
    assert len(report.states) == 20
    sooner, later = (report.predicted_sd[k] for k in (0, -1))
    assert np.all(later <= sooner)


def test_attitudes_of_a_pipeline_with_a_wanted_value():
    path, pipeline = _short("demo", 200)
    estimator = EstimatorTable(kind=EstimatorKind.ATTITUDE_INERTIA)
    table = AttitudeInertiaTable(attitude_sd_deg=0.2)
    judged = pipeline.model_copy(update={"estimator": estimator, "attitude_inertia": table})
    easy, hard = (
        observability_of_pipeline(judged, path, wanted={"inertia ratios": sd})
        for sd in (0.05, 0.002)
    )
    assert easy.estimator == "attitude_inertia"
    after = [
        {reach.name: reach.after_s for reach in each.reach}["Jxx/Jzz"] for each in (easy, hard)
    ]
    assert after[0] < after[1]


@pytest.fixture(scope="module")
def bank_run(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("observability")
    _, pipeline = _short("segal2011", 40)
    simulate(pipeline).write(folder / "recording")
    run(folder / "recording", folder / "run", pipeline)
    return folder / "run"


def test_run_of_the_bank_tells_what_its_pipeline_does(bank_run):
    of_run = observability_of_run(bank_run)
    path, pipeline = _short("segal2011", 40)
    of_pipeline = observability_of_pipeline(pipeline, path)
    assert of_run.estimator == of_pipeline.estimator == "inertia_bank"
    assert of_run.frames == 39 or of_run.frames == 40
    seen, true = (
        np.array([state.posterior_sd for state in report.states])
        for report in (of_run, of_pipeline)
    )
    np.testing.assert_allclose(seen, true, rtol=0.5)
    titles = [table.title for table in of_run.tables()]
    assert titles[1:] == [
        "States after the arc",
        "Weakest directions",
        "Standard deviation against arc length",
    ]


def test_what_is_missing_is_told(bank_run, tmp_path):
    with pytest.raises(InputError, match=r"states\.csv"):
        observability_of_run(tmp_path)
    unnamed = shutil.copytree(bank_run, tmp_path / "run")
    (unnamed / PIPELINE_FILE).write_text("seed = 1\n", encoding="utf-8")
    with pytest.raises(InputError, match="sequence"):
        observability_of_run(unnamed)
    with pytest.raises(InputError, match="mesh"):
        observability_of_pipeline(Pipeline())
    (bank_run / "features.csv").unlink()
    with pytest.raises(InputError, match=r"features\.csv"):
        observability_of_run(bank_run)


def test_an_estimator_without_a_model_is_refused(bank_run):
    path, pipeline = _short("segal2011", 40)
    scenario = pipeline.scenario.model_copy(update={"recording": RecordingKind.STEREO_TRACKS})
    changed = {"estimator": EstimatorTable(kind="open3d_icp"), "scenario": scenario}
    other = pipeline.model_copy(update=changed)
    with pytest.raises(InputError, match=r"estimator\.kind.*open3d_icp has none"):
        observability_of_pipeline(other, path)
    found = replace(read_run(bank_run), pipeline=other)
    assert tables_of_run(found, open_recording(bank_run.parent / "recording"), None) == ()


def test_a_motion_that_cannot_be_judged_costs_the_report_its_part_alone(bank_run, caplog):
    (bank_run / "features.csv").unlink(missing_ok=True)
    found = read_run(bank_run)
    assert tables_of_run(found, open_recording(bank_run.parent / "recording"), None) == ()
    assert "does without its part on observability: expected the features" in caplog.text
