"""16-bit depth PNGs: checked on reading, written fast."""

from io import BytesIO
from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image

from pcnav.core.errors import InputError

RawDepth = npt.NDArray[np.uint16]
"""(height, width) stored units."""
MAXIMUM_UNITS = 65535

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
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(path, "file", f"expected a depth PNG ({error.strerror})") from error
    if not data.startswith(_SIGNATURE):
        raise InputError(path, "file", "expected a PNG image")
    if data.rfind(_END_CHUNK) < 0:
        raise InputError(path, "file", "expected a whole PNG, but it ends early (cut short)")
    try:
        with Image.open(BytesIO(data), formats=["PNG"]) as image:
            mode, pixels = image.mode, np.asarray(image)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise InputError(path, "file", f"expected an undamaged PNG ({error})") from error
    if mode != "I;16":
        expected = f"expected 16-bit grey depth, got {_PIXELS.get(mode, mode)}"
        raise InputError(path, "pixels", expected)
    return np.asarray(pixels, dtype=np.uint16)


def write_depth_png(path: Path, units: RawDepth) -> None:
    """Write stored units (height, width) as a 16-bit grey PNG."""
    Image.fromarray(units).save(path, "PNG", compress_level=_COMPRESS_LEVEL)
