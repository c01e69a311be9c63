"""Run every case and compare it with what was recorded: `make golden`."""

import argparse
import shutil
import sys
import tempfile
import time
from pathlib import Path

from tests.golden.cases import CASES
from tests.golden.contents import write_contents
from tests.golden.running import (
    ARITHMETIC,
    DATA,
    arithmetic,
    check_case,
    rounds_as_recorded,
    run_case,
)


def main() -> int:
    """1 where a number or a word has changed."""
    options = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    options.add_argument("--only", metavar="CASE", action="append", choices=sorted(CASES))
    options.add_argument("--update", action="store_true", help="record what the code does today")
    chosen = options.parse_args()
    differing = 0
    if chosen.update:
        ARITHMETIC.write_text(arithmetic(), encoding="utf-8")
    elif not rounds_as_recorded():
        print("this machine rounds otherwise than the one of the recording: differences may be its")
    for name in chosen.only or CASES:
        started = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="pcnav-golden-") as folder:
            if chosen.update:
                _record(name, Path(folder))
                said = "recorded"
            else:
                comparison = check_case(name, Path(folder))
                differing += bool(comparison.differences)
                said = str(comparison)
        print(f"{name:<20} {time.monotonic() - started:5.1f} s  {said}", flush=True)
    if differing:
        print(f"{differing} cases differ: what is meant is written down in changes.py")
    return int(differing > 0)


def _record(name: str, folder: Path) -> None:
    found = run_case(name, folder)
    shutil.rmtree(DATA / name, ignore_errors=True)
    write_contents(DATA / name, found)


if __name__ == "__main__":
    sys.exit(main())
