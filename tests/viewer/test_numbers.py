"""The numbers that the view draws are those of metrics.json, whatever kind of run it is."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcnav.attitude_pipeline import run_attitudes
from pcnav.config.pipeline_file import Pipeline, read_pipeline
from pcnav.config.shipped import shipped_pipeline
from pcnav.core import chi_square
from pcnav.feature_pipeline import run_features
from pcnav.image_pipeline import run_images
from pcnav.simulation.attitude_recording import simulate_attitudes
from pcnav.simulation.feature_recording import simulate_tracks
from pcnav.simulation.image_recording import simulate_images
from pcnav.viewer.curves import Chart, groups_of
from pcnav.viewer.loading import load_run

_UNITS = {"m": 1.0, "mm": 1e-3, "deg": 1.0, "deg/s": 1.0, "": 1.0}
_GROUPS = {
    "r_hill_m": "position",
    "attitude_deg": "attitude",
    "omega_body_deg_s": "rate",
    "com_model_m": "mass centre",
    "inertia_ratios": "inertia ratios",
}
"""Group of plots by key of metrics.json; both have errors of the same unit or its thousandth."""


def _pipeline(name: str, frames: int) -> tuple[Path, Pipeline]:
    path = shipped_pipeline(name)
    assert path is not None
    pipeline = read_pipeline(path)
    scenario = pipeline.scenario.model_copy(update={"frames": frames})
    return path, pipeline.model_copy(update={"scenario": scenario})


def _stereo(name: str, frames: int, folder: Path) -> None:
    path, pipeline = _pipeline(name, frames)
    simulate_tracks(pipeline, folder / "recording", False, path)
    run_features(folder / "recording", folder / "result", pipeline)


def _images(name: str, frames: int, folder: Path) -> None:
    path, pipeline = _pipeline(name, frames)
    simulate_images(pipeline, folder / "recording", False, path)
    run_images(folder / "recording", folder / "result", pipeline)


def _attitudes(name: str, frames: int, folder: Path) -> None:
    _, pipeline = _pipeline(name, frames)
    simulate_attitudes(pipeline, folder / "recording")
    run_attitudes(folder / "recording", folder / "result", pipeline)


_OTHER_KINDS: dict[str, Callable[[Path], None]] = {
    # The first estimate comes after 100 frames.
    "hu2024": lambda folder: _stereo("hu2024", 150, folder),
    "segal2011": lambda folder: _stereo("segal2011", 40, folder),
    "images": lambda folder: _images("applsci2022", 40, folder),
    "attitudes": lambda folder: _attitudes("deng2024", 40, folder),
}


@pytest.fixture(scope="module", params=["depth", *_OTHER_KINDS])
def result(
    request: pytest.FixtureRequest, run_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    """A result folder of every kind."""
    if request.param == "depth":
        return run_folder
    folder = tmp_path_factory.mktemp("numbers")
    _OTHER_KINDS[request.param](folder)
    return folder / "result"


def _metrics(result: Path) -> Any:
    return json.loads((result / "metrics.json").read_text())


def _rms(charts: tuple[Chart, ...]) -> float:
    """Of the norms of errors, in the unit of metrics.json."""
    unit = charts[0].label.partition(", ")[2]
    values = np.column_stack([chart.curve.values for chart in charts])
    norms = _UNITS[unit] * np.linalg.norm(values, axis=1)
    return float(np.sqrt(np.mean(norms[np.isfinite(norms)] ** 2)))


def test_errors_are_those_of_metrics_json(result: Path) -> None:
    groups, errors = groups_of(load_run(result)), _metrics(result)["errors"]
    for key, name in _GROUPS.items():
        charts = groups[name]().charts if name in groups else ()
        assert any(chart.is_error for chart in charts) is (key in errors), name
        if key in errors:
            assert _rms(charts) == pytest.approx(errors[key]["whole"]["rms"], rel=1e-9), name


def test_innovations_are_those_of_metrics_json(result: Path) -> None:
    loaded, stored = load_run(result), _metrics(result)["nis"]
    charts = [each for each in groups_of(loaded)["consistency"]().charts if "NIS" in each.label]
    if not stored["frames"]:
        assert charts == []
        return
    degrees = loaded.track.nis_dof
    ratio = charts[0].curve.values
    shown = np.isfinite(ratio)
    squared = ratio[shown] * chi_square.quantile(0.95, degrees[shown])
    assert int(shown.sum()) == stored["frames"]
    mean = float(squared.sum() / degrees[shown].sum())
    assert mean == pytest.approx(stored["mean_per_degree_of_freedom"], rel=1e-9)
