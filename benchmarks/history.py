"""What earlier benchmarks measured, a line each in a file beside their tables."""

import json
import platform
import subprocess
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path

from rich.table import Table

FILE = "history.jsonl"


@dataclass(frozen=True)
class Entry:
    """One run of the benchmarks."""

    when: str
    """UTC, ISO 8601."""
    commit: str
    """Of the checkout, marked where it is changed; empty where there is none."""
    machine: str
    """Processor and Python: times of others do not compare."""
    numbers: dict[str, float]
    """By name with their unit; of all of them less is better."""


def entry_of(numbers: Mapping[str, float]) -> Entry:
    """What was measured here and now."""
    described = subprocess.run(
        ["git", "describe", "--always", "--dirty"],
        cwd=Path(__file__).parent,
        capture_output=True,
        text=True,
        check=False,
    )
    machine = f"{platform.machine()}, Python {platform.python_version()}"
    when = datetime.now(UTC).isoformat(timespec="seconds")
    return Entry(when, described.stdout.strip(), machine, dict(numbers))


def append(folder: Path, entry: Entry) -> None:
    """Add an entry to the history in a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / FILE).open("a", encoding="utf-8") as file:
        file.write(json.dumps(asdict(entry)) + "\n")


def read(folder: Path) -> list[Entry]:
    """The entries of a folder, the oldest first; none where there is no history."""
    path = folder / FILE
    if not path.is_file():
        return []
    return [Entry(**json.loads(line)) for line in path.read_text(encoding="utf-8").splitlines()]


def last_of_same(entries: list[Entry], entry: Entry) -> Entry | None:
    """The last entry that measured something of what another did, on such a machine."""
    for earlier in reversed(entries):
        if earlier.machine == entry.machine and earlier.numbers.keys() & entry.numbers.keys():
            return earlier
    return None


def comparison_table(before: Entry, after: Entry) -> Table:
    """What both measured, and the ratio."""
    table = Table(title="against the last benchmark", caption="Of all of them less is better.")
    table.add_column("number")
    table.add_column(f"{before.when}, {before.commit}", justify="right")
    table.add_column(f"{after.when}, {after.commit}", justify="right")
    table.add_column("ratio", justify="right")
    for name, value in after.numbers.items():
        if name in before.numbers:
            earlier = before.numbers[name]
            ratio = f"{value / earlier:.2f}" if earlier else ""
            table.add_row(name, f"{earlier:.4g}", f"{value:.4g}", ratio)
    return table
