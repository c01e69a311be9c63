"""What Appl. Sci. 2022, 12, 12625 prints, and what it leaves open: its numbers live here."""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera

MASS_KG = 3000.0
INERTIA_KG_M2 = np.array(
    [[5887.73, 970.31, 3193.43], [970.31, 12708.23, 1063.51], [3193.43, 1063.51, 9883.97]]
)
RATE_DEG_S = (1.0, 0.2, 0.1)
"""Body axes, at the start. Printed per second; read as degrees."""
PLACE_M = (0.0, 0.0, 40.0)
"""Mass centre, camera axes, at rest."""
CAMERA = PinholeCamera(2048, 2048, 2909.0, 2909.0, 1024.0, 1024.0)

INTERVAL_S = 1.0
"""Not printed."""
DURATION_S = 60.0
"""Not printed."""
POINTS = 80
"""Not printed, but for more than eight: about half of them face the camera."""


def hull_half_sides_m() -> tuple[FloatArray, FloatArray]:
    """(3,) half sides and (3, 3) R_body_hull of the uniform box with the printed mass properties.

    The paper shows a satellite without its size; this box has its mass and its inertia.
    """
    moments, axes = np.linalg.eigh(INERTIA_KG_M2)
    axes = axes * np.sign(np.linalg.det(axes))
    # I_x = m (b^2 + c^2) / 3 of half sides b, c, hence a^2 from the three.
    return np.sqrt(1.5 * (moments.sum() - 2.0 * moments) / MASS_KG), axes


def frame_times(duration_s: float, interval_s: float) -> FloatArray:
    """Both ends included."""
    count = round(duration_s / interval_s) + 1
    return np.asarray(np.arange(count, dtype=np.float64) * interval_s)
