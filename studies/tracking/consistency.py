"""Consistency: NEES and NIS over Monte Carlo runs, and errors beside the Cramer-Rao bound."""

from dataclasses import dataclass
from functools import partial

import numpy as np

from pcnav.batch.cluster import Workers
from pcnav.batch.engine import run_all
from pcnav.batch.monte_carlo import Case, Run, runs_of
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    V_HILL,
)
from pcnav.evaluation.bound import bound_of
from pcnav.evaluation.metrics import chi_square_bounds
from pcnav.files.text_table import TextTable, number
from pcnav.recordings.sequence import Frame
from pcnav.simulation.random_truth import Spread, random_truth, satellite
from pcnav.simulation.scene import Scene

from ..folder import Chapter, StudyFigure
from ..progress import Progress
from .bars import NONE, Bar, MeanSquared, mean_squared, numbers
from .figures import BlockCurve, block_figure
from .following import JudgedRun, follow

NAME = "consistency"
FRAMES = 100
_FRAME_RATE_HZ = 2.0
_NOISE_M = 0.02
_SPREAD = Spread(range_m=(15.0, 30.0), rate_deg_s=(1.0, 5.0), speed_m_s=0.02)
_WORST_SHOWN = 8


@dataclass(frozen=True)
class Block:
    """Part of the state that is judged by itself."""

    name: str
    part: slice
    unit: str
    scale: float
    """From SI to the unit."""

    @property
    def size(self) -> int:
        """Degrees of freedom."""
        return int(self.part.stop - self.part.start)


_DEGREES = float(np.rad2deg(1.0))
BLOCKS = (
    Block("position", R_HILL, "mm", 1e3),
    Block("velocity", V_HILL, "mm/s", 1e3),
    Block("mass centre", COM_MODEL, "mm", 1e3),
    Block("attitude", THETA_BODY, "deg", _DEGREES),
    Block("rate", OMEGA_BODY, "deg/s", _DEGREES),
    Block("inertia ratios", INERTIA_RATIOS, "1", 1.0),
    Block("all", slice(0, STATE_SIZE), "", 1.0),
)


@dataclass(frozen=True)
class ConsistencyRun:
    """One Monte Carlo run."""

    seed: int
    run: JudgedRun
    bound: FloatArray
    """(n, 20) variance that no tracker can beat, after each frame."""


@dataclass(frozen=True)
class ConsistencyResult:
    """All runs and what they come to."""

    chapter: Chapter
    bars: tuple[Bar, ...]
    runs: tuple[ConsistencyRun, ...]
    inside: int
    judged: int
    """How many of the judged means are inside their bounds."""


def run_consistency(seed: int, frames: int = FRAMES) -> ConsistencyRun:
    """One track of boxsat with its bound: truth and noise are the seed's."""
    of = satellite("boxsat")
    truth = random_truth(of, _SPREAD, seed, frames=frames, frame_rate_hz=_FRAME_RATE_HZ)
    noise = truth.noise.model_copy(update={"range_sigma_m": _NOISE_M})
    scene = Scene.of(truth.model_copy(update={"noise": noise}), of.target.mesh)
    shown: list[Frame] = []
    run = follow(scene, of.target, on_frame=shown.append)
    bound = bound_of(scene, of.target, shown)
    return ConsistencyRun(seed, run, np.diagonal(bound, axis1=1, axis2=2).copy())


def _run(run: Run[None], frames: int) -> ConsistencyRun:
    return run_consistency(run.seed, frames)


def planned_runs(count: int) -> list[Run[None]]:
    """So many runs."""
    return runs_of(NAME, [Case(NAME, None)], count)


