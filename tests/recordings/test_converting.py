"""``pcnav convert`` and ``pcnav info``: what a recording holds stays, and is told."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pcnav.core.spatial import rotation_from_xyzw
from pcnav.recordings.opening import open_sequence
from pcnav.recordings.time_doubts import time_doubts
from pcnav.recordings.truth import STATE_COLUMNS, read_truth
from pcnav.report.recording_info import recording_info
from pcnav.target.satellite import Target
from tests.commands import Pcnav
from tests.recordings.other_formats import Scene, as_npz, as_tum, write_bag


@pytest.fixture
def with_truth(scene: Path) -> Path:
    """The small scene with poses and states."""
    R = rotation_from_xyzw(np.array([0.0, 0.0, 0.6, 0.8])).ravel().tolist()
    poses = {
        str(k): [{"cam_R_m2c": R, "cam_t_m2c": [1.0, 2.0, 1000.0 + k], "obj_id": 1}]
        for k in range(3)
    }
    (scene / "scene_gt.json").write_text(json.dumps(poses))
    rows = [
        ",".join(map(repr, [0.5 * k, *[0.1] * 6, 0.0, 0.0, 0.6, 0.8, *[0.2] * 11]))
        for k in range(3)
    ]
    (scene / "truth.csv").write_text("\n".join([",".join(STATE_COLUMNS), *rows]) + "\n")
    return scene


def test_our_own_stays_what_it_is(pcnav: Pcnav, with_truth: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    answer = pcnav("convert", with_truth, "-o", copy)
    assert answer.code == 0, answer
    assert "3 frames, 0.5 mm a unit" in answer.out
    before, after = open_sequence(with_truth), open_sequence(copy)
    for a, b in zip(before, after, strict=True):
        assert np.array_equal(a.depth_m, b.depth_m)
        assert np.array_equal(a.T_cam_world, b.T_cam_world)
        assert (a.time_s, a.camera) == (b.time_s, b.camera)
    # The folder's own name apart.
    assert replace(before.info, name="") == replace(after.info, name="")
    then, now = read_truth(with_truth), read_truth(copy)
    assert then is not None
    assert now is not None
    assert np.allclose(then.poses, now.poses, atol=1e-15)
    assert then.values.keys() == now.values.keys()
    for name, values in then.values.items():
        assert np.allclose(values, now.values[name], atol=1e-15)


@pytest.mark.parametrize(
    ("write", "step_m"),
    [
        (lambda scene, folder: as_npz(scene, folder.with_suffix(".npz")), 0.0),
        (as_tum, 0.0),
        # Floats are stored in steps of 0.1 mm.
        (lambda scene, folder: write_bag(scene, folder.with_suffix(".mcap")), 1e-4),
    ],
)
def test_recordings_of_others_become_ours(
    write: Callable[[Scene, Path], Path], step_m: float, pcnav: Pcnav, scene: Path, tmp_path: Path
) -> None:
    other, out = write(Scene(scene), tmp_path / "other"), tmp_path / "ours"
    assert pcnav("convert", other, "-o", out, "--target", "boxsat").code == 0
    assert (out / "boxsat.obj").is_file()
    for a, b in zip(open_sequence(other), open_sequence(out), strict=True):
        assert np.abs(a.depth_m - b.depth_m).max() <= 0.5 * step_m + 1e-6
        assert np.allclose(a.T_cam_world, b.T_cam_world, atol=1e-15)
        assert b.time_s == pytest.approx(a.time_s, abs=1e-6)


def test_chosen_frames_are_converted_with_their_truth(
    pcnav: Pcnav, with_truth: Path, tmp_path: Path
) -> None:
    out = tmp_path / "some"
    assert pcnav("convert", with_truth, "-o", out, "--start", "1", "--every", "2").code == 0
    found, truth = open_sequence(out), read_truth(out)
    assert found.times_s.tolist() == [0.5]
    assert truth is not None
    assert truth.poses[:, 2, 3].tolist() == [1.001]
    again = pcnav("convert", with_truth, "-o", out)
    assert again.code == 2
    assert "new folder" in again.err
    assert pcnav("convert", with_truth, "-o", with_truth, "--overwrite").code == 2
    (with_truth / "depth" / "000001.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    bad = pcnav("convert", with_truth, "-o", tmp_path / "bad")
    assert bad.code == 2
    assert not (tmp_path / "bad").exists()
    skipped = pcnav("convert", with_truth, "-o", tmp_path / "bad", "--skip-bad-frames")
    assert skipped.code == 0
    assert "1 frames that cannot be read were left out" in skipped.err
    left = read_truth(tmp_path / "bad")
    assert left is not None
    assert left.time_s.tolist() == [0.0, 1.0]


def test_info_tells_what_is_there(pcnav: Pcnav, with_truth: Path, tmp_path: Path) -> None:
    png = tmp_path / "first.png"
    answer = pcnav("info", with_truth, "--png", png)
    assert answer.code == 0, answer
    told = dict(line.split("  ", 1) for line in answer.out.splitlines() if "  " in line)
    told = {key.strip(): value.strip() for key, value in told.items()}
    assert told["format"] == "BOP scene (depth)"
    assert (told["frames"], told["truth"]) == ("3", "yes")
    assert told["time"] == "0 to 1 s"
    assert told["rate"].startswith("2.00 frames/s")
    assert told["fx, fy, cx, cy"] == "20, 21, 3.5, 2.5 px"
    assert told["camera's pose"] == "at rest, or not recorded"
    assert told["range noise"] == "0.0200 m"
    assert png.read_bytes().startswith(b"\x89PNG")
    assert pcnav("info", with_truth, "--png", png).code == 2


def shots(path: Path, depth: np.ndarray, cx: float = 39.5, **more: Any) -> Path:
    """A recording of 80 x 60 px."""
    K = np.array([[100.0, 0.0, cx], [0.0, 100.0, 29.5], [0.0, 0.0, 1.0]])
    np.savez(path, allow_pickle=False, depth=depth, K=K, **more)
    return path


def square(size_m: float, range_m: float, frames: int = 6) -> np.ndarray:
    """A plate seen face on by shots' camera."""
    depth = np.zeros((frames, 60, 80), dtype=np.float32)
    half = 0.5 * 100.0 * size_m / range_m
    rows, columns = np.abs(np.arange(60) - 29.5) < half, np.abs(np.arange(80) - 39.5) < half
    noise = np.random.default_rng(0).normal(0.0, 0.002, depth.shape).astype(np.float32)
    depth[:, rows[:, None] & columns] = range_m
    return np.where(depth > 0.0, depth + noise, 0.0).astype(np.float32)


