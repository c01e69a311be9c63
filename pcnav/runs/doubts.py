"""What speaks against an estimate though it is followed: names, and how each is told in words.

An estimator writes the names of those that a frame raises into the column ``doubts`` of states.csv,
beside the numbers that they rest on.
"""

from enum import StrEnum

COLUMN = "doubts"
TILT_COLUMN, RIM_COLUMN = "tilt_sd", "rim_px"


class Doubt(StrEnum):
    """One kind of evidence."""

    NIS = "nis"
    """The innovations of the last frames are larger than their covariances allow."""
    EXPLAINED = "explained"
    """Less of the frame is explained than of the frames before, or little of all of them."""
    PRIOR = "prior"
    """The frames contradict what was stated of the mass."""
    TILT = "tilt"
    """Residuals lie across the image and the target as an error of the calibration makes them."""
    RIM = "rim"
    """The outline lies elsewhere than the surfaces that it is of end."""


TOLD = {
    Doubt.NIS: "innovations larger than stated",
    Doubt.EXPLAINED: "less explained than before",
    Doubt.PRIOR: "frames against the stated mass",
    Doubt.TILT: "residuals across the image",
    Doubt.RIM: "a step at the rim",
}


def column_of(doubts: list[Doubt]) -> str | None:
    """The field of states.csv; None, which is empty, for none."""
    return " ".join(doubts) or None


def doubts_in(field: str) -> tuple[Doubt, ...]:
    """Those that a field of states.csv names; names of later releases are left out."""
    known = {str(doubt): doubt for doubt in Doubt}
    return tuple(known[word] for word in field.split() if word in known)
