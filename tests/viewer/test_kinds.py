"""Runs of every kind: what the view draws is what their files say, and what it drew meanwhile."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcnav.config.pipeline_file import Pipeline, read_pipeline
from pcnav.config.shipped import shipped_pipeline
from pcnav.core import chi_square
from pcnav.dynamics.blocks import FILE_ORDER, RATE
from pcnav.runs.feature_outcomes import INLIER, is_rejected
from pcnav.runs.records import ACCEPTED
from pcnav.simulation.simulate import simulate
from pcnav.viewer.assessment import inlier_ratio
from pcnav.viewer.controls import available_layers
from pcnav.viewer.curves import Chart, groups_of
from pcnav.viewer.knowledge import knowledge_html
from pcnav.viewer.live import LiveView
from pcnav.viewer.loaded_run import LoadedRun, Snapshot
from pcnav.viewer.loading import load_run
from pcnav.viewer.panels import facts_html
from pcnav.viewer.render_options import Layer
from pcnav.viewer.server import LocalServer
from tests.viewer.conftest import FRAMES, small_pipeline, watched

_METRES = {"m": 1.0, "mm": 1e-3, "m/s": 1.0, "mm/s": 1e-3}
_UNITS = {**_METRES, "deg": 1.0, "deg/s": 1.0, "norm": 1.0, "": 1.0}
_QUANTITIES = {
    "position_cam_m": "position",
    "r_hill_m": "position",
    "attitude_deg": "attitude",
    "omega_body_deg_s": "rate",
    "com_model_m": "mass centre",
    "inertia_ratios": "inertia ratios",
}
"""Group of plots by key of metrics.json; both have errors of the same unit or its thousandth."""


@dataclass(frozen=True)
class Kind:
    """A kind of run, and what the view has of it."""

    pipeline: str
    """A shipped one; empty for that of the shared recording of depth frames."""
    frames: int
    groups: tuple[str, ...]
    absent: frozenset[Layer]
    used: str = ""
    """What the last plot counts."""
    estimator: str | None = None
    """In place of the pipeline's."""


_NO_RECTANGLES = frozenset({Layer.ACCEPTED, Layer.REJECTED, Layer.NAMES, Layer.COM})
_NO_MODEL = _NO_RECTANGLES | {Layer.POINTS, Layer.SENSOR, Layer.MESH, Layer.TRUTH}
_NO_PLACE = _NO_MODEL | {Layer.POSITION, Layer.TRAIL}
_NO_INERTIA = frozenset({Layer.PRINCIPAL, Layer.MOMENTUM})
_TURNING = ("attitude", "rate", "inertia ratios", "error norms", "consistency")
KINDS = {
    "depth": Kind(
        *("", FRAMES, ("position", "attitude", "rate", "mass centre", *_TURNING[2:])),
        *(frozenset(), "rectangles"),
    ),
    "poses alone": Kind(
        *("", FRAMES, ("position", "attitude", "error norms", "consistency")),
        _NO_RECTANGLES | _NO_INERTIA | {Layer.POSITION, Layer.ATTITUDE, Layer.RATE},
        estimator="open3d_icp",
    ),
    # The first estimate comes after 100 frames.
    "hu2024": Kind("hu2024", 150, ("position", *_TURNING), _NO_MODEL, "features"),
    "segal2011": Kind("segal2011", 40, ("position", *_TURNING), _NO_MODEL, "features"),
    "images": Kind(
        *("applsci2022", 40, ("attitude", "rate", "error norms", "consistency")),
        *(_NO_PLACE | _NO_INERTIA, "matches"),
    ),
    "attitudes": Kind("deng2024", 40, _TURNING, _NO_PLACE, "attitudes"),
    "attitudes of images": Kind(
        *("applsci2022", 40, _TURNING, _NO_PLACE, "attitudes", "attitude_inertia")
    ),
}


@dataclass(frozen=True)
class Seen:
    """A run as it was seen to go on, and its result."""

    live: LoadedRun
    stored: LoadedRun
    folder: Path
    kind: Kind


