"""Consistency: NEES and NIS over Monte Carlo runs, and errors beside their Cramer-Rao bounds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.statistics import MeanSquared, chi_square_bounds, mean_squared
from pcnav.evaluation.bound import SceneBound, compared, of_rays
from pcnav.files.text_table import TextTable
from pcnav.recordings.sequence import Frame
from pcnav.report.panels import panels_figure
from pcnav.simulation.depth import Scene

from ..blocks import BLOCKS, JUDGED, WHOLE, ShownBlock
from ..folder import StudyFigure
from ..following import JudgedRun, follow
from ..panels import mean_squared_panel
from ..tables import Claim, always, inside, table, table_of
from .tumbles import boxsat, tumble

NAME = "consistency"
FRAMES = 100
NOISE_M = 0.02
_WORST_SHOWN = 8
_NIS = "NIS"
_FIGURES = {
    "nees_orbit": ("position", "velocity", "mass centre", WHOLE.name),
    "nees_rotation": ("attitude", "rate", "inertia ratios", _NIS),
}
"""Blocks by the key of their figure."""


@dataclass(frozen=True)
class ConsistencyRun:
    """One Monte Carlo run."""

    seed: int
    run: JudgedRun
    bound: FloatArray
    """(n, 20) variance that no tracker can beat, after each frame: by all rays and the outline."""
    compared: FloatArray
    """(n, 20) variance of the best estimate from what the tracker's own comparisons take up."""


def run_consistency(seed: int, frames: int = FRAMES) -> ConsistencyRun:
    """One track of boxsat with its bound: truth and noise are the seed's."""
    truth, target = tumble(seed, frames), boxsat().target
    noise = truth.noise.model_copy(update={"range_sigma_m": NOISE_M})
    scene = Scene.of(truth.model_copy(update={"noise": noise}), target.mesh)
    bounds = [SceneBound(scene, target, of(scene, target)) for of in (of_rays, compared)]
    variances: list[list[FloatArray]] = [[], []]

    def on_frame(frame: Frame) -> None:
        for bound, after in zip(bounds, variances, strict=True):
            after.append(np.diag(bound.step(frame)))

    run = follow(scene, target, on_frame=on_frame)
    return ConsistencyRun(seed, run, *map(np.stack, variances))


@dataclass(frozen=True)
class Judged:
    """All runs, and the means over them at every frame."""

    runs: Sequence[ConsistencyRun]
    means: Mapping[str, MeanSquared]
    """(n,) of the NEES by block, and of the NIS."""
    nis: MeanSquared
    """Over all frames."""

    @staticmethod
    def of(runs: Sequence[ConsistencyRun]) -> "Judged":
        """The means of NEES and NIS."""
        nees = {name: np.stack([each.run.nees(b) for each in runs]) for name, b in JUDGED.items()}
        nis = np.stack([each.run.said.nis for each in runs])
        dof = np.stack([each.run.said.nis_dof for each in runs])
        means = {name: mean_squared(values, JUDGED[name].size) for name, values in nees.items()}
        return Judged(
            runs,
            {**means, _NIS: mean_squared(nis, dof)},
            mean_squared(nis.ravel(), dof.ravel()),
        )

    @property
    def times(self) -> dict[str, int]:
        """Where in the run is judged: names and frame indices."""
        n = len(self.runs[0].run)
        return {"at a quarter": n // 4 - 1, "at half": n // 2 - 1, "at the end": n - 1}

    def at_times(self, means: MeanSquared) -> list[MeanSquared]:
        """The means where they are judged."""
        return [means[k] for k in self.times.values()]

    @property
    def estimated(self) -> int:
        """Runs with an estimate where they are judged."""
        return max(int(self.means[WHOLE.name].values[k]) for k in self.times.values())

    @property
    def beyond(self) -> list[int]:
        """Runs, the worst first, that end without an estimate or with a NEES of the whole state
        above its 97.5 % point."""
        _, limit = chi_square_bounds(WHOLE.size)
        last = np.array([each.run.nees(WHOLE)[-1] for each in self.runs])
        last = np.where(np.isfinite(last), last, np.inf)
        return [k for k in np.argsort(-last).tolist() if last[k] > limit]

    @property
    def mean_claims(self) -> list[Claim]:
        """One for every mean that is judged."""
        return [
            inside(NAME, f"{_quantity(name)} {when}", means[k])
            for name, means in self.means.items()
            for when, k in self.times.items()
        ]


def _quantity(name: str) -> str:
    return name if name == _NIS else f"NEES of {name}"


def claims(judged: Judged) -> list[Claim]:
    """Every mean inside its bounds, and an estimate at the end of every run."""
    ended = [bool(np.isfinite(each.run.position_m[-1])) for each in judged.runs]
    return [*judged.mean_claims, always(NAME, "runs with an estimate at the end", ended)]


def tables(judged: Judged) -> list[TextTable]:
    """NEES and NIS, errors beside their bound, and the worst runs."""
    return [_nees_table(judged), _bound_table(judged), _worst_table(judged)]


def _nees_table(judged: Judged) -> TextTable:
    rows: list[list[object]] = [
        [_quantity(name), block.size, *judged.at_times(judged.means[name])]
        for name, block in JUDGED.items()
    ]
    rows += [
        [_NIS, "varies", *judged.at_times(judged.means[_NIS])],
        ["NIS over all frames", "varies", None, None, judged.nis],
    ]
    return table(
        "consistency",
        ("", "dof", *judged.times),
        rows,
    )


def _bound_table(judged: Judged) -> TextTable:
    def sizes(block: ShownBlock, k: int) -> list[float]:
        """RMS over the runs: of the error, by the bound of the rays and by that of comparisons."""
        values = np.array(
            [
                [
                    block.shown(each.run.state_error[k]),
                    block.shown(np.sqrt(each.bound[k])),
                    block.shown(np.sqrt(each.compared[k])),
                ]
                for each in judged.runs
            ]
        )
        known = values[np.isfinite(values).all(axis=(1, 2))]
        return list(np.sqrt(np.mean(np.sum(known**2, axis=2), axis=0))) if len(known) else 3 * [nan]

    rows = []
    for name, block in BLOCKS.items():
        for when, k in judged.times.items():
            rmse, bound, least = sizes(block, k)
            rows.append((name, block.unit, when, rmse, bound, rmse / bound, least, rmse / least))
    columns = ("RMSE", "bound of rays", "ratio", "of what is compared", "ratio")
    return table("cramer_rao", ("block", "unit", "", *columns), rows, text_columns=3)


def _worst_table(judged: Judged) -> TextTable:
    return table_of(
        "consistency_worst",
        [judged.runs[k] for k in judged.beyond[:_WORST_SHOWN]],
        {
            "seed": lambda each: each.seed,
            "status": lambda each: each.run.said.status[-1],
            "NEES over dof": lambda each: each.run.nees(WHOLE)[-1] / WHOLE.size,
            "position error, mm": lambda each: 1e3 * each.run.position_m[-1],
            "attitude error, deg": lambda each: np.rad2deg(each.run.attitude_rad[-1]),
        },
        text_columns=2,
    )


def figures(judged: Judged) -> list[StudyFigure]:
    """Means over time by block."""
    times_s = judged.runs[0].run.time_s
    return [
        StudyFigure(
            key,
            panels_figure(
                times_s,
                [mean_squared_panel(name, judged.means[name]) for name in names],
                row_in=0.95,
            ),
        )
        for key, names in _FIGURES.items()
    ]
