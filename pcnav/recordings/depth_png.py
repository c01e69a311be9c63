"""16-bit depth PNGs: checked on reading, written fast."""

from io import BytesIO
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from pcnav.core.errors import InputError
from pcnav.files.decoding import decoding
from pcnav.files.regular_file import read_bytes

RawDepth = npt.NDArray[np.uint16]
"""(height, width) stored units."""
MAXIMUM_UNITS = 65535
MAX_IMAGE_BYTES = 200_000_000
"""Of a file that holds one image."""
_MAX_PIXELS = 50_000_000
"""Copies of an image are made: ten times as many fill a computer."""

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_END_CHUNK = b"IEND\xaeB`\x82"
_PIXELS = {
    **{"1": "1-bit grey", "L": "8-bit grey", "LA": "grey with alpha", "P": "palette"},
    **{"RGB": "colour", "RGBA": "colour with alpha"},
}
# One byte per sample of noise does not compress: higher levels cost time and save a tenth.
_COMPRESS_LEVEL = 1


def read_depth_png(path: Path) -> RawDepth:
    """Stored units of a depth PNG.

    Raises `InputError` when the file is missing, cut short, damaged, or not 16-bit grey.
    """
    data = read_bytes(path, MAX_IMAGE_BYTES, "a depth PNG")
    if not data.startswith(_SIGNATURE):
        raise InputError(path, "file", "expected a PNG image")
    if data.rfind(_END_CHUNK) < 0:
        raise InputError(path, "file", "expected a whole PNG, but it ends early (cut short)")
    with (
        decoding(path, "an undamaged PNG"),
        Image.open(BytesIO(data), formats=["PNG"]) as image,
    ):
        require_few_pixels(path, image)
        mode, pixels = image.mode, np.asarray(image)
    if mode != "I;16":
        expected = f"expected 16-bit grey depth, got {_PIXELS.get(mode, mode)}"
        raise InputError(path, "pixels", expected)
    return np.asarray(pixels, dtype=np.uint16)


def require_few_pixels(path: Path, image: Image.Image) -> None:
    """Raise `InputError` for an image that was opened, not read yet, and would fill the memory."""
    if image.width * image.height > _MAX_PIXELS:
        got = f"got {image.width} x {image.height}"
        raise InputError(path, "pixels", f"expected at most {_MAX_PIXELS:,}, {got}")


def write_depth_png(path: Path, units: RawDepth) -> None:
    """Write stored units (height, width) as a 16-bit grey PNG."""
    Image.fromarray(units).save(path, "PNG", compress_level=_COMPRESS_LEVEL)