def _simulated(name: str, frames: int, recording: Path) -> Pipeline:
    path = shipped_pipeline(name)
    assert path is not None
    pipeline = read_pipeline(path)
    scenario = pipeline.scenario.model_copy(update={"frames": frames})
    pipeline = pipeline.model_copy(update={"scenario": scenario})
    simulate(pipeline, path).write(recording)
    return pipeline


@pytest.fixture(scope="module", params=KINDS)
def seen(
    request: pytest.FixtureRequest, run_folder: Path, tmp_path_factory: pytest.TempPathFactory
) -> Seen:
    folder, kind = tmp_path_factory.mktemp("kinds"), KINDS[request.param]
    recording, pipeline, out = run_folder.parent / "sequence", small_pipeline(), folder / "result"
    if kind.pipeline:
        recording = folder / "recording"
        pipeline = _simulated(kind.pipeline, kind.frames, recording)
    served: list[LocalServer] = []
    counts: list[int] = []
    view = LiveView(0, served.append)

    def advance(done: int) -> None:
        snapshot = view.snapshot()
        assert snapshot.is_live and len(snapshot.runs[0]) == done
        counts.append(done)

    try:
        watched(recording, out, pipeline, view, advance, kind.estimator)
        assert counts == list(range(1, kind.frames + 1)) and len(served) == 1
        last = view.snapshot().runs[0]
        stored = load_run(out)
        view.finish(stored)
        assert view.snapshot().runs == (stored,) and not view.snapshot().is_live
    finally:
        view.stop()
    return Seen(last, stored, out, kind)


def _metrics(seen: Seen) -> Any:
    return json.loads((seen.folder / "metrics.json").read_text())


def _rms(charts: tuple[Chart, ...]) -> float:
    """Of the norms of errors, in the unit of metrics.json."""
    unit = charts[0].label.partition(", ")[2]
    values = np.column_stack([chart.values for chart in charts])
    norms = _UNITS[unit] * np.linalg.norm(values, axis=1)
    return float(np.sqrt(np.mean(norms[np.isfinite(norms)] ** 2)))


def test_errors_are_those_of_metrics_json(seen: Seen) -> None:
    groups, errors = groups_of(seen.stored), _metrics(seen)["errors"]
    # Where the mass centre is estimated its position is drawn, not that of the model's origin.
    known = {name: errors[key] for key, name in _QUANTITIES.items() if key in errors}
    assert set(known) == set(groups) - {"error norms", "consistency"}
    for name, error in known.items():
        charts = groups[name]().charts
        assert all(chart.is_error for chart in charts), name
        assert _rms(charts) == pytest.approx(error["whole"]["rms"], rel=1e-9), name


def test_every_quantity_of_metrics_json_is_drawn(seen: Seen) -> None:
    # Those of single points need the files of the run.
    errors = {key: each for key, each in _metrics(seen)["errors"].items() if key != "features_m"}
    charts = groups_of(seen.stored)["error norms"]().charts
    for error, chart in zip(errors.values(), charts, strict=True):
        assert chart.label.startswith(error["title"].removesuffix(" since the first frame"))
        assert _rms((chart,)) == pytest.approx(error["whole"]["rms"], rel=1e-9)


def test_innovations_are_those_of_metrics_json(seen: Seen) -> None:
    stored = _metrics(seen)["nis"]
    charts = groups_of(seen.stored)["consistency"]().charts
    shown = [chart.values for chart in charts if "NIS" in chart.label]
    if not stored["frames"]:
        assert shown == []
        return
    used, dof = np.isfinite(shown[0]), seen.stored.run.nis_dof
    squared = shown[0][used] * chi_square.quantile(0.95, dof[used])
    assert int(used.sum()) == stored["frames"]
    mean = float(squared.sum() / dof[used].sum())
    assert mean == pytest.approx(stored["mean_per_degree_of_freedom"], rel=1e-9)


