"""What is scored, which peer counts as the best, and what is written. Nothing about seconds."""

import csv
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("small_gicp", reason="the peers are installed with the extra `peers`")

from benchmarks.accuracy import CaseScores, FrameTime, Score, Spread, score_case
from benchmarks.comparison import (
    CASES_FILE,
    MARKDOWN_FILE,
    VERDICT_FILE,
    case_table,
    conditions,
    judge,
    verdict_table,
    write_comparison,
)
from benchmarks.peers import (
    ICP_PEERS,
    KISS_ICP,
    METHODS,
    OPEN3D,
    OURS,
    SINGLE_FRAME,
    Method,
    Poses,
    peer_threads,
)
from benchmarks.scenes import Case, load, noise_levels, record, shortened
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform

_FRAMES = 9
_FIRST = 4
"""The first frame of the second half."""


@pytest.fixture(scope="module", params=["boxsat", "twinwing"])
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Case:
    """A few frames of a satellite without symmetry and of one with a half turn."""
    folder = tmp_path_factory.mktemp("bench") / "sequence"
    return load(record(request.param, shortened(request.param, _FRAMES), folder))


def _method(
    name: str,
    change: Callable[[FloatArray], None],
    seconds: FloatArray | None = None,
    remembers: bool = True,
) -> Method:
    """A method that knows the truth and says it changed."""

    def estimate(given: Case) -> Poses:
        T_cam_model = given.T_cam_model.copy()
        change(T_cam_model)
        return Poses(T_cam_model, np.full(_FRAMES, 0.002) if seconds is None else seconds)

    return Method(name, "all", estimate, remembers)


def test_errors_of_the_second_half_are_those_put_in(case: Case) -> None:
    """10 mm and 0.02 rad in the second half; what is wrong in the first does not count."""
    turn = exp_rotation(np.array([0.0, 0.02, 0.0]))

    def change(T_cam_model: FloatArray) -> None:
        T_cam_model[:_FIRST, 0, 3] += 100.0
        T_cam_model[_FIRST:] = T_cam_model[_FIRST:] @ make_transform(
            turn, np.array([0.006, 0.0, 0.008])
        )

    method = _method("shifted", change)
    scores = score_case(case, (method,))
    assert (scores.first_frame, scores.last_frame, scores.compared) == (_FIRST, _FRAMES - 1, 5)
    score = scores.of(method)
    np.testing.assert_allclose([score.position_mm.median, score.position_mm.p95], 10.0)
    np.testing.assert_allclose(
        [score.attitude_deg.median, score.attitude_deg.p95], np.rad2deg(0.02)
    )


def test_frames_are_compared_where_all_have_a_pose_and_timed_all(case: Case) -> None:
    """One method is silent where the other is wrong; its time there counts all the same."""
    silent, wrong = _FIRST + 1, 0.5
    seconds = np.full(_FRAMES, 0.001)
    seconds[0], seconds[silent] = 9.0, 0.006

    def hide(T_cam_model: FloatArray) -> None:
        T_cam_model[silent] = np.nan

    def err(T_cam_model: FloatArray) -> None:
        T_cam_model[silent, 0, 3] += wrong

    first, second = _method("silent", hide, seconds), _method("wrong", err)
    scores = score_case(case, (first, second))
    assert scores.compared == 4
    assert scores.of(first).frames == 4
    assert scores.of(second).frames == 5
    assert scores.of(second).position_mm == Spread(0.0, 0.0)
    times = scores.of(first).frame_ms
    np.testing.assert_allclose((times.mean, times.median, times.longest), (2.0, 1.0, 6.0))


def test_only_a_method_without_memory_may_change_to_an_equivalent_attitude(case: Case) -> None:
    symmetries = case.scene.target.symmetry_transforms

    def flip(T_cam_model: FloatArray) -> None:
        T_cam_model[-2:] = T_cam_model[-2:] @ symmetries[-1]

    keeps, forgets = _method("keeps", flip), _method("forgets", flip, remembers=False)
    scores = score_case(case, (keeps, forgets))
    assert scores.of(forgets).attitude_deg.p95 == pytest.approx(0.0, abs=1e-5)
    expected = 180.0 if len(symmetries) > 1 else 0.0
    assert scores.of(keeps).attitude_deg.p95 == pytest.approx(expected, abs=1e-5)
    assert scores.of(keeps).attitude_deg.median == pytest.approx(0.0, abs=1e-5)


