"""The one exception that means "the input is wrong", as opposed to a fault of pcnav."""

from pathlib import Path


class InputError(ValueError):
    """Bad input, described in one line: the file, the field in it and what was expected there.

    The command line prints the message and exits with code 2; a library user catches it
    like any ``ValueError``.
    """

    def __init__(self, file: Path | str, field: str, expected: str) -> None:
        self.file = Path(file)
        self.field = field
        self.expected = expected
        # A message that spans lines would break the one-line promise (pydantic and PIL write such).
        super().__init__(" ".join(f"{file}: {field}: {expected}".split()))