def test_what_was_seen_meanwhile_is_what_is_stored(seen: Seen) -> None:
    live, stored = seen.live, seen.stored
    known = live.run.has_estimate
    assert live.run.status == stored.run.status
    assert known.any() and np.array_equal(known, stored.run.has_estimate)
    assert np.array_equal(live.run.nis_dof, stored.run.nis_dof)
    assert live.orbit == stored.orbit
    assert set(live.covariances) == set(stored.covariances)
    for name, P in live.covariances.items():
        assert np.array_equal(P, stored.covariances[name], equal_nan=True)
    known_then = {time_s: each for time_s, each in live.outcomes.items() if len(each.feature)}
    assert known_then.keys() == stored.outcomes.keys()
    for time_s, each in stored.outcomes.items():
        assert each.outcome == known_then[time_s].outcome
        assert np.array_equal(each.feature, known_then[time_s].feature)
    # The file holds attitudes as quaternions.
    np.testing.assert_allclose(live.T_cam_model, stored.T_cam_model, atol=1e-9)
    for block in live.trajectory.layout.blocks:
        ours, theirs = (run.trajectory.sd_of(block)[known] for run in (live, stored))
        np.testing.assert_allclose(ours, theirs, rtol=1e-12)
    for name, values in live.trajectory.values.items():
        # The rates of a chain of images are found when it has ended.
        if name != RATE.name or np.isfinite(values).any():
            np.testing.assert_allclose(values, stored.trajectory.values[name], atol=1e-12)
    if seen.kind.used:
        counted = [groups_of(run)["consistency"]().charts[-1] for run in (live, stored)]
        assert counted[0].label == counted[1].label == f"{seen.kind.used} used, count"
        assert np.array_equal(counted[0].values, counted[1].values)


def test_plots_layers_and_facts_are_those_that_the_kind_has(seen: Seen) -> None:
    groups = groups_of(seen.stored)
    assert tuple(groups) == seen.kind.groups
    for name, make in groups.items():
        charts = make().charts
        assert charts or not seen.kind.used, name
        for chart in charts:
            assert "," in chart.label or "/" in chart.label or "%" in chart.label, chart.label
            assert len(chart.values) == len(chart.time_s) == seen.kind.frames
    layers = available_layers(Snapshot((seen.stored,), 0, is_live=False))
    assert set(Layer) - set(layers) == seen.kind.absent
    last = int(np.flatnonzero(seen.stored.run.has_estimate)[-1])
    facts = facts_html(seen.stored, last, None)
    assert "nan" not in facts and ("deg/s" in facts) is ("rate" in groups)
    assert ("range" in facts) is ("position" in groups)
    known = knowledge_html(seen.stored)
    for block in FILE_ORDER:
        assert (f">{block.title}" in known) is (block.name in seen.stored.trajectory.values)
    assert "nan" not in known
    assert ("over Ixx" in facts) is ("inertia ratios" in groups)


def test_the_inlier_ratio_is_the_share_of_what_was_compared(seen: Seen) -> None:
    """Counted anew from what became of each feature."""
    ratio, outcomes = inlier_ratio(seen.stored), seen.stored.outcomes
    if seen.kind.used not in ("features", "matches"):
        return
    assert ratio is not None
    for k, time_s in enumerate(seen.stored.run.time_s.tolist()):
        words = outcomes[time_s].outcome if time_s in outcomes else ()
        agree = sum(word in (ACCEPTED, INLIER) for word in words)
        compared = agree + sum(map(is_rejected, words))
        if compared:
            assert ratio[k] == pytest.approx(agree / compared), time_s


def test_a_target_without_a_place_is_drawn_before_its_camera(seen: Seen) -> None:
    if seen.stored.trajectory.T_cam_target is not None:
        return
    T = seen.stored.T_cam_model[seen.stored.run.has_estimate]
    assert np.allclose(T[:, :3, 3], [0.0, 0.0, 4.0])


def test_a_frame_of_a_run_that_nothing_is_known_of() -> None:
    from pcnav.runs.estimate import Estimate

    with pytest.raises(RuntimeError, match="expect"):
        LiveView(0, print).add(Estimate(0.0, "locked"))
