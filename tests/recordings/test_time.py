"""Time stamps as recordings have them: of an epoch, out of order, twice, with gaps."""

import json
import logging
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcnav.core.errors import InputError
from pcnav.core.spatial import make_transform
from pcnav.dynamics.blocks import ATTITUDE, FILE_ORDER, MASS_CENTRE_LAYOUT
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.bop import read_bop
from pcnav.recordings.sequence import SequenceInfo
from pcnav.recordings.time_line import begins_anew, time_line
from pcnav.recordings.truth import read_truth, write_truth

EPOCH_S = 1_732_790_000.125
MakeScene = Callable[..., Path]


def stamp(folder: Path, stamps_s: list[float]) -> None:
    file = folder / "scene_camera.json"
    content = json.loads(file.read_text())
    for entry, time_s in zip(content.values(), stamps_s, strict=True):
        entry["timestamp_s"] = time_s
    file.write_text(json.dumps(content))


def write_poses(folder: Path, distances_mm: dict[int, float]) -> None:
    identity = np.eye(3).ravel().tolist()
    poses: dict[str, Any] = {
        str(number): [{"cam_R_m2c": identity, "cam_t_m2c": [0.0, 0.0, z], "obj_id": 1}]
        for number, z in distances_mm.items()
    }
    (folder / "scene_gt.json").write_text(json.dumps(poses))


def depth_numbers(folder: Path) -> list[int]:
    """Numbers of the images that the frames of a scene come from, by what is in them."""
    return [round(float(frame.depth_m[0, 1]) / 0.0005) - 100 for frame in read_bop(folder)]


@pytest.mark.parametrize("first_s", [EPOCH_S, 7.9e8, -2.2e8])
def test_of_an_epoch_the_first_frame_is_time_zero(
    tmp_path: Path, make_scene: MakeScene, caplog: pytest.LogCaptureFixture, first_s: float
) -> None:
    folder = make_scene(tmp_path / "s")
    stamp(folder, [first_s, first_s + 0.5, first_s + 1.25])
    write_poses(folder, {0: 900.0, 1: 1000.0, 2: 1100.0})
    with caplog.at_level(logging.INFO, logger="pcnav"):
        sequence = read_bop(folder)
    assert [frame.time_s for frame in sequence] == [0.0, 0.5, 1.25]
    assert sequence.info.time_zero_s == first_s
    assert any(f"{first_s:.17g}" in record.getMessage() for record in caplog.records)
    truth = read_truth(folder)
    assert truth is not None
    assert truth.time_s.tolist() == [0.0, 0.5, 1.25]


@pytest.mark.parametrize("first_s", [0.0, 40.0, -3.0, 90_000.0])
def test_a_clock_of_its_own_is_kept(tmp_path: Path, make_scene: MakeScene, first_s: float) -> None:
    folder = make_scene(tmp_path / "s")
    stamp(folder, [first_s, first_s + 0.5, first_s + 1.0])
    sequence = read_bop(folder)
    assert sequence.times_s.tolist() == [first_s, first_s + 0.5, first_s + 1.0]
    assert sequence.info.time_zero_s == 0.0


@pytest.mark.parametrize(("zero", "expected_s"), [("100.0", -60.0), ("0", 40.0)])
def test_the_sequence_may_say_which_stamp_is_zero(
    tmp_path: Path, make_scene: MakeScene, zero: str, expected_s: float
) -> None:
    folder = make_scene(tmp_path / "s", toml=f"[sequence]\ntime_zero_s = {zero}\n")
    stamp(folder, [40.0, 41.0, 42.0])
    assert read_bop(folder).times_s[0] == expected_s
    stamp(folder, [EPOCH_S, EPOCH_S + 1.0, EPOCH_S + 2.0])
    assert read_bop(folder).times_s[0] == EPOCH_S - float(zero)


def test_a_late_start_in_an_orbit_is_doubted(
    tmp_path: Path, make_scene: MakeScene, caplog: pytest.LogCaptureFixture
) -> None:
    head = "[orbit]\nmean_motion_rad_s = 0.0011\n[sensor]\nrange_sigma_m = 0.01\n"
    folder = make_scene(tmp_path / "s", toml=head)
    stamp(folder, [5000.0, 5001.0, 5002.0])
    read_bop(folder)
    assert not caplog.records
    stamp(folder, [6000.0, 6001.0, 6002.0])
    read_bop(folder)
    assert "time_zero_s says which stamp is time 0" in caplog.records[0].getMessage()


