"""Frames on their way into an estimator: damaged, missing and repeated ones among them."""

import csv
from collections.abc import Callable
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pcnav.config.region import RegionTable
from pcnav.core.errors import InputError
from pcnav.recordings.bop import read_bop
from pcnav.recordings.intake import Intake, skipped_frames_csv
from pcnav.recordings.sequence import Frame

MakeScene = Callable[..., Path]
EVERYTHING = RegionTable()


def is_blind(frame: Frame) -> bool:
    return frame.unseen is not None and bool(frame.unseen.all()) and not frame.depth_m.any()


def test_a_damaged_frame_ends_a_run_unless_it_may_be_skipped(
    tmp_path: Path, make_scene: MakeScene
) -> None:
    folder = make_scene(tmp_path / "s", tuple(range(5)))
    image = folder / "depth" / "000002.png"
    image.write_bytes(image.read_bytes()[:40])
    frames = iter(Intake(read_bop(folder), EVERYTHING, skip_bad_frames=False))
    assert [next(frames).index, next(frames).index] == [0, 1]
    with pytest.raises(InputError, match=r"cut short\); --skip-bad-frames coasts over it") as found:
        next(frames)
    assert found.value.file == image
    intake = Intake(read_bop(folder, skip_bad_frames=True), EVERYTHING, skip_bad_frames=True)
    given = list(intake)
    assert [frame.index for frame in given] == [0, 1, 2, 3, 4]
    assert [frame.time_s for frame in given] == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert [is_blind(frame) for frame in given] == [False, False, True, False, False]
    assert [skipped.index for skipped in intake.skipped] == [2]
    assert intake.remarks == ("1 of 5 frames could not be read and were coasted over: 2",)
    rows = list(csv.DictReader(StringIO(skipped_frames_csv(intake.skipped))))
    assert (rows[0]["frame"], rows[0]["time_s"]) == ("2", "1.0")
    assert "cut short" in rows[0]["fault"]


def test_the_first_may_be_damaged_and_others_missing(tmp_path: Path, make_scene: MakeScene) -> None:
    folder = make_scene(tmp_path / "s", tuple(range(4)))
    (folder / "depth" / "000000.png").write_bytes(b"")
    (folder / "depth" / "000003.png").unlink()
    Image.fromarray(np.ones((7, 8), np.uint16)).save(folder / "depth" / "000001.png")
    with pytest.raises(InputError, match=r"000003\.png: file: expected the depth image"):
        read_bop(folder)
    # The size is that of the first good image.
    sequence = read_bop(folder, skip_bad_frames=True)
    assert sequence.size == (8, 7)
    Image.fromarray(np.ones((6, 8), np.uint16)).save(folder / "depth" / "000001.png")
    sequence = read_bop(folder, skip_bad_frames=True)
    blind = [is_blind(frame) for frame in Intake(sequence, EVERYTHING, skip_bad_frames=True)]
    assert blind == [True, False, False, True]


def test_frames_that_are_all_bad_are_an_error(tmp_path: Path, make_scene: MakeScene) -> None:
    folder = make_scene(tmp_path / "s")
    sequence = read_bop(folder)
    for image in (folder / "depth").iterdir():
        image.write_bytes(b"")
    with pytest.raises(InputError, match="expected a PNG image"):
        read_bop(folder, skip_bad_frames=True)
    with pytest.raises(InputError, match="frames: expected at least one good frame"):
        list(Intake(sequence, EVERYTHING, skip_bad_frames=True))


def write_images(folder: Path, images: list[np.ndarray]) -> None:
    for k, image in enumerate(images):
        Image.fromarray(image.astype(np.uint16)).save(folder / "depth" / f"{k:06d}.png")


def test_an_image_that_comes_twice_is_told(tmp_path: Path, make_scene: MakeScene) -> None:
    rng = np.random.default_rng(1)
    fresh = [rng.integers(1000, 1100, (6, 8)) for _ in range(4)]
    folder = make_scene(tmp_path / "s", tuple(range(6)))
    write_images(folder, [fresh[0], fresh[1], fresh[1], fresh[1], fresh[2], fresh[3]])
    intake = Intake(read_bop(folder), EVERYTHING, skip_bad_frames=False)
    assert not any(is_blind(frame) for frame in intake)
    assert intake.repeated == (2, 3)
    words = "2 of 6 frames brought the image of the frame before once more: 2, 3"
    assert intake.remarks == (words,)


@pytest.mark.parametrize("value", [0, 1000])
def test_a_scene_that_stands_still_without_noise_is_no_repetition(
    tmp_path: Path, make_scene: MakeScene, value: int
) -> None:
    folder = make_scene(tmp_path / "s", tuple(range(4)))
    write_images(folder, [np.full((6, 8), value)] * 4)
    intake = Intake(read_bop(folder), EVERYTHING, skip_bad_frames=False)
    assert not any(is_blind(frame) for frame in intake)
    assert not intake.repeated
    assert not intake.remarks


def test_frames_are_restricted_and_a_bad_mask_is_a_bad_frame(
    tmp_path: Path, make_scene: MakeScene
) -> None:
    folder = make_scene(tmp_path / "s", (0, 1))
    mask = np.zeros((6, 8), dtype=np.uint8)
    mask[2, 3] = 1
    (folder / "mask_visib").mkdir()
    Image.fromarray(mask).save(folder / "mask_visib" / "000000_000000.png")
    region, sequence = RegionTable(masks="visib"), read_bop(folder)
    with pytest.raises(InputError, match="expected a mask as PNG"):
        list(Intake(sequence, region, skip_bad_frames=False))
    first, second = Intake(sequence, region, skip_bad_frames=True)
    assert np.argwhere(first.depth_m).tolist() == [[2, 3]]
    assert is_blind(second)
