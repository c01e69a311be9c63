"""A folder of depth frames that is read while it is written."""

import json
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from pcnav.config.region import RegionTable
from pcnav.recordings import growing_folder
from pcnav.recordings.arriving import END_FILE, Arrival
from pcnav.recordings.depth_folder import with_more
from pcnav.recordings.depth_png import write_depth_png
from pcnav.recordings.growing_folder import GrowingFolder
from pcnav.recordings.opening import open_sequence
from pcnav.recordings.sequence import Sequence

CAMERA = {"K": [100.0, 0.0, 3.5, 0.0, 100.0, 2.5, 0.0, 0.0, 1.0], "depth_scale": 1.0}
SIZE = (6, 8)


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(growing_folder, "_SETTLED_S", 0.002)
    monkeypatch.setattr(growing_folder, "_PATIENCE_S", 0.15)


def png(folder: Path, value: int) -> bytes:
    path = folder.parent / f"made-{value}.png"
    write_depth_png(path, np.full(SIZE, value, dtype=np.uint16))
    return path.read_bytes()


def followed(folder: Path, max_frames: int | None = None) -> GrowingFolder:
    opened = partial(open_sequence, folder, None, True)
    return GrowingFolder(folder, opened, RegionTable(), max_frames, with_more)


def next_of(source: GrowingFolder, within_s: float = 2.0) -> Arrival | None:
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        if source.look():
            return source.take()
        if source.has_ended:
            return None
        time.sleep(0.001)
    return None


def depth_of(arrival: Arrival | None) -> float:
    assert arrival is not None
    return float(arrival.frame.depth_m.max())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "frames"
    made.mkdir()
    (made / "depth_camera.json").write_text(json.dumps(CAMERA))
    return made


