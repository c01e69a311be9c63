"""Every part of the benchmarks runs, and its numbers are what they say. Nothing about seconds."""

import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("small_gicp", reason="the peers are installed with the extra `peers`")

from benchmarks.accuracy import Spread, score_case
from benchmarks.following import Followed
from benchmarks.history import append, comparison_table, entry_of, last_of_same, read
from benchmarks.memory import PeakMemory, long_pipeline, measure_memory, memory_table
from benchmarks.peers import METHODS, OURS, Method, Poses
from benchmarks.scaling import BatchCost, measure_batch, speed_table
from benchmarks.scaling import memory_table as scaling_memory_table
from benchmarks.scaling_runs import real_runs
from benchmarks.scenes import Case, load, record, shortened
from benchmarks.speed import PER_FRAME, measure_throughput, throughput_table
from benchmarks.steps import measure_steps, steps_table
from benchmarks.stopwatch import Stopwatch
from pcnav.runs.timing import AnswerTime, Timing
from pcnav.simulation.motion import true_motion

_FRAMES = 8


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """The first frames of the benchmark's scene."""
    folder = tmp_path_factory.mktemp("bench") / "boxsat"
    return load(record("boxsat", shortened("boxsat", _FRAMES), folder))


@pytest.mark.parametrize(
    "method", [method for method in METHODS if method is not OURS], ids=lambda method: method.name
)
def test_peer_follows_the_target(case: Case, method: Method) -> None:
    ours = Method(OURS.name, OURS.start, lambda given: Poses(given.T_cam_model, np.ones(_FRAMES)))
    scores = score_case(case, (ours, method))
    peer = scores.of(method)
    assert scores.of(ours).position_mm == Spread(0.0, 0.0)
    assert peer.frames == scores.compared == _FRAMES // 2
    assert 0.0 < peer.position_mm.median < 30.0
    assert 0.0 < peer.attitude_deg.median < 1.0
    assert peer.frame_ms.median > 0.0


@pytest.mark.study
def test_throughput_accounts_for_the_whole_run(case: Case, tmp_path: Path) -> None:
    throughput = measure_throughput(case.scene, tmp_path / "result")
    assert (tmp_path / "result" / "report.html").is_file()
    assert throughput.frames == _FRAMES
    assert min(throughput.seconds.values()) >= 0.0
    # Every place that is watched is on the way of a run: none has been moved or renamed.
    assert {*PER_FRAME} < {*throughput.seconds}
    assert all(throughput.seconds[stage] > 0.0 for stage in PER_FRAME[:-1])
    running = sum(throughput.seconds.get(stage, 0.0) for stage in PER_FRAME)
    assert throughput.frames_per_second == pytest.approx(_FRAMES / running)
    assert throughput_table(case.scene, throughput).row_count == len(PER_FRAME) + 2


def test_steps_are_timed_after_the_start(case: Case) -> None:
    times = measure_steps(case)
    assert 1 <= times.frames < _FRAMES - 1
    assert 0.0 < times.floor < times.median <= times.p99 <= times.longest
    assert times.start > times.median
    assert times.numbers["step median over floor"] == times.median / times.floor
    assert steps_table(case, times).row_count == 5


def test_history_compares_with_the_last_that_measured_the_same(tmp_path: Path) -> None:
    assert read(tmp_path / "bench") == []
    for numbers in ({"a, ms": 4.0, "b, MB": 1.0}, {"c, s": 7.0}, {"a, ms": 3.0}):
        append(tmp_path / "bench", entry_of(numbers))
    append(tmp_path / "bench", replace(entry_of({"a, ms": 9.0}), machine="another"))
    entries = read(tmp_path / "bench")
    assert [entry.numbers for entry in entries][:2] == [{"a, ms": 4.0, "b, MB": 1.0}, {"c, s": 7.0}]
    now = entry_of({"a, ms": 6.0, "d": 1.0})
    before = last_of_same(entries, now)
    assert before == entries[2]
    table = comparison_table(before, now)
    assert table.row_count == 1
    assert [next(iter(column.cells)) for column in table.columns] == ["a, ms", "3", "6", "2.00"]
    assert last_of_same(entries, entry_of({"d": 1.0})) is None


