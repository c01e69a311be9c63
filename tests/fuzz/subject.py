"""What is mutated and how it is read."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path


class RefusedError(Exception):
    """What a command refused its input with."""


@dataclass(frozen=True)
class Subject:
    """A folder of good files, the patterns of those that are mutated, and how it is read."""

    name: str
    build: Callable[[Path], object]
    patterns: tuple[str, ...]
    read: Callable[[Path], object]
    """Raises `InputError` or `RefusedError` for what it refuses; anything else is a fault."""
