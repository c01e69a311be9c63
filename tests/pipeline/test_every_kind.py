"""What holds for the run of any estimator on any kind of recording."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcnav.core.errors import InputError
from pcnav.estimators.interface import Estimator
from pcnav.estimators.registry import ESTIMATORS
from pcnav.files.manifest import MANIFEST_FILE
from pcnav.pipeline import run
from pcnav.runs.estimate import Estimate
from pcnav.runs.feature_outcomes import GATED, INLIER, is_rejected, read_feature_outcomes
from pcnav.runs.reader import read_run
from pcnav.runs.records import ACCEPTED
from pcnav.runs.result_files import FEATURE_OUTCOMES_FILE
from pcnav.simulation.simulate import simulate
from tests.pipeline.made import CASES, Made, put

ALWAYS = {"covariances.npz", "metrics.json", "pipeline.toml", "report.html", "states.csv"} | {
    *("summary.json", MANIFEST_FILE)
}
STEREO = {"feature_outcomes.csv", "features.csv", "points.csv", "poses.tum"}
FILES = {
    "depth": {"knowledge.csv", "measurements.csv", "mesh_fit.csv", "poses.tum"},
    "inertia_bank": STEREO,
    "principal_axes": STEREO,
    "image_motion": {"feature_outcomes.csv", "segments.csv"},
    "attitude_inertia": set(),
}
MOTION = {"r_hill_m", "v_hill_m_s", "attitude_deg", "omega_body_deg_s", "inertia_ratios"}
STEREO_ERRORS = MOTION | {"features_m"}
ERRORS = {
    "depth": MOTION | {"position_cam_m", "com_model_m"},
    "inertia_bank": STEREO_ERRORS,
    "principal_axes": STEREO_ERRORS,
    "image_motion": {"attitude_deg", "omega_body_deg_s"},
    "attitude_inertia": {"attitude_deg", "omega_body_deg_s", "inertia_ratios"},
}
ON_THE_PAGE = {
    "depth": ("One frame as it was understood", "Parts of the target"),
    "inertia_bank": ("inertia_bank", "Error of the points", "hypotheses", "States over time"),
    "principal_axes": ("principal_axes", "Error of the points", "States over time"),
    "image_motion": ("Attitude error", "Angular rate error", "Outcomes"),
    "attitude_inertia": ("Observability of this motion", "local rank of the rotation"),
}


@pytest.fixture(scope="module", params=CASES)
def name(request: pytest.FixtureRequest) -> str:
    """Of a case."""
    return str(request.param)


@pytest.fixture(scope="module")
def made(name: str, made_of: Callable[[str], Made]) -> Made:
    return made_of(name)


def same_estimates(made: Made, other: Path) -> bool:
    """Whether another result holds the same estimates, bit for bit."""
    files = {path.name for path in made.result.iterdir()} - (ALWAYS - {"states.csv"})
    with np.load(made.result / "covariances.npz") as a, np.load(other / "covariances.npz") as b:
        same_P = a["P"].tobytes() == b["P"].tobytes()
    return same_P and all(
        (made.result / file).read_bytes() == (other / file).read_bytes() for file in files
    )


def test_the_folder_is_whole_and_every_frame_reported_once(name: str, made: Made) -> None:
    assert {path.name for path in made.result.iterdir()} == ALWAYS | FILES[name]
    assert [path.name for path in made.result.parent.iterdir()] == ["result"]
    frames = made.simulated.scenario.frames
    counted = [(done, total) for _, done, total in made.reported]
    assert counted == [(k, frames) for k in range(1, frames + 1)]
    found = read_run(made.result)
    assert found.status == tuple(estimate.status for estimate, _, _ in made.reported)
    assert found.has_estimate.any() and found.estimator == name
    assert made.summary.metrics.frames == frames


def test_what_became_of_features_is_what_the_states_count(name: str, made: Made) -> None:
    outcomes = read_feature_outcomes(made.result)
    assert bool(outcomes) is (FEATURE_OUTCOMES_FILE in FILES[name])
    notes, times = read_run(made.result).notes, made.summary.metrics.frames
    for k, (time_s, told) in enumerate(outcomes.items()):
        words = told.outcome
        rejected = sum(map(is_rejected, words))
        if name == "image_motion":
            counted = len(words), words.count(ACCEPTED) + words.count(INLIER)
            assert counted == (notes["features"][k], notes["agreeing"][k]), time_s
        else:
            assert rejected == notes["n_rejected"][k], time_s
        judged = np.isfinite(told.squared_distance) & np.isfinite(told.gate)
        within = told.squared_distance <= told.gate
        assert within[judged & np.array([word == ACCEPTED for word in words])].all()
        assert not within[judged & np.array([word == GATED for word in words])].any()
    assert not outcomes or len(outcomes) == times


def test_metrics_have_every_quantity(name: str, made: Made) -> None:
    text = (made.result / "metrics.json").read_text()
    metrics = json.loads(text)
    assert {"errors", "frames", "nees", "nis"} <= set(metrics)
    assert set(metrics["errors"]) == ERRORS[name]
    assert "NaN" not in text


def test_the_report_reports_errors_and_what_the_kind_has(name: str, made: Made) -> None:
    page = (made.result / "report.html").read_text()
    for text in ("Against the truth", str(made.recording), *ON_THE_PAGE[name]):
        assert text in page, text
    assert "http" not in page.replace("http://www.w3.org", "")


@pytest.mark.usefixtures("quick_drawings")
def test_the_truth_never_enters_an_estimate(made: Made, tmp_path: Path) -> None:
    """The same frames without truth give the same bits, and a report without errors."""
    blind = made.copy_without_truth(tmp_path)
    summary = run(blind, tmp_path / "result", made.pipeline)
    assert same_estimates(made, tmp_path / "result")
    assert summary.metrics.errors is None
    assert not (tmp_path / "result" / "metrics.json").exists()
    assert "Against the truth" not in summary.report.read_text()


@pytest.mark.usefixtures("undrawn")
def test_the_saved_pipeline_repeats_the_run(name: str, made: Made, tmp_path: Path) -> None:
    saved = read_run(made.result).pipeline
    assert saved is not None
    assert saved.seed == made.pipeline.seed
    assert saved.estimator.kind == name
    assert saved.sequence == str(made.recording.resolve())
    result = tmp_path / "result"
    run(Path(saved.sequence), result, saved)
    assert same_estimates(made, result)
    assert (result / "metrics.json").read_bytes() == (made.result / "metrics.json").read_bytes()
    assert read_run(result).pipeline == saved


def test_the_same_pipeline_writes_the_same_recording(made: Made, tmp_path: Path) -> None:
    simulate(made.simulated, target_mesh=made.mesh).write(tmp_path / "again")
    for path in made.recording.rglob("*.csv"):
        again = tmp_path / "again" / path.relative_to(made.recording)
        assert again.read_bytes() == path.read_bytes()


class Failing(Estimator):
    """Refuses the third frame."""

    def __init__(self, other: Estimator) -> None:
        self.output = other.output
        self._frames = 0

    def step(self, frame: Any, /) -> Estimate:
        self._frames += 1
        if self._frames == 3:
            raise InputError("frames", "third", "expected what cannot be had")
        return Estimate(frame.time_s, "acquiring")


def test_a_run_that_fails_leaves_nothing(
    name: str, made: Made, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make = ESTIMATORS[name].make
    put(monkeypatch, name, lambda given: Failing(make(given)))
    with pytest.raises(InputError, match="cannot be had"):
        run(made.recording, tmp_path / "deep" / "run", made.pipeline)
    assert not list(tmp_path.iterdir())


def test_a_result_does_not_replace_its_recording(made: Made) -> None:
    before = sorted(made.recording.rglob("*"))
    for out in (made.recording, made.recording.parent):
        with pytest.raises(InputError, match="does not hold"):
            run(made.recording, out, made.pipeline, overwrite=True)
    assert sorted(made.recording.rglob("*")) == before
