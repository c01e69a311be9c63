"""The cases: what is run, through the command line alone.

Modules may move and merge as they like: the entry point is the one that pyproject.toml names, and
what is compared is what the commands write and print.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

Changes = Mapping[str, Any]
"""What is set in a shipped pipeline, by dotted key."""


@dataclass(frozen=True)
class Step:
    """One command of a case."""

    output: str
    """Name of what it writes, as later steps call it."""
    command: str
    """Its arguments. ``{name}`` is the output or pipeline of that name; a step that is not told
    to write to ``{output}`` has what it prints compared."""


@dataclass(frozen=True)
class Case:
    """Commands that are run one after the other, and all that they write."""

    steps: tuple[Step, ...]
    pipelines: Mapping[str, Changes] = field(default_factory=dict)
    """Shipped pipelines that the case shortens."""
    grid: str = ""
    """The text of a grid file, for ``{grid}``."""
    quick: bool = False
    """Whether every run of the tests includes it; the others are marked as studies."""


def _recorded_and_run(pipeline: str, changes: Changes, *more: Step) -> Case:
    """A shipped pipeline, shortened, simulated and run with its own estimator."""
    steps = (
        Step("recording", f"simulate {{{pipeline}}} -o {{recording}}"),
        Step("result", f"run {{recording}} -o {{result}} --pipeline {{{pipeline}}}"),
    )
    return Case((*steps, *more), {pipeline: changes}, quick=True)


def _depth_run(pipeline: str, frames: int, *more: Step) -> Case:
    """As users run a depth sequence: with the settings of the estimator that are built in."""
    steps = (
        Step("recording", f"simulate {{{pipeline}}} -o {{recording}}"),
        Step("result", "run {recording} -o {result}"),
    )
    return Case((*steps, *more), {pipeline: {"scenario.frames": frames}}, quick=True)


_ATTITUDES = Step("attitudes", "run {recording} -o {attitudes} --pipeline deng2024")
"""The estimator of attitudes, on those that follow from the tracks of one camera."""
_KNOWN = Step("known", "observability {result}")

CASES: dict[str, Case] = {
    "boxsat": _depth_run("boxsat", 40, _KNOWN),
    # Two symmetric targets: with every fault of the sensor, and at short range and 10 Hz.
    "twinwing": _depth_run("twinwing", 15),
    "cubesat6u": _depth_run("cubesat6u", 15),
    # Its arc of 10 s is over after half of the frames.
    "hu2024": _recorded_and_run("hu2024", {"scenario.frames": 200}),
    # By then the bank has decided on one of its hypotheses.
    "segal2011": _recorded_and_run("segal2011", {"scenario.frames": 120}),
    "applsci2022": _recorded_and_run("applsci2022", {"scenario.frames": 30}, _ATTITUDES),
    "images": _recorded_and_run("images", {"scenario.frames": 12}),
    "deng2024": _recorded_and_run("deng2024", {"scenario.frames": 101}),
}
