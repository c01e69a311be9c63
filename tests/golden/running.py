"""Running a case's commands, each in a process of its own as users run them."""

import os
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import tomli_w

from tests.golden.cases import CASES, Changes
from tests.golden.compare import Comparison, compare
from tests.golden.contents import Contents, contents, printed, read_contents

DATA = Path(__file__).resolve().parent / "data"
ARITHMETIC = DATA.with_name("arithmetic.txt")
"""The digest of the machine that the data were recorded on."""
_REPOSITORY = Path(__file__).resolve().parent.parent.parent
_ENVIRONMENT = {
    # Sums in another order would be other numbers.
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    # So would those of another processor's instructions: what every x86-64 of today has is used.
    "OPENBLAS_CORETYPE": "Haswell",
    "NPY_DISABLE_CPU_FEATURES": "X86_V4 AVX512_ICL AVX512_SPR",
    "MKL_CBWR": "AVX2",
    "OPENCV_CPU_DISABLE": "AVX512_SKX",
    # What is printed depends on the width of the terminal.
    "COLUMNS": "200",
    "NO_COLOR": "1",
    "TERM": "dumb",
    "MPLBACKEND": "Agg",
    # This checkout's code, whichever one is installed.
    "PYTHONPATH": str(_REPOSITORY),
}


def run_case(name: str, folder: Path) -> Contents:
    """Run the commands of a case in an empty folder; returns all that they wrote.

    Raises ``RuntimeError`` with the words of a command that fails.
    """
    case = CASES[name]
    places = {step.output: folder / step.output for step in case.steps}
    files = {name: _changed_pipeline(name, changes) for name, changes in case.pipelines.items()}
    for file, text in (files | {**case.grids}).items():
        places[file] = folder / f"{file}.toml"
        places[file].write_text(text, encoding="utf-8")
    found: Contents = {}
    for step in case.steps:
        words = [word.format_map(places) for word in shlex.split(step.command)]
        answer = _pcnav(words, folder, step.exit_codes)
        if places[step.output].is_dir():
            found |= contents(places[step.output], step.output)
        else:
            found |= printed(answer, step.output)
    return found


def check_case(name: str, folder: Path) -> Comparison:
    """Run a case in an empty folder and compare it with what was recorded."""
    return compare(name, read_contents(DATA / name), run_case(name, folder))


def _pcnav(words: list[str], folder: Path, exit_codes: tuple[int, ...]) -> str:
    """What the command prints. Raises ``RuntimeError`` with its words for any other exit code."""
    about = tomllib.loads((_REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    module, _, function = about["project"]["scripts"]["pcnav"].partition(":")
    program = f"from {module} import {function} as main; main()"
    try:
        return _python(["-c", program, *words], folder)
    except subprocess.CalledProcessError as error:
        if error.returncode in exit_codes:
            return str(error.stdout)
        raise RuntimeError(f"pcnav {shlex.join(words)}: {error.stderr.strip()}") from error


def arithmetic() -> str:
    """The digest of this machine; see `tests.golden.arithmetic`."""
    return _python(["-m", "tests.golden.arithmetic"], _REPOSITORY)


def rounds_as_recorded() -> bool:
    """Whether the recorded numbers can be expected to repeat on this machine."""
    return ARITHMETIC.read_text(encoding="utf-8") == arithmetic()


def _python(arguments: list[str], folder: Path) -> str:
    """What a Python of its own prints. Raises ``subprocess.CalledProcessError``."""
    answer = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=os.environ | _ENVIRONMENT,
        capture_output=True,
        text=True,
        encoding="utf-8",
        check=True,
    )
    return answer.stdout


def _changed_pipeline(name: str, changes: Changes) -> str:
    """The text of a shipped pipeline with some of its values replaced."""
    shipped = _REPOSITORY / "pipelines" / f"{name}.toml"
    content = tomllib.loads(shipped.read_text(encoding="utf-8"))
    for key, value in changes.items():
        *tables, last = key.split(".")
        table: dict[str, Any] = content
        for part in tables:
            table = table[part]
        # A key that the pipeline does not have would be a name that has changed.
        assert last in table, f"{shipped.name} has no {key}"
        table[last] = value
    return tomli_w.dumps(content)
