"""Units of length that files come in."""

from enum import StrEnum

from pcnav.core.errors import InputError


class LengthUnit(StrEnum):
    """A unit of length, as a user writes it."""

    MILLIMETRE = "mm"
    CENTIMETRE = "cm"
    INCH = "in"
    FOOT = "ft"
    METRE = "m"

    @staticmethod
    def named(text: str) -> "LengthUnit":
        """The unit that a program names. Raises `InputError` for one that is none."""
        try:
            return LengthUnit(text)
        except ValueError as error:
            known = ", ".join(LengthUnit)
            raise InputError("unit", str(text), f"expected one of {known}") from error

    @property
    def metres(self) -> float:
        """Its length, m."""
        return _METRES[self]

    @property
    def plural(self) -> str:
        """As a sentence says it."""
        return _PLURALS[self]


_METRES = {
    LengthUnit.MILLIMETRE: 0.001,
    LengthUnit.CENTIMETRE: 0.01,
    LengthUnit.INCH: 0.0254,
    LengthUnit.FOOT: 0.3048,
    LengthUnit.METRE: 1.0,
}
_PLURALS = {
    LengthUnit.MILLIMETRE: "millimetres",
    LengthUnit.CENTIMETRE: "centimetres",
    LengthUnit.INCH: "inches",
    LengthUnit.FOOT: "feet",
    LengthUnit.METRE: "metres",
}
