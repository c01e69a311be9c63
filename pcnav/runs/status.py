"""What an estimate is worth, whatever estimated it."""

from enum import StrEnum


class Status(StrEnum):
    """What an estimate is worth."""

    ACQUIRING = "acquiring"
    LOCKED = "locked"
    AMBIGUOUS = "ambiguous"
    COASTING = "coasting"
    LOST = "lost"


CLAIMED = (Status.LOCKED, Status.AMBIGUOUS)
"""What an estimator calls an estimate that it stands for."""
