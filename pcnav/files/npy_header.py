"""The header of an .npy file: what it says is known before anything is allocated by it."""

import tokenize
from typing import IO, Any

import numpy as np

Header = tuple[tuple[int, ...], bool, np.dtype[Any]]
"""Shape, whether by column, and type."""


def read_npy_header(file: IO[bytes]) -> Header:
    """Of an open file, which is left at the first number.

    Raises ``ValueError`` for one that is damaged, of a later version, or of Python objects.
    """
    version = np.lib.format.read_magic(file)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"array format {version}")
    read = (
        np.lib.format.read_array_header_1_0
        if version == (1, 0)
        else np.lib.format.read_array_header_2_0
    )
    try:
        shape, by_column, dtype = read(file)
    # It is evaluated like a literal of Python.
    except (SyntaxError, tokenize.TokenError, TypeError, MemoryError, RecursionError) as error:
        raise ValueError(f"a damaged header ({type(error).__name__})") from error
    if dtype.hasobject:
        raise ValueError("Python objects")
    if any(not isinstance(n, int) or n < 0 for n in shape):
        raise ValueError(f"the shape {shape}")
    return shape, by_column, dtype
