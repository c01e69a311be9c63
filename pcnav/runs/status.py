"""What an estimate is worth, whatever estimated it."""

from enum import StrEnum

import numpy as np


class Status(StrEnum):
    """What an estimate is worth."""

    ACQUIRING = "acquiring"
    LOCKED = "locked"
    AMBIGUOUS = "ambiguous"
    COASTING = "coasting"
    LOST = "lost"


CLAIMED = (Status.LOCKED, Status.AMBIGUOUS)
"""What an estimator calls an estimate that it stands for."""

WRONG_TURN_RAD, WRONG_SHIFT_FRACTION = float(np.deg2rad(5.0)), 0.05
"""A claimed pose is a wrong lock where its attitude is off by this angle or its position by this
share of the target's diameter, up to symmetry. By the same measure is a pose too vague to claim."""