def consistency_chapter(
    runs: list[Run[None]], frames: int, workers: Workers, progress: Progress
) -> ConsistencyResult:
    """Run the Monte Carlo and lay it out."""
    found = run_all(partial(_run, frames=frames), runs, workers, lambda: progress.add(frames))
    times = _times(frames)
    nees = _nees(found)
    judged = {
        (block.name, k): mean_squared(nees[block.name][:, k], block.size)
        for block in BLOCKS
        for k in times.values()
    }
    nis = {k: _nis(found, slice(k, k + 1)) for k in times.values()}
    means = (
        *(
            _bar(f"NEES of {block.name} {when}", judged[block.name, k])
            for block in BLOCKS
            for when, k in times.items()
        ),
        *(_bar(f"NIS {when}", nis[k]) for when, k in times.items()),
    )
    estimated = int(np.isfinite(nees["all"][:, -1]).sum())
    told = f"{estimated} of {len(found)}"
    ended = Bar(NAME, "runs with an estimate at the end", "all", told, estimated == len(found))
    chapter = Chapter(
        "Consistency",
        _text(frames, len(means)),
        (
            _nees_table(found, judged, nis, times),
            _bound_table(found, times),
            _worst_table(found, nees["all"]),
        ),
        _figures(found, nees),
    )
    inside = sum(bar.met for bar in means)
    return ConsistencyResult(chapter, (*means, ended), tuple(found), inside, len(means))