def test_a_half_written_frame_is_waited_for(folder: Path) -> None:
    source, data = followed(folder), png(folder, 2000)
    assert not source.look() and source.recording is None
    (folder / "1.5.png").write_bytes(data[: len(data) // 2])
    assert next_of(source, 0.05) is None
    (folder / "1.5.png").write_bytes(data)
    arrival = next_of(source)
    assert depth_of(arrival) == pytest.approx(2.0) and not source.skipped
    assert arrival is not None and arrival.frame.time_s == 1.5 and not arrival.was_there
    assert time.monotonic() - 1.0 < arrival.came_s <= time.monotonic()


def test_a_hidden_file_is_on_its_way_and_no_frame(folder: Path) -> None:
    (folder / "1.0.png").write_bytes(png(folder, 1000))
    (folder / ".2.0.png").write_bytes(png(folder, 2000)[:40])
    source = followed(folder)
    first = next_of(source)
    assert depth_of(first) == pytest.approx(1.0) and first is not None and first.was_there
    assert next_of(source, 0.05) is None
    (folder / ".2.0.png").write_bytes(png(folder, 2000))
    (folder / ".2.0.png").rename(folder / "2.0.png")
    assert depth_of(next_of(source)) == pytest.approx(2.0)


def test_a_frame_that_stays_damaged_is_coasted_over_and_listed(folder: Path) -> None:
    for name, value in (("1.0", 1000), ("3.0", 3000)):
        (folder / f"{name}.png").write_bytes(png(folder, value))
    (folder / "2.0.png").write_bytes(png(folder, 2000)[:-20])
    source = followed(folder)
    assert depth_of(next_of(source)) == pytest.approx(1.0)
    blind = next_of(source)
    assert blind is not None and blind.frame.unseen is not None and blind.frame.unseen.all()
    assert depth_of(next_of(source)) == pytest.approx(3.0)
    assert [skipped.time_s for skipped in source.skipped] == [2.0]


def test_a_frame_after_a_later_one_is_left_out_and_said(folder: Path) -> None:
    (folder / "2.0.png").write_bytes(png(folder, 2000))
    source = followed(folder)
    assert depth_of(next_of(source)) == pytest.approx(2.0)
    (folder / "1.0.png").write_bytes(png(folder, 1000))
    (folder / "3.0.png").write_bytes(png(folder, 3000))
    assert depth_of(next_of(source)) == pytest.approx(3.0)
    assert source.remarks == ("1 frames came after later ones and were left out",)


def test_what_stands_before_the_end_mark_is_given_and_nothing_after(folder: Path) -> None:
    for k in (1, 2):
        (folder / f"{k}.0.png").write_bytes(png(folder, 1000 * k))
    (folder / END_FILE).touch()
    source = followed(folder)
    assert [depth_of(next_of(source)) for _ in range(2)] == pytest.approx([1.0, 2.0])
    assert next_of(source) is None and source.has_ended
    one = followed(folder, max_frames=1)
    assert next_of(one) is not None and one.has_ended and next_of(one) is None


def test_a_scene_whose_cameras_are_there_first_waits_for_its_images(folder: Path) -> None:
    (folder / "depth_camera.json").unlink()
    scene = folder / "depth"
    scene.mkdir()
    cameras = {
        str(k): {"cam_K": CAMERA["K"], "depth_scale": 1.0, "timestamp_s": 0.1 * k} for k in range(4)
    }
    (folder / "scene_camera.json").write_text(json.dumps(cameras))
    source = followed(folder)
    assert next_of(source, 0.03) is None and source.why_not is not None
    (scene / "000000.png").write_bytes(png(folder, 1000))
    assert depth_of(next_of(source)) == pytest.approx(1.0)
    assert next_of(source, 0.3) is None
    # The second never comes: that is known once the third is there.
    (scene / "000002.png").write_bytes(png(folder, 3000))
    blind = next_of(source)
    assert blind is not None and blind.frame.index == 1 and blind.frame.depth_m.max() == 0.0
    assert depth_of(next_of(source)) == pytest.approx(3.0)
    (folder / END_FILE).touch()
    assert next_of(source) is None and source.has_ended


def test_a_growing_list_of_cameras_is_read_again(folder: Path) -> None:
    (folder / "depth_camera.json").unlink()
    scene = folder / "depth"
    scene.mkdir()
    cameras: dict[str, object] = {}
    source = followed(folder)
    for k in range(3):
        (scene / f"{k:06d}.png").write_bytes(png(folder, 1000 + k))
        entry = {"cam_K": CAMERA["K"], "depth_scale": 1.0, "timestamp_s": 1.7e9 + k}
        cameras[str(k)] = entry
        text = json.dumps(cameras)
        (folder / "scene_camera.json").write_text(text[: len(text) // 2])
        assert next_of(source, 0.02) is None
        (folder / "scene_camera.json").write_text(text)
        arrival = next_of(source)
        assert arrival is not None and arrival.frame.time_s == float(k)
    assert source.recording is not None and len(source.recording) == 3


def test_images_named_by_their_times_are_added_without_reading_all_again(folder: Path) -> None:
    for k in range(3):
        (folder / f"170000000{k}.5.png").write_bytes(png(folder, 1000 + k))
    opened = []

    def counted() -> Sequence:
        opened.append(1)
        return open_sequence(folder, None, True)

    source = GrowingFolder(folder, counted, RegionTable(), None, with_more)
    for _ in range(3):
        next_of(source)
    count = len(opened)
    for k in range(3, 6):
        (folder / f"170000000{k}.5.png").write_bytes(png(folder, 1000 + k))
        assert depth_of(next_of(source)) == pytest.approx(1.0 + 0.001 * k)
    assert len(opened) == count
    found, whole = source.recording, open_sequence(folder)
    assert found is not None and found.files == whole.files
    for name in ("times_s", "intrinsics", "depth_step_m", "T_cam_world"):
        assert np.array_equal(getattr(found, name), getattr(whole, name)), name
    assert found.info.time_zero_s == whole.info.time_zero_s == 1700000000.5
    # What the names do not tell, the reader does.
    (folder / "1699999999.5.png").write_bytes(png(folder, 900))
    assert next_of(source, 0.1) is None and len(opened) > count
    assert source.remarks == ("1 frames came after later ones and were left out",)
    (folder / "poses.tum").write_text("")
    assert with_more(whole, ["1700000009.5.png"]) is None
