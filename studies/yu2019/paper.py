"""What Yu, Zhao and Zhang 2019 print, and what they leave open: the only place with their numbers.

Section 4 of "Pose Determination for Malfunctioned Satellites Based on Depth Information".
"""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import make_transform
from pcnav.target.catalogue import Rectangle

SHORT_CM, LONG_CM, DEPTH_CM = 10.0, 18.0, 6.5
"""The rectangle of Tables 1-4: x from -5 to 5, y from -9 to 9, z = 6.5 cm."""

TABLE_1_POINTS = 2500
TABLE_1_TRIALS = 300
TABLE_1_THRESHOLD_CM = 0.005
"""Printed without a unit; see `extraction`."""


@dataclass(frozen=True)
class Table1Row:
    """Extraction of the plane from a cloud with outliers."""

    outliers: int
    extracted: int
    time_ms: float


TABLE_1 = (
    Table1Row(0, 2500, 20.0),
    Table1Row(100, 2400, 20.0),
    Table1Row(500, 2000, 30.0),
    Table1Row(1250, 1252, 70.0),
)


@dataclass(frozen=True)
class MomentsRow:
    """Centroid (x, y, z in cm) and eigenvalues (middle, largest, smallest in cm^2) of one draw."""

    points: int
    noise_cm: float
    centroid: tuple[float, float, float]
    eigenvalues: tuple[float, float, float]


TABLE_2 = (
    MomentsRow(10000, 0.0, (0.0154, -0.0390, 6.5), (8.4102, 26.7072, 0.0)),
    MomentsRow(5000, 0.0, (-0.0079, -0.0090, 6.5), (8.3106, 27.3320, 0.0)),
    MomentsRow(2500, 0.0, (-0.0801, -0.0033, 6.5), (8.5595, 26.7923, 0.0)),
    MomentsRow(1250, 0.0, (0.1542, -0.0438, 6.5), (8.4415, 26.4924, 0.0)),
    MomentsRow(625, 0.0, (0.0906, -0.3373, 6.5), (8.2372, 27.7920, 0.0)),
)
TABLES_3_AND_4 = (
    MomentsRow(2500, 0.0, (-0.0801, -0.0033, 6.5), (8.5595, 26.7923, 0.0)),
    MomentsRow(2500, 0.01, (0.0817, -0.0833, 6.4999), (8.5898, 26.9769, 0.0001)),
    MomentsRow(2500, 0.1, (0.0541, 0.0661, 6.4984), (8.3124, 26.9526, 0.0103)),
    MomentsRow(2500, 1.0, (-0.0261, 0.0210, 6.5254), (9.4664, 27.7494, 0.9765)),
)

BOX_DEPTH_M = 13.0
"""Of the box that outliers fill, the centimetres of Table 1 read in metres."""

CLOUD_POINTS = 1800
CLOUD_NOISE_M = 0.1
"""Standard deviation on each axis of each point, Figs. 8-16."""

RECTANGLE = Rectangle(
    name="rectangle",
    T_model_rect=make_transform(np.eye(3), np.zeros(3)),
    length_m=18.0,
    width_m=10.0,
    two_sided=True,
)
"""Not printed for Figs. 8-16: the rectangle of Tables 1-4 read in metres, a sheet through the
nominal origin across the target's z axis."""

FIRST_GUESS_RAD = (0.2, -0.1, 0.15)
"""How far the attitude known before the first frame is off: one rectangle cannot tell its own case,
and the paper calls case (1) what it sees first."""

FIG_8_POSITION_MM = (10.0, 10.0, 10.0)
FIG_10_ATTITUDE_DEG = (0.13, 0.12, 0.16)
FIG_11_POSITION_MM = (1.4, 3.2, 1.4)
FIG_12_VELOCITY_MM_S = (0.01, 0.01, 0.01)
FIG_13_MASS_CENTRE_MM = (1.0, 1.0, 1.0)
FIG_14_ATTITUDE_DEG = (0.1, 0.1, 0.1)
FIG_15_RATE_DEG_S = (0.01, 0.01, 0.01)
"""Largest errors, by axis where the paper says so."""

PRIOR_SD: FloatArray = np.repeat([1.0, 0.1, 0.1, 0.1, 0.01, 0.1], [3, 3, 3, 3, 3, 5])
"""(20,) square roots of the printed P0: m, m/s, m, rad, rad/s, 1."""
DISTURBANCE_VARIANCE = 1e-12
"""The printed Q = 1e-12 I6, (m/s^2)^2 and (rad/s^2)^2."""


def theory_eigenvalues(noise_cm: float) -> FloatArray:
    """(3,) ``a^2 / 12 + sigma^2`` for both sides and ``sigma^2``, cm^2: (17)."""
    return np.array([SHORT_CM**2 / 12.0, LONG_CM**2 / 12.0, 0.0]) + noise_cm**2
