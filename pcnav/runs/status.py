"""What an estimate is worth, whatever estimated it."""

from enum import StrEnum


class Status(StrEnum):
    """What an estimate is worth."""

    ACQUIRING = "acquiring"
    LOCKED = "locked"
    AMBIGUOUS = "ambiguous"
    COASTING = "coasting"
    LOST = "lost"
