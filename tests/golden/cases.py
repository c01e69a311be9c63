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
    exit_codes: tuple[int, ...] = (0,)
    """Those that are an answer. Comparing two batches ends with 1 where the second is worse."""


@dataclass(frozen=True)
class Case:
    """Commands that are run one after the other, and all that they write."""

    steps: tuple[Step, ...]
    pipelines: Mapping[str, Changes] = field(default_factory=dict)
    """Shipped pipelines that the case shortens."""
    grids: Mapping[str, str] = field(default_factory=dict)
    """The text of grid files."""


def _recorded_and_run(pipeline: str, changes: Changes, *more: Step) -> Case:
    """A shipped pipeline, shortened, simulated and run with its own estimator."""
    steps = (
        Step("recording", f"simulate {{{pipeline}}} -o {{recording}}"),
        Step("result", f"run {{recording}} -o {{result}} --pipeline {{{pipeline}}}"),
    )
    return Case((*steps, *more), {pipeline: changes})


def _depth_run(pipeline: str, frames: int, *more: Step) -> Case:
    """As users run a depth sequence: with the settings of the estimator that are built in."""
    steps = (
        Step("recording", f"simulate {{{pipeline}}} -o {{recording}}"),
        Step("result", "run {recording} -o {result}"),
    )
    return Case((*steps, *more), {pipeline: {"scenario.frames": frames}})


def _study(name: str) -> Case:
    """A study at its smallest: fewer than two runs are refused."""
    return Case((Step("study", f"study {name} -o {{study}} --runs 2 --jobs 1"),))


_ATTITUDES = Step("attitudes", "run {recording} -o {attitudes} --pipeline deng2024")
"""The estimator of attitudes, on those that follow from the tracks of one camera."""
_KNOWN = Step("known", "observability {result}")

_TWO = """
[batch]
name = "golden"
runs = 2
seed = 1
frames = 12

[base]
satellite = "boxsat"
range_m = 20.0
tumble_deg_s = 3.0
frame_rate_hz = 2.0
resolution_px = 128
range_sigma_m = 0.02
dropout_share = 0.0
outlier_share = 0.0
mixed_pixel_share = 0.0

[[grid]]
cross = { range_m = [15, 25], estimator = ["pcnav", "open3d_icp"] }
"""
"""pcnav and a peer at two distances."""
_AGAIN = _TWO.replace("seed = 1", "seed = 2")
_ALL = f"""{_TWO}
[[grid]]
cross = {{ estimator = ["pcnav_rectangles", "pcnav_both", "pcnav_paper", "pcnav_single_frame"] }}

[[grid]]
cross = {{ estimator = ["open3d_icp_tukey", "small_gicp", "small_gicp_10", "kiss_icp"] }}

[[grid]]
zip = {{ satellite = ["twinwing", "cubesat6u"], range_m = [22, 2], range_sigma_m = [0.02, 0.003] }}
cross = {{ estimator = ["pcnav"] }}
"""
"""Every estimator and satellite besides."""
_PIVOT = "--rows range_m,satellite --columns estimator --metrics attitude_rms_deg,position_p95_m"

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
    "targets": Case(
        tuple(
            step
            for name in ("boxsat", "cubesat6u", "twinwing")
            for step in (
                Step(f"{name}_toml", f"target {name} -o {{{name}_toml}}/{name}.toml"),
                Step(name, f"target {name}"),
            )
        )
    ),
    "observability": Case(
        tuple(
            Step(name, f"observability {name}")
            for name in ("boxsat", "twinwing", "hu2024", "segal2011", "applsci2022", "deng2024")
        )
    ),
    "batch": Case(
        (
            Step("batch", "table {all} -o {batch} --jobs 1"),
            Step("pivot", f"table {{batch}} -o {{pivot}} {_PIVOT}"),
            Step("late", "table {batch} -o {late} --from 4"),
            Step("again", "table {other_seed} -o {again} --jobs 1"),
            Step("compared", "table --compare {batch} {again}", exit_codes=(0, 1)),
        ),
        grids={"all": _ALL, "other_seed": _AGAIN},
    ),
    "study-yu2019": _study("yu2019"),
    "study-tracking": _study("tracking"),
    "study-hu2024": _study("hu2024"),
    "study-segal2011": _study("segal2011"),
    "study-applsci2022": _study("applsci2022"),
    "study-deng2024": _study("deng2024"),
}

QUICK = ("boxsat",)
"""What every run of the tests includes; the others are marked as studies."""
