"""The region of [region] for every frame of a recording: its masks and background are files."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image

from pcnav.config.region import OWN_MASKS, RegionTable
from pcnav.core.arrays import BoolArray
from pcnav.core.errors import InputError
from pcnav.files.decoding import decoding
from pcnav.files.regular_file import read_bytes
from pcnav.recordings.bop_scene import SCENE_GT_FILE, object_places
from pcnav.recordings.depth_png import MAX_IMAGE_BYTES, require_few_pixels
from pcnav.recordings.region import Background, Region
from pcnav.recordings.sequence import Sequence

MASK_FOLDER = "mask_visib"
"""Of a BOP scene: the pixels of each object that can be seen."""


@dataclass(frozen=True)
class RegionOfFrames:
    """What the frames of one recording are restricted to."""

    region: Region
    """What is the same in all frames."""
    masks: Path | None
    """Folder of masks."""
    mask_object: int | None
    """Place of the target among the objects of a frame."""
    places: Mapping[int, int] | None = None
    """The same by the number of a frame, where it differs from frame to frame; None where not."""

    def of(self, sequence: Sequence, index: int) -> Region:
        """The region in one frame. Raises `InputError` for its mask."""
        if self.masks is None:
            return self.region
        name = Path(sequence.files[index]).name.split(".")[0]
        place = self.mask_object
        if self.places is not None:
            place = self.places.get(int(name))
            if place is None:
                expected = f"expected object {sequence.object_id} in the frame, once"
                raise InputError(self.masks, name, expected)
        return replace(self.region, mask=_mask(self.masks, name, place))


def region_of(table: RegionTable, sequence: Sequence) -> RegionOfFrames:
    """What a table says of the frames of a recording.

    Raises `InputError` for a folder of masks that is none and for a background that cannot be read.
    """
    masks = None if table.masks is None else masks_folder(table.masks, sequence.path)
    region = Region(
        min_range_m=table.min_range_m or 0.0,
        max_range_m=table.max_range_m or math.inf,
        box_px=table.box_px,
        background=_background(table.background, sequence),
    )
    places = None
    asked = sequence.object_id
    if table.masks == OWN_MASKS and table.mask_object is None and asked is not None:
        # The masks themselves are part of the truth; nothing but their names is taken from it here.
        places = object_places(sequence.path / SCENE_GT_FILE, asked)
    return RegionOfFrames(region, masks, table.mask_object, places)


def gates_of(table: RegionTable, where: Path | str, hint: str = "") -> Region:
    """The region of frames that lie in no files. Raises `InputError` for masks and background."""
    if table.masks is not None or table.background is not None:
        raise InputError(where, "region", f"expected no masks and no background{hint}")
    far_m = math.inf if table.max_range_m is None else table.max_range_m
    return Region(None, table.min_range_m or 0.0, far_m, table.box_px)


def resolved(table: RegionTable, recording: Path) -> RegionTable:
    """The table with its files as absolute paths. Raises `InputError` for one that is not there."""
    changes: dict[str, str] = {}
    if table.masks is not None and table.masks != OWN_MASKS:
        changes["masks"] = str(masks_folder(table.masks, recording).resolve())
    if table.background is not None:
        changes["background"] = str(Path(table.background).resolve())
    return table.model_copy(update=changes)


def masks_folder(masks: str, recording: Path) -> Path:
    """The folder that `masks` means. Raises `InputError` where it is none."""
    folder = recording / MASK_FOLDER if masks == OWN_MASKS else Path(masks)
    if not folder.is_dir():
        expected = f"expected a folder of masks, or {OWN_MASKS} for {MASK_FOLDER} of the recording"
        raise InputError(folder, "masks", expected)
    return folder


def _mask(folder: Path, name: str, mask_object: int | None) -> BoolArray:
    """(height, width) pixels that the mask of a frame marks."""
    if mask_object is not None:
        return _marked(folder / f"{name}_{mask_object:06d}.png")
    if (folder / f"{name}.png").is_file():
        return _marked(folder / f"{name}.png")
    found = sorted(folder.glob(f"{name}_*.png"))
    if len(found) > 1:
        expected = "expected the mask of one object, or mask_object to say which it is"
        raise InputError(folder, name, f"{expected}; got {found[0].name} to {found[-1].name}")
    return _marked(found[0] if found else folder / f"{name}_000000.png")


def _marked(path: Path) -> BoolArray:
    data = read_bytes(path, MAX_IMAGE_BYTES, "a mask as PNG")
    with (
        decoding(path, "a mask as PNG"),
        Image.open(BytesIO(data), formats=["PNG"]) as image,
    ):
        require_few_pixels(path, image)
        pixels = np.asarray(image.convert("RGB") if image.mode in ("LA", "RGBA") else image)
    marked = pixels != 0
    return np.asarray(marked.any(axis=2) if marked.ndim == 3 else marked)


def _background(file: str | None, sequence: Sequence) -> Background | None:
    if file is None:
        return None
    return Background(sequence.read_depth(Path(file), 0))
