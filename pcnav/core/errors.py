"""The one exception that means "the input is wrong", as opposed to a fault of pcnav."""

from pathlib import Path

_MAX_PLACE, _MAX_EXPECTED = 400, 900
"""Characters of a message: what is quoted from a file may be as long as the file."""


class InputError(ValueError):
    """Bad input, described in one line: the file, the field in it and what was expected there.

    The command line prints the message and exits with code 2; a library user catches it
    like any ``ValueError``.
    """

    def __init__(self, file: Path | str, field: str, expected: str) -> None:
        self.file = Path(file)
        self.field = field
        self.expected = expected
        parts = (printable(str(file), _MAX_PLACE), printable(field, _MAX_PLACE))
        super().__init__(": ".join((*parts, printable(expected, _MAX_EXPECTED))))


def printable(text: str, max_length: int) -> str:
    """Text in one line of bounded length that does nothing to a terminal.

    Libraries write messages over several lines, and names in files may hold control characters.
    """
    line = " ".join("".join(mark if mark.isprintable() else " " for mark in text).split())
    if len(line) <= max_length:
        return line
    end = max_length // 3
    return f"{line[: max_length - end - 3]}...{line[-end:]}"