@pytest.mark.parametrize(
    ("depth", "more", "words"),
    [
        (square(5.0, 20.0), {}, ()),
        (1000.0 * square(5.0, 20.0), {}, ("are they millimetres?",)),
        (square(5.0, 20.0), {"cx": 79.0}, ("principal point", "another image size")),
        (square(5.0, 20.0)[[0, 1, 1, 2, 3, 4]], {}, ("1 frames bring the image",)),
        (square(40.0, 90.0), {}, ("the mesh as it was read", "--mesh-unit")),
        (square(5.0, 20.0), {"time_s": [0.0, 1.0, 2.0, 3.0, 6.0, 7.0]}, ("1 gaps", "2 frames")),
    ],
)
def test_info_doubts_what_is_wrong_and_nothing_else(
    depth: np.ndarray, more: dict[str, Any], words: tuple[str, ...], boxsat: Target, tmp_path: Path
) -> None:
    more = {"time_s": np.arange(len(depth)) / 4.0, **more}
    sequence = open_sequence(shots(tmp_path / "a.npz", depth, **more))
    doubts = recording_info(sequence, "npz", boxsat).doubts
    if not words:
        assert not doubts
    for word in words:
        assert any(word in doubt for doubt in doubts), (word, doubts)


def test_info_of_frames_without_a_return_and_of_another_kind(pcnav: Pcnav, tmp_path: Path) -> None:
    path = shots(tmp_path / "a.npz", np.zeros((2, 60, 80), dtype=np.float32))
    answer = pcnav("info", path, "--png", tmp_path / "a.png")
    assert answer.code == 0, answer
    assert "2 of 2 frames are without any return" in answer.err
    (tmp_path / "attitudes.csv").write_text("time_s,q_x,q_y,q_z,q_w\n0,0,0,0,1\n1,0,0,0,1\n")
    turns = pcnav("info", tmp_path / "attitudes.csv")
    assert turns.code == 0, turns
    assert "attitudes" in turns.out
    refused = pcnav("info", tmp_path / "attitudes.csv", "--png", tmp_path / "b.png")
    assert refused.code == 2
    assert pcnav("info", tmp_path / "nothing").code == 2


def test_time_stamps_that_were_rounded_or_set_on_arrival() -> None:
    exact = np.arange(40) / 30.0
    assert time_doubts(exact) == ()
    assert time_doubts(exact + 1e-4 * np.random.default_rng(0).standard_normal(40)) == ()
    (rounded,) = time_doubts(np.floor(np.arange(40) * 1.3) / 10.0)
    assert "rounded to 0.1 s" in rounded
    late = exact + np.random.default_rng(0).uniform(0.0, 0.008, 40)
    (uneven,) = time_doubts(np.sort(late))
    assert "uneven steps" in uneven
    (lost,) = time_doubts(np.delete(exact, [10, 11, 20]))
    assert "2 gaps, as if 3 frames were lost" in lost