def test_truth_csv_is_counted_from_the_same_zero(tmp_path: Path, make_scene: MakeScene) -> None:
    folder = make_scene(tmp_path / "s")
    stamps_s = EPOCH_S + np.array([0.0, 0.1, 0.3])
    stamp(folder, stamps_s.tolist())
    values = {block.name: np.ones((3, len(block.columns))) for block in FILE_ORDER}
    values[ATTITUDE.name] = np.tile(np.eye(3), (3, 1, 1))
    T = np.tile(make_transform(np.eye(3), np.array([0.0, 0.0, 1.0])), (3, 1, 1))
    write_truth(folder, Trajectory(stamps_s, MASS_CENTRE_LAYOUT, values, T_cam_target=T))
    alone = read_truth(folder)
    assert alone is not None
    np.testing.assert_array_equal(alone.time_s, read_bop(folder).times_s)
    write_poses(folder, {0: 1000.0, 1: 1000.0, 2: 1000.0})
    both = read_truth(folder)
    assert both is not None
    np.testing.assert_array_equal(both.time_s, alone.time_s)


def test_frames_out_of_order_are_sorted_with_their_truth(
    tmp_path: Path, make_scene: MakeScene, caplog: pytest.LogCaptureFixture
) -> None:
    folder = make_scene(tmp_path / "s", tuple(range(5)))
    stamp(folder, [0.0, 0.2, 0.1, 0.3, 0.4])
    write_poses(folder, {0: 900.0, 1: 910.0, 2: 920.0, 4: 940.0})
    assert depth_numbers(folder) == [0, 2, 1, 3, 4]
    assert "1 of 5 frames come before the one they follow: sorted" in caplog.text
    assert read_bop(folder).times_s.tolist() == [0.0, 0.1, 0.2, 0.3, 0.4]
    truth = read_truth(folder)
    assert truth is not None and truth.T_cam_target is not None
    assert truth.time_s.tolist() == [0.0, 0.1, 0.2, 0.4]
    np.testing.assert_allclose(truth.T_cam_target[:, 2, 3], [0.9, 0.92, 0.91, 0.94])


def test_of_frames_with_one_stamp_the_first_is_kept(
    tmp_path: Path, make_scene: MakeScene, caplog: pytest.LogCaptureFixture
) -> None:
    folder = make_scene(tmp_path / "s", tuple(range(5)))
    stamp(folder, [0.0, 0.1, 0.1, 0.1, 0.2])
    write_poses(folder, {k: 900.0 + k for k in range(5)})
    assert depth_numbers(folder) == [0, 1, 4]
    words = "2 frames with the time stamp of another left out, the first is frame 2"
    assert words in caplog.text
    truth = read_truth(folder)
    assert truth is not None and truth.T_cam_target is not None
    assert truth.time_s.tolist() == [0.0, 0.1, 0.2]
    np.testing.assert_allclose(truth.T_cam_target[:, 2, 3], [0.9, 0.901, 0.904])


def test_gaps_are_told() -> None:
    time_s = np.concatenate([np.arange(10) * 0.1, 3.0 + np.arange(10) * 0.1])
    numbers = np.arange(20)
    assert time_line(time_s, numbers).remarks == ("a gap of 2.1 s before frame 10",)
    time_s = np.concatenate([time_s, 10.0 + time_s])
    remarks = time_line(time_s, np.arange(40)).remarks
    assert remarks == ("3 gaps, the longest of 6.1 s before frame 20",)
    jitter = np.arange(50) * 0.1 + np.random.default_rng(0).uniform(-0.04, 0.04, 50)
    assert time_line(jitter, np.arange(50)).remarks == ()


def test_a_clock_that_begins_anew_is_no_disorder(tmp_path: Path, make_scene: MakeScene) -> None:
    rising = np.arange(40) * 0.1
    assert begins_anew(np.concatenate([rising, rising])) == 40
    assert begins_anew(np.concatenate([rising, rising[20:] + 0.05])) == 40
    disorders: list[np.ndarray] = [
        rising,
        rising[::-1],
        np.concatenate([rising[20:], rising[:20]]),
        np.random.default_rng(1).permutation(rising),
        np.concatenate([rising[:20], [rising[17] + 0.05], rising[20:]]),
    ]
    for harmless in disorders:
        assert begins_anew(harmless) is None
    folder = make_scene(tmp_path / "s", tuple(range(40)))
    stamp(folder, [*rising[:20].tolist(), *rising[:20].tolist()])
    with pytest.raises(InputError, match=r"20\.timestamp_s: expected the stamps of one clock"):
        read_bop(folder)


def test_other_units_than_seconds_are_refused(tmp_path: Path, make_scene: MakeScene) -> None:
    folder = make_scene(tmp_path / "s")
    for unit in (1e3, 1e6, 1e9):
        stamp(folder, [unit * (EPOCH_S + k) for k in range(3)])
        with pytest.raises(InputError, match=r"0\.timestamp_s: expected seconds"):
            read_bop(folder)


def test_time_zero_of_a_recording_is_no_number_less() -> None:
    info = SequenceInfo("mine", 0.0, None, None)
    assert replace(info, time_zero_s=EPOCH_S).time_zero_s == EPOCH_S
