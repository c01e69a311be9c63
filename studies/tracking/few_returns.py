"""Few returns: starts at low resolution, cut by the edge of the image, and from afar."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.table import Vector3
from pcnav.core.statistics import percentile, share
from pcnav.files.text_table import TextTable
from pcnav.recordings.sequence import Frame
from pcnav.simulation.depth import Scene
from pcnav.simulation.random_truth import Satellite, Spread, random_truth, satellite

from ..following import JudgedRun, follow
from ..tables import Claim, never, table_of
from .knowable import Knowledge, knowledge
from .shapes import SHAPES, shape

NAME = "few returns"
FRAMES = 20
FRAME_RATE_HZ = 5.0
TARGETS = ("boxsat", "cubesat6u", "twinwing", "hexagonal bus", "stage with equipment")
KINDS = ("64 x 64", "cut", "far")
CASES = {f"{name}, {kind}": (name, kind) for name in TARGETS for kind in KINDS}
QUICK_CASES = {name: CASES[name] for name in ("boxsat, 64 x 64", "boxsat, far")}
"""Two of them, for a look at the machinery."""
RETURNS = (50, 100, 200, 500)
"""Bounds of the classes of starts, by the median over their frames."""
_NEAREST, _FARTHEST, _RATE_DEG_S, _SPEED = 3.2, 6.0, (0.0, 20.0), 0.002
"""Distances and speed in diameters, and rates of the truths."""
_SMALL_PX, _CUT_PX = 64, 96
_CUT_SHARE = 0.3
"""How far the middle of a target that is cut may be from the edge, over its diameter."""
_HALF_TURN_RAD = float(np.deg2rad(150.0))
_STARTED_BAR = 0.8


@dataclass(frozen=True)
class FewStart:
    """One start of so many frames."""

    target: str
    kind: str
    seed: int
    returns: int
    """Median over the frames."""
    started: int | None
    """First frame, from 1, with a claim; None without any."""
    wrong: int
    """Frames with a wrong claim."""
    attitude_rad: float
    position_fraction: float
    """Largest errors of any claim, the position's over the diameter; 0 without a claim."""
    statuses: str
    """Of the claims that are wrong."""
    known: Knowledge
    seconds: float
    """Processor time of the tracker over all frames."""

    @property
    def is_half_turn(self) -> bool:
        """Whether a claim was wrong by about half a turn."""
        return self.wrong > 0 and self.attitude_rad > _HALF_TURN_RAD


FewStarts = Mapping[str, Sequence[FewStart]]
"""By case."""


def run_few(name: str, kind: str, seed: int) -> FewStart:
    """One start of a target in frames of a kind: truth and noise are the seed's."""
    of = shape(name) if name in SHAPES else satellite(name)
    scene = Scene.of(few_truth(of, kind, seed), of.target.mesh)
    returns: list[int] = []

    def count(frame: Frame) -> None:
        returns.append(int(np.count_nonzero(frame.depth_m)))

    run = follow(scene, of.target, on_frame=count)
    return _judged(name, kind, seed, run, returns, scene, of)


def few_truth(of: Satellite, kind: str, seed: int) -> Pipeline:
    """A random truth in frames of a kind."""
    D = of.target.diameter_m
    width = {"64 x 64": _SMALL_PX, "cut": _CUT_PX}.get(kind)
    if width is not None:
        camera = of.pipeline.camera.model_copy(update={"width_px": width, "height_px": width})
        of = Satellite(of.target, of.pipeline.model_copy(update={"camera": camera}))
    rng = np.random.default_rng([seed, 1])
    range_m = D * rng.uniform(_NEAREST, _FARTHEST)
    if kind == "far":
        # By Cauchy's formula a convex body shows a quarter of its surface on average.
        area = 0.25 * float(of.target.mesh.convex_hull.area)
        shown = np.exp(rng.uniform(np.log(RETURNS[0]), np.log(RETURNS[-1])))
        range_m = of.pipeline.camera.pinhole.fx * float(np.sqrt(area / shown))
    spread = Spread((range_m, range_m), _RATE_DEG_S, _SPEED * D)
    truth = random_truth(of, spread, seed, frames=FRAMES, frame_rate_hz=FRAME_RATE_HZ)
    return _cut(truth, of, range_m, rng) if kind == "cut" else truth


