"""Connected parts of an image whose neighbouring pixels are linked or not."""

from collections.abc import Iterable

import numpy as np
from scipy import ndimage

from pcnav.core.arrays import BoolArray, IntArray


def connected_parts(
    mask: BoolArray, right: BoolArray, down: BoolArray, bridges: Iterable[BoolArray] = ()
) -> IntArray:
    """(height, width) part of each pixel of a mask, numbered from 1 on; 0 beside it.

    Args:
        mask: (height, width).
        right: (height, width - 1) whether each pixel of the mask is linked to the next of its row.
        down: (height - 1, width) likewise of its column.
        bridges: (height - 2, width) and (height, width - 2) whether a pixel beside the mask links
            the ones before and after it in its column, and in its row.
    """
    # Pixels on the even cells of a grid twice as fine, links on the cells between them.
    height, width = mask.shape
    cells = np.zeros((2 * height - 1, 2 * width - 1), dtype=np.bool_)
    cells[::2, ::2] = mask
    cells[::2, 1::2], cells[1::2, ::2] = right, down
    for axis, bridge in enumerate(bridges):
        along = np.moveaxis(cells, axis, 0)
        i, j = np.nonzero(np.moveaxis(bridge, axis, 0))
        for offset in (1, 2, 3):
            along[2 * i + offset, 2 * j] = True
    labels, _ = ndimage.label(cells)
    return np.where(mask, labels[::2, ::2], 0)


def part_sizes(labels: IntArray) -> IntArray:
    """(n + 1,) pixels of each part of an image (height, width); 0 for the first, of no part."""
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    return np.asarray(sizes, dtype=np.intp)


def parts_of(labels: IntArray, least: int) -> list[tuple[IntArray, IntArray]]:
    """Rows and columns of the pixels, row after row, of each part of an image (height, width) that
    has at least so many."""
    rows, columns = np.nonzero(labels)
    own = labels[rows, columns]
    order = np.argsort(own, kind="stable")
    sizes = part_sizes(labels)
    ends = np.cumsum(sizes)
    return [
        (rows[part], columns[part])
        for label in np.flatnonzero(sizes >= least).tolist()
        for part in (order[ends[label] - sizes[label] : ends[label]],)
    ]


def bounding_box(mask: BoolArray) -> tuple[slice, slice]:
    """Rows and columns that hold all pixels of a mask (height, width); none where it is empty."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return slice(0, 0), slice(0, 0)
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


def mask_of(pixels: IntArray, shape: tuple[int, ...]) -> BoolArray:
    """(height, width) mask of pixels (n,) that are counted row after row."""
    mask = np.zeros(shape, dtype=np.bool_)
    mask.ravel()[pixels] = True
    return mask
