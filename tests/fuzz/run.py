"""Read many mutants, each in a process of its own with little memory and little time.

python -m tests.fuzz.run --mutants 2000 --seed 1 [--first 500] [--only mesh] [--keep FOLDER] [--all]
"""

import argparse
import contextlib
import importlib
import io
import logging
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from pcnav.core.errors import InputError
from tests.fuzz.mutants import mutated
from tests.fuzz.subject import RefusedError, Subject
from tests.fuzz.subjects import SUBJECTS

MAX_S = 10.0
MAX_WAIT_S = 180.0
MAX_BYTES = 1_500_000_000
MAX_MESSAGE = 1500
GOOD = ("refused", "accepted")


@dataclass(frozen=True)
class Outcome:
    """What came of one mutant."""

    subject: str
    number: int
    file: str
    kind: str
    text: str = ""

    @property
    def is_good(self) -> bool:
        return self.kind in GOOD

    def __str__(self) -> str:
        return f"{self.subject} {self.number} {self.file}: {self.kind} {self.text}"


def outcomes(
    numbers: range, seed: int, only: str | None = None, keep: Path | None = None
) -> Iterator[Outcome]:
    """What came of mutants, by number spread evenly over all subjects; the faulty ones are kept."""
    subjects = [each for each in SUBJECTS if only is None or only in each.name]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        good = folder / "good"
        good.mkdir()
        for each in subjects:
            _build(each, good / each.name)
        for number in numbers:
            subject = subjects[number % len(subjects)]
            place = folder / "mutant"
            shutil.copytree(good / subject.name, place)
            draw = random.Random(f"{seed} {subject.name} {number}")
            files = sorted(path for pattern in subject.patterns for path in place.glob(pattern))
            file = draw.choice([path for path in files if path.is_file()])
            mutated(file, draw)
            came = outcome_of(subject, place)
            outcome = Outcome(
                subject.name, number, str(file.relative_to(place)), came.kind, came.text
            )
            if keep is not None and not outcome.is_good:
                shutil.copytree(place, keep / f"{subject.name}-{number}", dirs_exist_ok=True)
            shutil.rmtree(place)
            shutil.rmtree(folder / "mutant-tables", ignore_errors=True)
            yield outcome


@dataclass(frozen=True)
class _Came:
    kind: str
    text: str = ""


def _build(subject: Subject, place: Path) -> None:
    """Write the good files. Raises `RuntimeError` where they are not read as they are.

    What is not accepted makes mutants that test nothing. What its reading imported is imported
    here as well, or every mutant would spend its time on that. Only modules cross over: threads
    that a reader starts would be lost to the processes forked later.
    """
    list_file = place.with_name(f"{place.name}.modules")

    def read(folder: Path) -> None:
        before = set(sys.modules)
        subject.build(folder)
        copy = folder.with_name(f"{folder.name}-copy")
        shutil.copytree(folder, copy)
        subject.read(copy)
        shutil.rmtree(copy)
        list_file.write_text("\n".join(sorted(set(sys.modules) - before)))

    # To simulate and to estimate takes longer than to read.
    came = outcome_of(replace(subject, read=read), place, 10.0 * MAX_S)
    if came.kind != "accepted":
        raise RuntimeError(f"{subject.name} is not read as it is: {came}")
    for name in list_file.read_text().splitlines():
        with contextlib.suppress(ImportError):
            importlib.import_module(name)


def outcome_of(subject: Subject, place: Path, max_s: float = MAX_S) -> _Came:
    """Read in a process of its own, which may use so much memory more than this one has."""
    ours, theirs = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(ours)
        try:
            _limit_use(max_s)
            answer = _read(subject, place)
            os.write(theirs, answer.encode("utf-8", "replace")[:4000])
        finally:
            os._exit(0)
    os.close(theirs)
    started = time.monotonic()
    while os.waitpid(child, os.WNOHANG)[0] == 0:
        # A busy machine must not make hangs: what counts is the time of the process itself, and
        # that it does something.
        waited_s = time.monotonic() - started
        if _cpu_s(child) > max_s or waited_s > MAX_WAIT_S * max_s / MAX_S:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            os.close(ours)
            return _Came("hang", str(place))
        time.sleep(0.003)
    with os.fdopen(ours, "rb") as file:
        answer = file.read().decode("utf-8", "replace")
    kind, _, text = answer.partition("\n")
    return _Came(kind or "crash", text)


def _cpu_s(process: int) -> float:
    fields = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _limit_use(max_s: float) -> None:
    status = Path("/proc/self/status").read_text()
    data = int(status.split("VmData:")[1].split()[0]) * 1024
    resident = int(status.split("VmRSS:")[1].split()[0]) * 1024
    limit = data + MAX_BYTES - resident
    resource.setrlimit(resource.RLIMIT_DATA, (limit, limit))
    # Also where nobody is left to end it.
    resource.setrlimit(resource.RLIMIT_CPU, (int(2 * max_s), int(2 * max_s)))


def _read(subject: Subject, place: Path) -> str:
    spoken = io.StringIO()
    logging.basicConfig(stream=spoken, level=logging.INFO, force=True)
    try:
        with (
            contextlib.redirect_stdout(spoken),
            contextlib.redirect_stderr(spoken),
            warnings.catch_warnings(),
        ):
            warnings.simplefilter("ignore")
            subject.read(place)
    except (InputError, RefusedError) as error:
        return _judged(str(error))
    except MemoryError:
        return f"memory\n{_last_line()}"
    except BaseException:
        return f"traceback\n{_last_line()}"
    return "accepted"


def _judged(message: str) -> str:
    if not message.isprintable():
        return f"control characters\n{message!r:.300}"
    if len(message) > MAX_MESSAGE:
        return f"length\n{len(message)} {message:.300}"
    return f"refused\n{message}"


def _last_line() -> str:
    lines = traceback.format_exc().strip().splitlines()
    places = [line.strip() for line in lines if line.strip().startswith("File")]
    ours = [place for place in places if "pcnav/" in place or "pcnav." in place]
    at = (ours or places or [""])[-1].replace(str(Path.cwd()), "")
    return f"{lines[-1]:.200} | {at}"


def main() -> None:
    """Count the outcomes and print the bad ones."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mutants", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--first", type=int, default=0, help="number of the first of them")
    parser.add_argument("--only")
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--all", action="store_true", help="print every outcome")
    asked = parser.parse_args()
    counts: Counter[str] = Counter()
    try:
        numbers = range(asked.first, asked.first + asked.mutants)
        for outcome in outcomes(numbers, asked.seed, asked.only, asked.keep):
            counts[outcome.kind] += 1
            if asked.all or not outcome.is_good:
                print(outcome, flush=True)
    finally:
        # Of those so far, where it is interrupted.
        print(dict(counts), flush=True)


if __name__ == "__main__":
    main()