def _scores(errors: dict[str, tuple[float, float, float]]) -> CaseScores:
    """Of all methods, with median errors in mm and deg and median ms."""
    return CaseScores(
        satellite="boxsat",
        range_sigma_m=0.02,
        first_frame=50,
        last_frame=99,
        compared=49,
        scores=tuple(
            Score(
                method,
                Spread(errors[method.name][0], 7.0),
                Spread(errors[method.name][1], 8.0),
                FrameTime(9.0, errors[method.name][2], 11.0),
                50,
            )
            for method in METHODS
        ),
    )


@pytest.fixture
def measured() -> CaseScores:
    """The best ICP peers are the third in position and the second in attitude; KISS-ICP is better
    than either but has no model."""
    errors = {method.name: (2.0, 0.9, 30.0) for method in METHODS}
    errors[ICP_PEERS[2].name] = (1.0, 0.8, 1.0)
    errors[ICP_PEERS[1].name] = (3.0, 0.4, 1.0)
    errors[KISS_ICP.name] = (0.1, 0.01, 1.0)
    errors[OPEN3D.name] = (4.0, 0.9, 10.0)
    errors[OURS.name] = (0.5, 0.3, 11.0)
    errors[SINGLE_FRAME.name] = (0.7, 0.36, 200.0)
    return _scores(errors)


def test_best_peer_and_bars(measured: CaseScores) -> None:
    verdict = judge(measured)
    assert [ratio.value for ratio in verdict.ratios] == pytest.approx([0.5, 0.75, 0.7, 0.9, 1.1])
    outcomes = ["pass", "MISS", "pass", "MISS", "MISS"]
    assert [ratio.outcome for ratio in verdict.ratios] == outcomes
    assert [ratio.bar for ratio in verdict.ratios] == [0.5, 0.5, 0.8, 0.8, 1.0]
    best_mm, best_deg = ICP_PEERS[2].name, ICP_PEERS[1].name
    assert [ratio.peer for ratio in verdict.ratios] == [
        best_mm,
        best_deg,
        best_mm,
        best_deg,
        OPEN3D.name,
    ]
    assert verdict_table([verdict]).note == "2 of 5 bars met."


def test_what_was_not_measured_misses_its_bar(measured: CaseScores) -> None:
    nothing = Spread.of(np.empty(0))
    empty = replace(
        measured,
        compared=0,
        scores=tuple(
            replace(score, position_mm=nothing, attitude_deg=nothing) for score in measured.scores
        ),
    )
    assert [ratio.outcome for ratio in judge(empty).ratios[:4]] == ["MISS"] * 4
    with pytest.raises(LookupError, match="no score of nobody"):
        measured.of(Method("nobody", "", OURS.estimate))


def test_written_tables_say_what_was_measured(measured: CaseScores, tmp_path: Path) -> None:
    out = tmp_path / "runs" / "bench"
    write_comparison(out, [measured])
    write_comparison(out, [measured, measured])
    page = (out / MARKDOWN_FILE).read_text(encoding="utf-8")
    assert page.count(case_table(measured).to_markdown().rstrip()) == 2
    for sentence in conditions():
        assert sentence in page
    with (out / CASES_FILE).open(encoding="utf-8", newline="") as file:
        cases = list(csv.DictReader(file))
    assert [row["method"] for row in cases] == 2 * [method.name for method in METHODS]
    ours = cases[0]
    assert (float(ours["position_median_mm"]), float(ours["attitude_p95_deg"])) == (0.5, 8.0)
    assert [float(ours[f"frame_{name}_ms"]) for name in ("mean", "median", "max")] == [9, 11, 11]
    assert (ours["frames_compared"], ours["frames_with_pose"]) == ("49", "50")
    with (out / VERDICT_FILE).open(encoding="utf-8", newline="") as file:
        verdicts = list(csv.DictReader(file))
    assert len(verdicts) == 10
    for row in verdicts:
        ratio = float(row["median"]) / float(row["median_of_peer"])
        assert float(row["ratio"]) == pytest.approx(ratio, rel=1e-4)
        assert row["outcome"] == ("pass" if ratio <= float(row["bar"]) else "MISS")


@pytest.mark.parametrize(("stated", "threads"), [("3", 3), ("", 5), ("0", 5), ("4,2", 5)])
def test_peers_take_all_cores_unless_told(
    monkeypatch: pytest.MonkeyPatch, stated: str, threads: int
) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 5)
    monkeypatch.setenv("OMP_NUM_THREADS", stated)
    assert peer_threads() == threads
    assert f"run on {threads} threads" in conditions()[0]


def test_two_noise_levels() -> None:
    assert noise_levels("cubesat6u") == (0.003, 0.0015)
    assert shortened("cubesat6u", 5, 0.0015).noise.range_sigma_m == 0.0015