def _cut(truth: Pipeline, of: Satellite, range_m: float, rng: np.random.Generator) -> Pipeline:
    """The truth with the middle of the target near an edge of the image, inside or outside."""
    camera = truth.camera
    half = range_m * float(np.tan(0.5 * np.deg2rad(camera.horizontal_fov_deg)))
    R_cam_hill = camera.R_cam_hill
    at = R_cam_hill @ np.array(truth.orbit.r_hill_m)
    axis, side = int(rng.integers(2)), float(rng.choice([-1.0, 1.0]))
    off = _CUT_SHARE * of.target.diameter_m * rng.uniform(-1.0, 0.3)
    at[axis], at[1 - axis] = side * (half + off), half * rng.uniform(-0.5, 0.5)
    x, y, z = (float(value) for value in R_cam_hill.T @ at)
    moved: Vector3 = (x, y, z)
    orbit = truth.orbit.model_copy(update={"r_hill_m": moved})
    return truth.model_copy(update={"orbit": orbit})


def _judged(
    name: str,
    kind: str,
    seed: int,
    run: JudgedRun,
    returns: list[int],
    scene: Scene,
    of: Satellite,
) -> FewStart:
    D, claims = of.target.diameter_m, run.claims
    wrong = claims & ~run.is_right(of.target)
    said = Counter(word for word, is_wrong in zip(run.said.status, wrong, strict=True) if is_wrong)
    return FewStart(
        target=name,
        kind=kind,
        seed=seed,
        returns=int(np.median(returns)),
        started=None if run.lock is None else run.lock + 1,
        wrong=int(np.count_nonzero(wrong)),
        attitude_rad=float(run.attitude_rad[claims].max(initial=0.0)),
        position_fraction=float(run.position_m[claims].max(initial=0.0)) / D,
        statuses=", ".join(f"{times} {word}" for word, times in said.most_common()),
        known=knowledge(scene, of),
        seconds=float(run.seconds.sum()),
    )


def tables(found: FewStarts) -> list[TextTable]:
    """By returns, by case, and the wrong ones."""
    everything = [start for starts in found.values() for start in starts]
    classes = [
        [start for start in everything if low <= start.returns < high]
        for low, high in zip((0, *RETURNS), (*RETURNS, np.inf), strict=True)
    ]
    names = {id(own): name for own, name in zip(classes, _class_names(), strict=True)}
    names |= {id(own): name for name, own in found.items()}
    return [
        _table("few_returns", "returns", [own for own in classes if own], names),
        _table("few_returns_cases", "case", list(found.values()), names),
        table_of(
            "few_returns_wrong",
            [start for start in everything if start.wrong],
            {
                "target": lambda s: s.target,
                "frames": lambda s: s.kind,
                "claimed": lambda s: s.statuses,
                "seed": lambda s: s.seed,
                "returns": lambda s: s.returns,
                "attitude, deg": lambda s: np.rad2deg(s.attitude_rad),
                "position, % of diameter": lambda s: 100.0 * s.position_fraction,
            },
            text_columns=3,
        ),
    ]


def _class_names() -> list[str]:
    inner = [f"{low} to {high}" for low, high in pairwise(RETURNS)]
    return [f"under {RETURNS[0]}", *inner, f"over {RETURNS[-1]}"]


def _table(
    key: str, column: str, groups: Sequence[Sequence[FewStart]], names: Mapping[int, str]
) -> TextTable:
    def of(own: Sequence[FewStart], kind: str) -> object:
        known = [start for start in own if start.known.decides]
        return share(_started(known), len(known)) if kind == "known" else len(known)

    return table_of(
        key,
        groups,
        {
            column: lambda own: names[id(own)],
            "starts": len,
            f"started by frame {FRAMES}": lambda own: share(_started(own), len(own)),
            "wrong": lambda own: sum(start.wrong > 0 for start in own),
            "half turns": lambda own: sum(start.is_half_turn for start in own),
            "could be known": partial(of, kind="count"),
            "of these started": partial(of, kind="known"),
            "frames to start": lambda own: percentile(
                [float(s.started) for s in own if s.started is not None], 50
            ),
            "seconds": lambda own: [percentile([s.seconds for s in own], p) for p in (50, 100)],
        },
    )


def _started(starts: Sequence[FewStart]) -> int:
    return sum(start.started is not None for start in starts)


def started_of_known(starts: Sequence[FewStart]) -> str:
    """How many were started of those that the frames decide, as text."""
    known = [start for start in starts if start.known.decides]
    return f"{_started(known)} of {len(known)}"


def claims(found: Sequence[FewStart]) -> list[Claim]:
    """None wrong, and most of those started that the frames decide."""
    known = [start for start in found if start.known.decides]
    started = _started(known)
    return [
        never(NAME, "starts with a wrong claim", sum(start.wrong > 0 for start in found)),
        Claim(
            NAME,
            f"started by frame {FRAMES}, of those that the frames decide",
            f">= {_STARTED_BAR:.0%}",
            share(started, len(known)),
            started >= _STARTED_BAR * len(known),
        ),
    ]
