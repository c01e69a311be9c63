"""Array type names used across the package."""

from typing import TypeAlias

import numpy as np
import numpy.typing as npt

FloatArray: TypeAlias = npt.NDArray[np.float64]
BoolArray: TypeAlias = npt.NDArray[np.bool_]
IntArray: TypeAlias = npt.NDArray[np.intp]
DepthImage: TypeAlias = npt.NDArray[np.float32]
"""(height, width) z-depth, metres; 0 where no return came back."""
