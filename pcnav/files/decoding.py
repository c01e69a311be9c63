"""What decoders of other libraries make of damaged files, in one line."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pcnav.core.errors import InputError


@contextmanager
def decoding(path: Path, undamaged: str) -> Iterator[None]:
    """Raises `InputError` for whatever a decoder stumbles over, as "expected " ``undamaged``.

    Their documentation names no errors; a damaged file has been seen to raise types, lookups,
    arithmetic and system errors alike.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        raise InputError(path, "file", f"expected {undamaged} ({error})") from error
