"""The arrays of the mathematics. Shapes and units stand with each argument."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

Vector = tuple[float, float, float]
"""A place or direction as plain numbers: x, y, z."""
