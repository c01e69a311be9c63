"""Depth images in messages of ROS: Image, CompressedDepth and PointCloud2."""

import struct
from io import BytesIO
from typing import Any

import numpy as np
from PIL import Image

from pcnav.recordings.cloud import Cloud, time_name
from pcnav.recordings.depth_image import StoredDepth

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"
CLOUD = "sensor_msgs/msg/PointCloud2"
ENCODINGS = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4", "64FC1": "f8"}
"""Of depth, and the pixels' type. Integers are millimetres, floats metres (REP 118)."""
_HEADER = struct.Struct("<iff")
"""Of a compressed depth image: kind of compression, and the two parameters of inverse depth."""
_PNG = b"\x89PNG\r\n\x1a\n"
_MAX_PIXELS = 64_000_000
_FIELD_TYPES = dict(enumerate(("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"), start=1))


def depth_of_image(message: Any) -> StoredDepth:
    """(height, width) of an Image. Raises `ValueError` for one that holds no depth."""
    kind = ENCODINGS.get(str(message.encoding))
    if kind is None:
        known = ", ".join(ENCODINGS)
        raise ValueError(f"expected depth ({known}), got pixels of {str(message.encoding)!r}")
    dtype = np.dtype(kind).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.asarray(message.data, dtype=np.uint8)
    if height * step != len(data) or step < width * dtype.itemsize or not data.size:
        raise ValueError(f"expected {height} rows of {step} bytes, got {len(data)} bytes")
    rows = data.reshape(height, step)[:, : width * dtype.itemsize]
    return _native(np.ascontiguousarray(rows).view(dtype))


def depth_of_compressed(message: Any) -> StoredDepth:
    """(height, width) of a CompressedImage of the compressed depth, or compressed, transport.

    Raises `ValueError`.
    """
    data, stated = bytes(message.data), str(message.format)
    if not data.startswith(_PNG):
        if len(data) < _HEADER.size:
            raise ValueError("expected a compressed depth image, but it ends early")
        _, a, b = _HEADER.unpack_from(data)
        data = data[_HEADER.size :]
    else:
        a = b = 0.0
    if not data.startswith(_PNG):
        raise ValueError(f"expected a PNG in it (RVL and JPEG are not read), got {stated!r}")
    try:
        with Image.open(BytesIO(data), formats=["PNG"]) as image:
            if image.width * image.height > _MAX_PIXELS:
                raise ValueError(f"expected at most {_MAX_PIXELS:,} pixels")
            mode, pixels = image.mode, np.asarray(image)
    except (OSError, SyntaxError, Image.DecompressionBombError) as error:
        raise ValueError(f"expected an undamaged PNG in it ({error})") from error
    if mode != "I;16":
        raise ValueError(f"expected 16-bit grey in it, got {mode}")
    if not stated.startswith("32FC1"):
        return np.asarray(pixels, dtype=np.uint16)
    # Inverse depth, quantised: 0 is a hole.
    units = pixels.astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(units > 0.0, a / (units - b), 0.0).astype(np.float32)


def cloud_of(message: Any) -> Cloud:
    """The points of a PointCloud2, with their times where it has them. Raises `ValueError`."""
    height, width = int(message.height), int(message.width)
    if not 0 < height * width <= _MAX_PIXELS:
        raise ValueError(f"expected 1 to {_MAX_PIXELS:,} points, got {height} x {width}")
    places = {str(field.name): field for field in message.fields}
    if not {"x", "y", "z"} <= places.keys():
        raise ValueError(f"expected fields x, y, z, got {', '.join(places)[:100]}")
    step, row = int(message.point_step), int(message.row_step)
    data = np.asarray(message.data, dtype=np.uint8)
    if row < width * step or height * row != len(data):
        raise ValueError(f"expected {height} rows of {row} bytes, got {len(data)} bytes")
    time = time_name(places)
    names = ["x", "y", "z", *([time] if time else [])]
    kinds = [_FIELD_TYPES.get(int(places[name].datatype), "") for name in names]
    if "" in kinds or not {"f4", "f8"} >= set(kinds[:3]):
        raise ValueError("expected x, y and z as floats, and a number for a time")
    order, offsets = ">" if message.is_bigendian else "<", [int(places[n].offset) for n in names]
    formats = [np.dtype(order + kind) for kind in kinds]
    if any(at + form.itemsize > step for at, form in zip(offsets, formats, strict=True)):
        raise ValueError("expected x, y and z within each point")
    form = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": step})
    rows = np.ascontiguousarray(data.reshape(height, row)[:, : width * step]).view(form)
    points = np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    return Cloud(points, rows[time].astype(np.float64) if time else None)


def _native(pixels: StoredDepth) -> StoredDepth:
    return pixels.astype(pixels.dtype.newbyteorder("="))
