"""Frames restricted to what a user knows may be the target."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pcnav.config.region import RegionTable
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.recordings.bop import read_bop
from pcnav.recordings.region import Background, Region, restricted
from pcnav.recordings.region_files import region_of, resolved
from pcnav.recordings.sequence import Frame

CAMERA = PinholeCamera(160, 120, 120.0, 125.0, 79.5, 59.5)
MakeScene = Callable[..., Path]


def frame_of(depth_m: np.ndarray) -> Frame:
    return Frame(3, 1.5, depth_m.astype(np.float32), CAMERA, np.eye(4))


def test_nothing_asked_for_changes_nothing() -> None:
    frame = frame_of(np.full((120, 160), 2.0))
    assert restricted(frame, Region()) is frame


def test_gates_count_along_the_ray() -> None:
    # A wall at z = 2 m: its range grows from 2 m at the axis to 2.6 m in the corners.
    depth_m = np.full((120, 160), 2.0)
    depth_m[0, 0] = 0.0
    v, u = np.mgrid[:120, :160]
    range_m = 2.0 * np.sqrt(1.0 + ((u - 79.5) / 120.0) ** 2 + ((v - 59.5) / 125.0) ** 2)
    frame = restricted(frame_of(depth_m), Region(min_range_m=2.05, max_range_m=2.4))
    kept = (range_m >= 2.05) & (range_m <= 2.4)
    kept[0, 0] = False
    np.testing.assert_array_equal(frame.depth_m > 0.0, kept)
    assert frame.unseen is not None
    # Behind the far gate nothing is; in front of the near one nobody knows.
    np.testing.assert_array_equal(frame.unseen, range_m < 2.05)


def test_outside_the_box_nothing_is_known() -> None:
    depth_m = np.full((120, 160), 2.0)
    depth_m[50, 60] = 0.0
    already = np.zeros((120, 160), dtype=bool)
    already[40, 50] = True
    frame = restricted(
        replace(frame_of(depth_m), unseen=already), Region(box_px=(40, 30, 100, 200))
    )
    assert frame.unseen is not None
    expected = np.ones((120, 160), dtype=bool)
    expected[30:, 40:100] = False
    expected[40, 50] = True
    np.testing.assert_array_equal(frame.unseen, expected)
    assert np.count_nonzero(frame.depth_m) == 90 * 60 - 2
    with pytest.raises(InputError, match=r"frame 3: box_px: .* 160 x 120, got 160 0 170 9"):
        restricted(frame_of(depth_m), Region(box_px=(160, 0, 170, 9)))


def test_outside_the_mask_nothing_is() -> None:
    mask = np.zeros((120, 160), dtype=bool)
    mask[10:20, 10:30] = True
    given = frame_of(np.full((120, 160), 2.0))
    frame = restricted(given, Region(mask=mask))
    assert frame.unseen is None
    np.testing.assert_array_equal(frame.depth_m > 0.0, mask)
    assert given.depth_m.all()
    with pytest.raises(InputError, match=r"frame 3: mask: expected 120 rows of 160"):
        restricted(given, Region(mask=mask[1:]))
    with pytest.raises(InputError, match=r"frame 3: mask: expected truth values"):
        restricted(given, Region(mask=mask.astype(np.uint8)))


def scene_m() -> np.ndarray:
    """A wall behind a table that rises towards it, and a box on the table that is nearer."""
    v, _ = np.mgrid[:120, :160]
    depth_m = np.full((120, 160), 4.0)
    table = v > 60
    depth_m[table] = 4.0 - 3.0 * (v[table] - 60) / 60.0
    depth_m[:, 120:] = np.minimum(depth_m[:, 120:], 2.5)
    return depth_m


def noisy(depth_m: np.ndarray, rng: np.random.Generator, kind: str) -> np.ndarray:
    """As sensors see it: noise that grows with the square of range, steps of disparity, or none."""
    if kind == "quadratic":
        return np.asarray(depth_m + 0.002 * depth_m**2 * rng.standard_normal(depth_m.shape))
    if kind == "disparity":
        disparity = np.rint(8.0 * (600.0 / depth_m + 0.1 * rng.standard_normal(depth_m.shape)))
        return np.asarray(600.0 * 8.0 / disparity)
    return depth_m


@pytest.mark.parametrize("kind", ["quadratic", "disparity", "none"])
@pytest.mark.parametrize("size", [20, 55])
def test_the_background_goes_and_the_target_stays(kind: str, size: int) -> None:
    rng = np.random.default_rng(2)
    background = scene_m()
    target = np.zeros((120, 160), dtype=bool)
    target[60 - size : 60 + size, 80 - size : 80 + size] = True
    # The target stands off by some margins: at 4 m the noise of the difference is 45 mm.
    shown = np.where(target, np.minimum(background - 0.3, 3.2), background)
    seen = frame_of(noisy(shown, rng, kind))
    holes = rng.random((120, 160)) < 0.02
    empty = noisy(background, rng, kind).astype(np.float32)
    empty[holes] = 0.0
    frame = restricted(seen, Region(background=Background(empty)))
    left = frame.depth_m > 0.0
    assert frame.unseen is None
    comparable = ~holes
    assert np.count_nonzero(left & ~target & comparable) < 0.004 * np.count_nonzero(~target)
    assert np.count_nonzero(left & target) > 0.96 * np.count_nonzero(target)
    # Where the background has no return, none is taken for it.
    assert left[holes].all()


def test_a_table_of_a_region_refuses_what_makes_no_sense() -> None:
    for fault in (
        {"min_range_m": 2.0, "max_range_m": 1.0},
        {"box_px": (5, 0, 5, 9)},
        {"box_px": (-1, 0, 5, 9)},
        {"mask_object": 1},
        {"mask": "visib"},
    ):
        with pytest.raises(ValueError, match=next(iter(fault))):
            RegionTable.model_validate(fault)


def save_mask(path: Path, mask: np.ndarray, mode: str = "L") -> None:
    path.parent.mkdir(exist_ok=True)
    Image.fromarray((mask * 255).astype(np.uint8)).convert(mode).save(path)


@pytest.mark.parametrize("mode", ["L", "1", "P", "RGB", "RGBA"])
def test_masks_by_either_name_and_of_any_pixels(
    tmp_path: Path, make_scene: MakeScene, mode: str
) -> None:
    sequence = read_bop(make_scene(tmp_path / "s", (4, 7)))
    mask = np.zeros((6, 8), dtype=bool)
    mask[2, 3] = mask[5, 0] = True
    save_mask(tmp_path / "masks" / "000004.png", mask, mode)
    save_mask(tmp_path / "masks" / "000007_000000.png", ~mask, mode)
    region = region_of(RegionTable(masks=str(tmp_path / "masks")), sequence)
    for index, expected in ((0, mask), (1, ~mask)):
        found = region.of(sequence, index)
        np.testing.assert_array_equal(found.mask, expected)


def test_masks_of_several_objects_and_of_none(tmp_path: Path, make_scene: MakeScene) -> None:
    folder = make_scene(tmp_path / "s", (0, 1))
    sequence = read_bop(folder)
    with pytest.raises(InputError, match="masks: expected a folder of masks, or visib"):
        region_of(RegionTable(masks="visib"), sequence)
    masks = [np.zeros((6, 8), dtype=bool) for _ in range(2)]
    masks[1][3, 3] = True
    for k, mask in enumerate(masks):
        save_mask(folder / "mask_visib" / f"000000_00000{k}.png", mask)
    with pytest.raises(InputError, match="expected the mask of one object, or mask_object"):
        region_of(RegionTable(masks="visib"), sequence).of(sequence, 0)
    second = region_of(RegionTable(masks="visib", mask_object=1), sequence)
    np.testing.assert_array_equal(second.of(sequence, 0).mask, masks[1])
    with pytest.raises(InputError, match=r"000001_000001\.png: file: expected a mask as PNG"):
        second.of(sequence, 1)
    (folder / "mask_visib" / "000001_000001.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(InputError, match="expected a mask as PNG"):
        second.of(sequence, 1)


def test_files_of_a_region_are_stated_in_full(
    tmp_path: Path, make_scene: MakeScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = make_scene(tmp_path / "s")
    (tmp_path / "m").mkdir()
    monkeypatch.chdir(tmp_path)
    found = resolved(RegionTable(masks="m", background="b.png"), folder)
    assert (found.masks, found.background) == (str(tmp_path / "m"), str(tmp_path / "b.png"))
    own = RegionTable(masks="visib")
    assert resolved(own, folder) == own
    with pytest.raises(InputError, match="masks: expected a folder"):
        resolved(RegionTable(masks="none"), folder)


def test_a_background_has_the_form_of_the_recording(tmp_path: Path, make_scene: MakeScene) -> None:
    folder = make_scene(tmp_path / "s", (0,))
    sequence = read_bop(folder)
    image = folder / "depth" / "000000.png"
    region = region_of(RegionTable(background=str(image)), sequence).of(sequence, 0)
    assert region.background is not None
    np.testing.assert_array_equal(region.background.depth_m, sequence.frame(0).depth_m)
    assert not restricted(sequence.frame(0), region).depth_m.any()
    Image.fromarray(np.ones((5, 8), np.uint16)).save(tmp_path / "other.png")
    with pytest.raises(InputError, match="8 x 6 px"):
        region_of(RegionTable(background=str(tmp_path / "other.png")), sequence)
