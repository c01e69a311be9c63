"""What a process that draws for hours keeps of the memory that it took for a moment."""

import ctypes
import sys
from contextlib import suppress

_ARENA_MAX, _MMAP_THRESHOLD = -8, -3
"""Of mallopt(3)."""
_FEW_ARENAS, _LARGE_BYTES = 2, 2**20


def give_back_large_arrays() -> None:
    """Have glibc return large arrays to the system as soon as they are freed.

    Left to itself it keeps those of up to 32 MB, for each thread apart: a view of frames of
    1890 px took 660 MB in place of 460. Of the whole process; elsewhere nothing is done.
    """
    if sys.platform != "linux":
        return
    # Other C libraries of Linux have no such settings.
    with suppress(OSError, AttributeError):
        library = ctypes.CDLL(None)
        library.mallopt(_ARENA_MAX, _FEW_ARENAS)
        library.mallopt(_MMAP_THRESHOLD, _LARGE_BYTES)
