"""A run that is looked at while it goes on."""

import filecmp
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
import numpy as np
import pytest
import viser
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.typing import Subprotocol

from pcnav.config.pipeline_file import read_pipeline
from pcnav.estimators.depth.tracker import Tracker
from pcnav.pipeline import run
from pcnav.recordings.opening import open_sequence
from pcnav.runs.estimate import Estimate
from pcnav.runs.reader import read_run
from pcnav.target.satellite import load_target
from pcnav.viewer.live import LiveView, run_live
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.loading import load_run
from pcnav.viewer.server import LocalServer
from tests.viewer.conftest import CAMERA, FRAMES, small_pipeline, watched


@contextmanager
def stuck_page(port: int) -> Iterator[Connection]:
    """A page that says where its camera is and then takes nothing any more."""
    protocol = Subprotocol(f"viser-v{viser.__version__}")
    # The library stops reading from the socket when so many messages wait for their reader.
    with connect(
        f"ws://127.0.0.1:{port}", subprotocols=[protocol], max_queue=1, close_timeout=0.1
    ) as page:
        page.send(msgspec.msgpack.encode(CAMERA))
        yield page


@pytest.fixture(scope="module")
def estimates(run_folder: Path) -> list[Estimate]:
    """Those of the run, made anew."""
    pipeline = read_pipeline(run_folder / "pipeline.toml")
    sequence = open_sequence(run_folder.parent / "sequence")
    assert sequence.info.target_mesh is not None
    target = load_target(sequence.info.target_mesh)
    tracker = Tracker(target, sequence.info, pipeline.perception, pipeline.filter, pipeline.seed)
    return [tracker.step(frame) for frame in sequence]


@pytest.fixture
def live(run_folder: Path) -> Iterator[LiveView]:
    view = LiveView(0, lambda _: None)
    as_run = read_run(run_folder).pipeline
    assert as_run is not None
    view.expect("live", as_run, Tracker.output)
    yield view
    view.stop()


def test_what_was_handed_out_does_not_change(live: LiveView, estimates: list[Estimate]) -> None:
    for estimate in estimates[:3]:
        live.add(estimate)
    early = live.snapshot().runs[0]
    before = early.T_cam_model.copy()
    for repeat in range(200):
        for estimate in estimates[3:6]:
            live.add(estimate)
        assert len(live.snapshot().runs[0]) == 3 + 3 * (repeat + 1)
    assert np.array_equal(early.T_cam_model, before, equal_nan=True)


def test_an_ended_run_is_shown_as_its_result(live: LiveView, loaded: LoadedRun) -> None:
    first = live.snapshot()
    live.finish(loaded)
    assert live.snapshot().runs == (loaded,)
    assert not live.snapshot().is_live and live.snapshot().number != first.number


def test_results_are_the_same_bytes_with_and_without_the_view(
    run_folder: Path, tmp_path: Path
) -> None:
    """And the page stays when the run has ended."""
    ports: list[int] = []
    sequence, out = run_folder.parent / "sequence", tmp_path / "result"
    summary, server = run_live(
        lambda view: watched(sequence, out, small_pipeline(), view),
        0,
        lambda served: ports.append(served.get_port()),
    )
    try:
        assert ports == [server.get_port()]
        same = [file.name for file in run_folder.iterdir() if file.suffix != ".html"]
        # It says where the result is.
        same.remove("pipeline.toml")
        _, different, missing = filecmp.cmpfiles(run_folder, summary.folder, same, shallow=False)
        assert different == [] and missing == []
    finally:
        server.stop()


def test_a_run_that_fails_leaves_no_server(run_folder: Path, tmp_path: Path) -> None:
    served: list[LocalServer] = []

    def fail(_: int) -> None:
        raise KeyboardInterrupt

    sequence, out = run_folder.parent / "sequence", tmp_path / "result"
    with pytest.raises(KeyboardInterrupt):
        run_live(
            lambda view: watched(sequence, out, small_pipeline(), view, fail), 0, served.append
        )
    assert not (tmp_path / "result").exists()
    with pytest.raises(OSError):
        connect(f"ws://127.0.0.1:{served[0].get_port()}", open_timeout=1.0)


def test_a_stuck_page_does_not_hold_up_the_run(live: LiveView, estimates: list[Estimate]) -> None:
    """No call of the run waits for a page, and what is kept for the page stays bounded."""
    live.add(estimates[0])
    assert live.server is not None
    with stuck_page(live.server.get_port()):
        deadline = time.monotonic() + 20.0
        while not live.server.get_clients() and time.monotonic() < deadline:
            time.sleep(0.02)
        (client,) = live.server.get_clients().values()
        spent: list[float] = []
        for _ in range(100):
            for estimate in estimates[1:]:
                started = time.thread_time()
                live.add(estimate)
                spent.append(time.thread_time() - started)
            time.sleep(0.005)
        buffer = client._websock_connection.get_message_buffer()
        assert len(buffer.message_from_id) < 500
        # Processor time of the run's own thread, which other programs do not change; now and then
        # a call meets the collection of garbage.
        assert np.percentile(spent, 99) < 0.01
        assert len(live.snapshot().runs[0]) == 1 + 100 * (FRAMES - 1)


def test_a_killed_run_can_be_looked_at(run_folder: Path, tmp_path: Path) -> None:
    """While frames are written the folder has all that the view needs."""
    seen: list[LoadedRun] = []

    def look(_: Estimate, done: int, total: int) -> None:
        if done == total:
            (staging,) = tmp_path.glob(".result-*")
            seen.append(load_run(staging))

    run(run_folder.parent / "sequence", tmp_path / "result", small_pipeline(), on_estimate=look)
    assert seen[0].target is not None and seen[0].frames is not None
    assert "unfinished" in seen[0].notes[0]
