"""16-bit depth PNGs: checked on reading, written fast."""

import struct
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from PIL import Image

from pcnav.core.errors import InputError

RawDepth = npt.NDArray[np.uint16]
"""(height, width) stored units."""
MAXIMUM_UNITS = 65535

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_HEADER_BYTES = 33
_END_CHUNK = b"IEND\xaeB`\x82"
_COLOUR_TYPES = {0: "grey", 2: "colour", 3: "palette", 4: "grey with alpha", 6: "colour with alpha"}
# One byte per sample of noise does not compress: higher levels cost time and save a tenth.
_COMPRESS_LEVEL = 1


class ImageSize(NamedTuple):
    """Pixels."""

    width: int
    height: int


def depth_png_size(path: Path) -> ImageSize:
    """Size of a depth PNG, from its header alone. Raises `InputError` if it is not 16-bit grey."""
    try:
        with path.open("rb") as file:
            return _checked_header(path, file.read(_HEADER_BYTES))
    except OSError as error:
        raise InputError(path, "file", f"expected a depth PNG ({error.strerror})") from error


def read_depth_png(path: Path, size: ImageSize) -> RawDepth:
    """Stored units of a depth PNG of a known size.

    Raises `InputError` when the file is missing, cut short, damaged, of another size, or not
    16-bit grey.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, "file", f"expected a depth PNG ({error.strerror})") from error
    found = _checked_header(path, data)
    if found != size:
        expected = f"expected {size.width} x {size.height} px as in the first frame"
        raise InputError(path, "image size", f"{expected}, got {found.width} x {found.height}")
    if data.rfind(_END_CHUNK) < 0:
        raise InputError(path, "file", "expected a whole PNG, but it ends early (cut short)")
    try:
        with Image.open(BytesIO(data)) as image:
            return np.asarray(image, dtype=np.uint16)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(path, "file", f"expected an undamaged PNG ({error})") from error


def write_depth_png(path: Path, units: RawDepth) -> None:
    """Write stored units (height, width) as a 16-bit grey PNG."""
    Image.fromarray(units).save(path, "PNG", compress_level=_COMPRESS_LEVEL)


def _checked_header(path: Path, data: bytes) -> ImageSize:
    if not data.startswith(_SIGNATURE):
        raise InputError(path, "file", "expected a PNG image")
    if len(data) < _HEADER_BYTES or data[12:16] != b"IHDR":
        raise InputError(path, "file", "expected a whole PNG, but it ends early (cut short)")
    width, height, bits, colour_type = struct.unpack(">IIBB", data[16:26])
    if (bits, colour_type) != (16, 0):
        kind = _COLOUR_TYPES.get(colour_type, f"colour type {colour_type}")
        raise InputError(path, "pixels", f"expected 16-bit grey depth, got {bits}-bit {kind}")
    return ImageSize(width, height)
