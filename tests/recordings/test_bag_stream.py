"""A stream of MCAP is what the file of it is, read as it comes."""

import io
import os
import time
from pathlib import Path
from typing import IO

import numpy as np
import pytest

from pcnav.config.recording import AS_IT_IS, RecordingTable
from pcnav.core.errors import InputError
from pcnav.recordings import bag_stream
from pcnav.recordings.arriving import Arrival
from pcnav.recordings.bag_stream import BagStream
from pcnav.recordings.mcap_messages import McapMessages
from pcnav.recordings.opening import open_sequence
from pcnav.recordings.region import Region
from pcnav.recordings.sequence import SequenceInfo
from tests.recordings.other_formats import Scene, write_bag


def streamed(stream: IO[bytes], table: RecordingTable = AS_IT_IS) -> BagStream:
    info = SequenceInfo("stream", 0.0, None, None)
    return BagStream(McapMessages(stream), info, table, Region())


def all_of(source: BagStream, within_s: float = 20.0) -> list[Arrival]:
    found, end = [], time.monotonic() + within_s
    while not source.has_ended:
        assert time.monotonic() < end
        if source.look():
            found.append(source.take())
        else:
            time.sleep(0.001)
    return found


def test_a_stream_gives_the_frames_of_the_file(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_bag(Scene(scene), tmp_path / "a.mcap")
    whole = open_sequence(path)
    # However long it lies in the pipe.
    monkeypatch.setattr(bag_stream, "_PATIENCE_S", 0.0)
    source = streamed(io.BytesIO(path.read_bytes()))
    while not source._messages._has_stopped:
        time.sleep(0.001)
    found = all_of(source)
    assert len(found) == len(whole) and source.recording is not None
    assert source.recording.info.time_zero_s == whole.info.time_zero_s > 1e9
    for arrival, frame in zip(found, whole, strict=True):
        assert arrival.frame.time_s == pytest.approx(frame.time_s, abs=1e-9)
        assert np.array_equal(arrival.frame.depth_m, frame.depth_m)
        assert arrival.frame.camera == frame.camera
        assert np.allclose(arrival.frame.T_cam_world, frame.T_cam_world, atol=1e-12)
        assert not arrival.was_there
    chosen = streamed(io.BytesIO(path.read_bytes()), RecordingTable(start=1, frames=1))
    (one,) = all_of(chosen)
    assert np.array_equal(one.frame.depth_m, whole.frame(1).depth_m)


def test_a_stream_that_breaks_off_ends_and_one_of_anything_else_is_refused(
    scene: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    data = write_bag(Scene(scene), tmp_path / "a.mcap").read_bytes()
    read, write = os.pipe()
    source = streamed(os.fdopen(read, "rb"))
    with os.fdopen(write, "wb") as pipe:
        # Of a pipe nothing comes before it is written.
        assert not source.look() and not source.has_ended
        pipe.write(data[:-2000])
    all_of(source)
    assert "ends early" in caplog.text
    wrong = streamed(io.BytesIO(b"no bag at all " * 9))
    with pytest.raises(InputError, match="expected MCAP"):
        all_of(wrong)


def test_an_image_waits_for_its_camera(scene: Path, tmp_path: Path) -> None:
    path = write_bag(Scene(scene), tmp_path / "a.mcap", with_info=False)
    source = streamed(io.BytesIO(path.read_bytes()))
    end = time.monotonic() + 0.1
    while time.monotonic() < end:
        assert not source.look()
    assert source.why_not is not None and "CameraInfo" in str(source.why_not)