def test_stopwatch_counts_time_once(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]

    def spend(seconds: float) -> None:
        clock[0] += seconds

    monkeypatch.setattr("benchmarks.stopwatch.perf_counter", lambda: clock[0])
    watch = Stopwatch()
    inner = watch.timed("inner", spend)

    def calls() -> None:
        spend(1.0)
        inner(2.0)
        spend(4.0)

    outer = watch.timed("outer", calls)
    outer()
    spend(100.0)
    inner(8.0)
    assert watch.seconds == {"outer": 5.0, "inner": 10.0}

    def fails() -> None:
        spend(1.0)
        raise LookupError

    with pytest.raises(LookupError):
        watch.timed("outer", fails)()
    outer()
    assert watch.seconds == {"outer": 11.0, "inner": 12.0}


def test_stopwatch_restores_what_it_watches() -> None:
    before = SimpleNamespace(load=record)
    watch = Stopwatch()
    with watch.watching({"benchmarks.scenes.record": "recording"}):
        import benchmarks.scenes

        assert benchmarks.scenes.record is not before.load
    assert benchmarks.scenes.record is before.load
    with (
        pytest.raises(AttributeError),
        watch.watching({"benchmarks.scenes.nothing_of_this_name": "x"}),
    ):
        pass


def test_long_sequence_stays_in_view() -> None:
    """Hill's equations hold a target at rest on the along-track axis where it is."""
    motion = true_motion(long_pipeline(1000))
    start = motion.state(0).r_hill
    assert np.linalg.norm(motion.state(-1).r_hill - start) < 1e-9


def test_memory_table_shows_growth() -> None:
    table = memory_table(
        PeakMemory(500, 400_000_000, 450_000_000), PeakMemory(5000, 400_900_000, 495_000_000)
    )
    cells = [list(column.cells) for column in table.columns]
    assert cells[3] == ["1.002", "1.100"]
    assert cells[4] == ["0.20", "10.00"]


@pytest.mark.study
@pytest.mark.skipif(sys.platform != "linux", reason="reads what Linux says of a process")
def test_peak_memory_is_the_childs_own(tmp_path: Path) -> None:
    """A parent that holds more than the child ever needs does not show in the child's peak."""
    ballast = np.ones(75_000_000)
    peak = measure_memory(3, tmp_path)
    assert peak.frames == 3
    assert 50e6 < peak.tracking <= peak.whole < ballast.nbytes


def test_scaling_runs_batches_in_a_process_of_their_own_and_judges_them(tmp_path: Path) -> None:
    cost = measure_batch("cheap", 4, 1)
    assert (cost.runs, cost.jobs) == (4, 1)
    assert cost.seconds > 0.0 and 10.0 < cost.peak_mb < 5000.0
    function, runs = real_runs(2, tmp_path)
    assert len(runs) == 2 and len({run.seed for run in runs}) == 2 and callable(function)
    slow, quick = BatchCost(24, 1, 100.0, 300.0), BatchCost(24, 2, 50.0, 301.0)
    assert list(speed_table(slow, quick).columns[4].cells) == ["-", "pass"]
    assert list(scaling_memory_table(slow, quick).columns[3].cells) == ["-", "pass"]
    grown = BatchCost(240, 2, 50.0, 900.0)
    assert list(scaling_memory_table(slow, grown).columns[3].cells) == ["-", "fail"]


def test_frames_wait_for_those_before_them() -> None:
    # At 10 Hz: the first takes 250 ms, all others 60 ms.
    rows = tuple(
        Timing(0.1 * k, AnswerTime.IN_TIME, 0.01, 0.25 if k == 0 else 0.06) for k in range(6)
    )
    followed = Followed("a", 0.1, 10.0, rows, 0, None, same=True)
    np.testing.assert_allclose(followed.alone_s, [0.25, 0.21, 0.17, 0.13, 0.09, 0.06])
    assert followed.late(AnswerTime.LATE) == 0
    assert followed.delays_s.tolist() == [0.01] * 6