def _times(frames: int) -> dict[str, int]:
    """Where in the run is judged: names and frame indices."""
    return {"at a quarter": frames // 4 - 1, "at half": frames // 2 - 1, "at the end": frames - 1}


def _nees(runs: list[ConsistencyRun]) -> dict[str, FloatArray]:
    """(runs, n) squared normalised errors by block."""
    return {block.name: np.stack([each.run.nees(block.part) for each in runs]) for block in BLOCKS}


def _nis(runs: list[ConsistencyRun], frames: slice) -> MeanSquared:
    nis = np.concatenate([each.run.nis[frames] for each in runs])
    dof = np.concatenate([each.run.nis_dof[frames] for each in runs])
    return mean_squared(nis, dof.astype(np.float64))


def _bar(quantity: str, judged: MeanSquared) -> Bar:
    return Bar(NAME, quantity, judged.bounds, number(judged.mean), judged.verdict == "inside")


def _nees_table(
    found: list[ConsistencyRun],
    judged: dict[tuple[str, int], MeanSquared],
    nis: dict[int, MeanSquared],
    times: dict[str, int],
) -> TextTable:
    rows = [
        (
            f"NEES of {block.name}",
            str(block.size),
            *(str(judged[block.name, k]) for k in times.values()),
        )
        for block in BLOCKS
    ]
    own = np.stack([each.run.filter_nees for each in found])
    cells = (str(mean_squared(own[:, k], STATE_SIZE)) for k in times.values())
    rows.append(("the same, filter's parameters", str(STATE_SIZE), *cells))
    rows.append(("NIS", "varies", *(str(nis[k]) for k in times.values())))
    over_all = str(_nis(found, slice(None)))
    rows.append(("NIS over all frames", "varies", NONE, NONE, over_all))
    runs = max(each.values for each in judged.values())
    return TextTable(
        "consistency",
        "NEES and NIS over dof (95 % bounds): 1 where the stated covariance is right",
        ("", "dof", *times),
        tuple(rows),
        f"Mean over {runs} runs, those with an estimate at that frame. Above: the covariance "
        "promises too much; below: it promises less than is true. The bounds hold one mean in 20 "
        "out by chance. The filter's own parameters of the inertia are a curved function of the "
        "ratios: where they are poorly known, a covariance that is right in the one is not in the "
        "other.",
    )


def _bound_table(runs: list[ConsistencyRun], times: dict[str, int]) -> TextTable:
    rows = []
    for block in BLOCKS[:-1]:
        cells: list[float] = []
        for k in times.values():
            errors = np.array([each.run.state_error[k, block.part] for each in runs])
            bounds = np.array([each.bound[k, block.part] for each in runs])
            known = np.isfinite(errors).all(axis=1)
            if not known.any():
                cells += [np.nan] * 3
                continue
            rmse = block.scale * np.sqrt(np.mean(np.sum(errors[known] ** 2, axis=1)))
            bound = block.scale * np.sqrt(np.mean(np.sum(bounds[known], axis=1)))
            cells += [float(rmse), float(bound), float(rmse / bound)]
        rows.append((block.name, block.unit, *numbers(cells)))
    columns = [column for when in times for column in (f"RMSE {when}", "bound", "ratio")]
    return TextTable(
        "cramer_rao",
        "Errors beside the posterior Cramer-Rao bound",
        ("block", "unit", *columns),
        tuple(rows),
        "RMSE and bound are those of the whole block (root of the summed variances), over the "
        "same runs. The bound carries the information of each frame at the true pose along the "
        "true motion, from the prior of the mass properties on and with the filter's process "
        "noise; it is what the measurements as modelled allow, not a limit of the sensor.",
        text_columns=2,
    )


def _worst_table(runs: list[ConsistencyRun], nees: FloatArray) -> TextTable:
    _, limit = chi_square_bounds(STATE_SIZE)
    last = np.where(np.isfinite(nees[:, -1]), nees[:, -1], np.inf)
    order = [k for k in np.argsort(-last).tolist() if last[k] > limit][:_WORST_SHOWN]
    rows = [
        (
            str(runs[k].seed),
            runs[k].run.status[-1],
            number(float(nees[k, -1]) / STATE_SIZE),
            number(1e3 * float(runs[k].run.position_m[-1])),
            number(float(np.rad2deg(runs[k].run.attitude_rad[-1]))),
        )
        for k in order
    ]
    outside = int(np.count_nonzero(last > limit))
    return TextTable(
        "consistency_worst",
        "Runs that end beyond their own bound",
        ("seed", "status", "NEES over dof", "position error, mm", "attitude error, deg"),
        tuple(rows) or (("none", *[NONE] * 4),),
        f"{outside} of {len(runs)} runs have no estimate at the end, or a NEES of the whole state "
        "above its 97.5 % point; 1 in 40 does by chance. The worst are listed. One of them alone: "
        "studies.tracking.consistency.run_consistency(seed).",
        text_columns=2,
    )


def _figures(runs: list[ConsistencyRun], nees: dict[str, FloatArray]) -> tuple[StudyFigure, ...]:
    curves = {
        block.name: BlockCurve.of(
            block.name,
            [mean_squared(column, block.size) for column in nees[block.name].T],
        )
        for block in BLOCKS
    }
    frames = range(len(runs[0].run))
    curves["NIS"] = BlockCurve.of("NIS", [_nis(runs, slice(k, k + 1)) for k in frames])
    caption = "In the band nineteen times of twenty where the stated covariances are right."
    return tuple(
        block_figure(key, title, caption, runs[0].run.time_s, [curves[name] for name in names])
        for key, title, names in (
            (
                "nees_orbit",
                "NEES over dof: orbit and mass centre",
                ("position", "velocity", "mass centre", "all"),
            ),
            (
                "nees_rotation",
                "NEES over dof: rotation and inertia, and NIS",
                ("attitude", "rate", "inertia ratios", "NIS"),
            ),
        )
    )


def _text(frames: int, bars: int) -> tuple[str, ...]:
    return (
        f"Boxsat, {frames} frames at {_FRAME_RATE_HZ:g} Hz, range noise {_NOISE_M:g} m: attitude, "
        "rate (1 to 5 deg/s), distance (15 to 30 m), relative velocity, mass centre and inertia "
        "ratios are drawn anew for every run, the latter two from the prior that the target states "
        "and the filter starts from. Errors are taken in the coordinates of the stated covariance: "
        "ratios as differences, attitude as the rotation from estimate to truth.",
        f"{bars} means are judged at 95 % each: of a perfect filter about {0.05 * bars:.0f} lie "
        "outside by chance.",
    )
