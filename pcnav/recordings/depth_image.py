"""Depth images of every format that is read: the suffix of the file decides.

.png          16-bit grey
.tif, .tiff   16-bit or 32-bit grey, integers or floats
.npy          any array of integers or floats
.exr          one channel of floats; needs the extra `formats`
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from PIL import Image

from pcnav.core._extras import openexr
from pcnav.core.errors import InputError
from pcnav.files.decoding import decoding
from pcnav.files.npy_header import read_npy_header
from pcnav.files.regular_file import read_bytes
from pcnav.recordings.depth_png import MAX_IMAGE_BYTES, read_depth_png, require_few_pixels

StoredDepth = npt.NDArray[Any]
"""(height, width) stored units, integers or floats."""


class ImageSize(NamedTuple):
    """Pixels."""

    width: int
    height: int


_GREY_MODES = ("I;16", "I;16B", "I;16L", "I;16N", "I", "F")
_CHANNEL_NAMES = ("z", "depth")
"""Last parts of the names of an EXR's channels that hold depth, in small letters."""


def read_depth_image(path: Path) -> StoredDepth:
    """Stored depth of one image.

    Raises `InputError` when the file is missing, cut short, damaged, of an unknown suffix, or not
    one plane of depth.
    """
    read = _READERS.get(path.suffix.lower())
    if read is None:
        raise InputError(path, "file", f"expected a depth image ({', '.join(SUFFIXES)})")
    stored = read(path)
    if stored.ndim == 3 and stored.shape[2] == 1:
        stored = stored[..., 0]
    if stored.ndim != 2 or 0 in stored.shape:
        shape = " x ".join(str(n) for n in stored.shape)
        raise InputError(path, "pixels", f"expected one plane of depth, got an array of {shape}")
    if stored.dtype.kind not in "uif":
        raise InputError(path, "pixels", f"expected integers or floats, got {stored.dtype}")
    return stored


def first_size(folder: Path, files: Sequence[str], skip_bad: bool = False) -> ImageSize:
    """Size of the first of some images in a folder; with ``skip_bad`` of the first good one.

    Raises `InputError` as `read_depth_image` does, for the first of them.
    """
    failure: InputError | None = None
    for file in files:
        try:
            return size_of(read_depth_image(folder / file))
        except InputError as error:
            failure = failure or error
            if not skip_bad:
                break
    assert failure is not None, "there is a file"
    raise failure


def size_of(stored: StoredDepth) -> ImageSize:
    """Size of an image that was read."""
    return ImageSize(stored.shape[1], stored.shape[0])


def require_size(path: Path, stored: StoredDepth, size: ImageSize) -> None:
    """Raises `InputError` where an image has another size than those before it."""
    if size_of(stored) != size:
        expected = f"expected {size.width} x {size.height} px as in the first frame"
        got = f"got {stored.shape[1]} x {stored.shape[0]}"
        raise InputError(path, "image size", f"{expected}, {got}")


def image_of(folder: Path, stem: str, present: set[str]) -> str | None:
    """Name of the one depth image of a stem among the files of a folder; None where there is none.

    Raises `InputError` where there are several: one of them may be a preview.
    """
    found = [stem + suffix for suffix in SUFFIXES if stem + suffix in present]
    if len(found) > 1:
        expected = f"expected one depth image of each frame, got {' and '.join(found)}"
        raise InputError(folder, stem, expected)
    return found[0] if found else None


def _bytes(path: Path) -> bytes:
    return read_bytes(path, MAX_IMAGE_BYTES, "a depth image")


def _read_tiff(path: Path) -> StoredDepth:
    data = _bytes(path)
    # Pillow warns of damaged tags; those that matter make it raise.
    with (
        warnings.catch_warnings(action="ignore"),
        decoding(path, "an undamaged TIFF"),
        Image.open(BytesIO(data), formats=["TIFF"]) as image,
    ):
        require_few_pixels(path, image)
        mode, pixels = image.mode, np.asarray(image)
    if mode not in _GREY_MODES:
        expected = "expected one plane of 16-bit or 32-bit depth"
        raise InputError(path, "pixels", f"{expected}, got pixels of the kind {mode}")
    return pixels


def _read_npy(path: Path) -> StoredDepth:
    data = _bytes(path)
    stream = BytesIO(data)
    try:
        # The header is read alone first: an array that the file does not hold is never allocated.
        shape, _, dtype = read_npy_header(stream)
        if prod(shape) * dtype.itemsize > len(data) - stream.tell():
            raise ValueError("it ends early")
        stream.seek(0)
        return np.asarray(np.load(stream, allow_pickle=False))
    except (ValueError, EOFError, OverflowError) as error:
        raise InputError(path, "file", f"expected an undamaged NPY array ({error})") from error


def _read_exr(path: Path) -> StoredDepth:
    exr = openexr(f"depth images like {path.name}")
    # It knows but one error, and opens a file that is not there as if it were damaged.
    _bytes(path)
    with (
        decoding(path, "an undamaged EXR"),
        exr.File(str(path), separate_channels=True) as file,
    ):
        # Closing the file takes its header and pixels with it.
        header = dict(file.header())
        planes = {name: np.array(c.pixels) for name, c in file.channels().items()}
    return _whole_window(path, _depth_channel(path, planes), header)


def _depth_channel(path: Path, planes: Mapping[str, StoredDepth]) -> StoredDepth:
    """The channel of an EXR that holds depth: the only one, the one named so, or equal colours."""
    if len(planes) == 1:
        return next(iter(planes.values()))
    named = [
        plane
        for name, plane in planes.items()
        if any(part in _CHANNEL_NAMES for part in name.lower().split(".")[-1:])
    ]
    if len(named) == 1:
        return named[0]
    colours = [planes[name] for name in "RGB" if name in planes]
    if len(colours) == 3 and all(np.array_equal(c, colours[0], equal_nan=True) for c in colours):
        return colours[0]
    expected = "expected one channel, one named Z or depth, or R, G and B alike"
    raise InputError(path, "channels", f"{expected}; got {', '.join(sorted(planes))}")


def _whole_window(path: Path, plane: StoredDepth, header: Mapping[str, Any]) -> StoredDepth:
    """The whole image: an EXR may store no more of it than the window that holds data."""
    (left, top), (right, bottom) = (np.asarray(c).astype(int) for c in header["displayWindow"])
    (u, v), _ = (np.asarray(corner).astype(int) for corner in header["dataWindow"])
    height, width = bottom - top + 1, right - left + 1
    if plane.shape == (height, width) and (u, v) == (left, top):
        return plane
    row, column = v - top, u - left
    if min(row, column) < 0 or row + plane.shape[0] > height or column + plane.shape[1] > width:
        raise InputError(path, "dataWindow", "expected a window of data inside the image")
    whole = np.zeros((height, width), dtype=plane.dtype)
    whole[row : row + plane.shape[0], column : column + plane.shape[1]] = plane
    return whole


_READERS: Mapping[str, Callable[[Path], StoredDepth]] = {
    ".png": read_depth_png,
    ".npy": _read_npy,
    ".tiff": _read_tiff,
    ".tif": _read_tiff,
    ".exr": _read_exr,
}
SUFFIXES = tuple(_READERS)
"""Of the files that are read as depth images."""
