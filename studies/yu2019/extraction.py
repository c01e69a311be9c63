"""Tables 1-4: planes out of clouds with outliers, centroid and eigenvalues of drawn clouds."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from pcnav.batch.monte_carlo import Case, Run
from pcnav.core.arrays import FloatArray
from pcnav.files.text_table import TextTable
from pcnav.perception.planes import ransac_plane
from pcnav.perception.rectangles import distribution

from ..tables import Claim, table_of
from . import paper
from .clouds import Spacing, rectangle_cloud

_BOX_DEPTH_CM = 13.0
"""Outliers fill the box over the rectangle from the sensor's plane to twice its distance."""
_TIMED_RUNS = 20
_DRAWS_PER_RUN = 20
"""A cloud takes a fraction of a millisecond: enough of them make the 95 % ranges sharp."""
_EVEN_DRAWS = 50
_WORK = 0.5
"""Of a cloud's draws."""
_NAMES = ("x", "y", "z", "lambda 1", "lambda 2", "lambda 3")


@dataclass(frozen=True)
class Extraction:
    """Our draws of a row of Table 1."""

    printed: paper.Table1Row
    counts: FloatArray
    """(m,) points on the plane found with the printed threshold in cm."""
    loose: FloatArray
    """(m,) with one of so many m."""
    time_ms: FloatArray
    """(m,) of the former."""

    @property
    def range(self) -> FloatArray:
        """(2,) 95 % of our counts lie in it."""
        return np.asarray(np.percentile(self.counts, [2.5, 97.5]))

    @property
    def as_printed(self) -> bool:
        """Whether the printed count lies in the range, to a point."""
        low, high = self.range
        return bool(low - 1.0 <= self.printed.extracted <= high + 1.0)


@dataclass(frozen=True)
class Comparison:
    """One printed number against our draws of the same quantity."""

    row: paper.MomentsRow
    name: str
    theory: float
    printed: float
    drawn: FloatArray
    """(m,)"""
    even: FloatArray
    """(m,) what even grids give, which are not placed at random."""

    @property
    def range(self) -> FloatArray:
        """(2,) 95 % of our draws lie in it."""
        return np.asarray(np.percentile(self.drawn, [2.5, 97.5]))

    @property
    def inside(self) -> bool:
        """Whether the printed number lies in the range, to the four decimals it is printed with."""
        low, high = self.range
        return bool(low - 5e-5 <= self.printed <= high + 5e-5)

    @property
    def is_random(self) -> bool:
        """Whether it differs from draw to draw."""
        return bool(self.drawn.std() > 1e-9)

    def error(self, values: FloatArray) -> float:
        """The median size of the error of values (m,)."""
        return float(np.median(np.abs(values - self.theory)))


Moments = tuple[tuple[paper.MomentsRow, ...], int]
"""Rows of a table, and how many clouds are drawn of each."""


def moment_runs(runs: int, seed: int) -> list[Run[Moments]]:
    """The clouds of Table 2 and of Tables 3 and 4."""
    return [
        Run(Case(name, (rows, _DRAWS_PER_RUN * runs), _WORK * len(rows)), index, seed)
        for name, rows, index in (
            ("Table 2", paper.TABLE_2, 1),
            ("Tables 3 and 4", paper.TABLES_3_AND_4, 2),
        )
    ]


def _stream(seed: int, table: int) -> np.random.Generator:
    """What a table's clouds are drawn from: Table 1 is 0, the others are as in `moment_runs`."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(table,)))


def compare_moments(run: Run[Moments]) -> list[Comparison]:
    """Every printed number of a table against our draws."""
    generator = _stream(run.seed, run.index)
    rows, draws = run.case.settings
    comparisons = []
    for row in rows:
        drawn, even = (
            np.array([_draw(row, spacing, generator) for _ in range(count)])
            for spacing, count in (
                (Spacing.INDEPENDENT, draws),
                (Spacing.EVEN, min(draws, _EVEN_DRAWS)),
            )
        )
        theory = [0.0, 0.0, paper.DEPTH_CM, *paper.theory_eigenvalues(row.noise_cm)]
        printed = [*row.centroid, *row.eigenvalues]
        comparisons += [
            Comparison(row, *each)
            for each in zip(_NAMES, theory, printed, drawn.T, even.T, strict=True)
        ]
    return comparisons


def extractions(runs: int, seed: int) -> list[Extraction]:
    """Table 1 with a few runs: they are timed, so not beside others."""
    generator = _stream(seed, 0)
    found = []
    for printed in paper.TABLE_1:
        counts, loose, times = [], [], []
        for run in range(max(2, min(runs, _TIMED_RUNS))):
            cloud_m = 0.01 * _cloud_with_outliers(printed.outliers, generator)
            start = perf_counter()
            counts.append(_extracted(cloud_m, 0.01 * paper.TABLE_1_THRESHOLD_CM, run))
            times.append(1e3 * (perf_counter() - start))
            loose.append(_extracted(cloud_m, paper.TABLE_1_THRESHOLD_CM, run))
        found.append(Extraction(printed, np.array(counts), np.array(loose), np.array(times)))
    return found


def random_numbers(moments: Sequence[Sequence[Comparison]]) -> list[Comparison]:
    """The numbers that differ from draw to draw.

    Table 3 repeats the cloud without noise of Table 2: it counts once.
    """
    second, third = moments
    return [c for c in [*second, *third[len(_NAMES) :]] if c.is_random]


def tables(
    extracted: Sequence[Extraction], moments: Sequence[Sequence[Comparison]]
) -> list[TextTable]:
    """Tables 1-4."""
    return [
        _extraction_table(extracted),
        _table("table_2", moments[0]),
        _table("tables_3_4", moments[1]),
    ]


def claims(extracted: Sequence[Extraction], moments: Sequence[Sequence[Comparison]]) -> list[Claim]:
    """Whether the printed draws look like ours."""
    compared = random_numbers(moments)
    inside, as_printed = sum(c.inside for c in compared), all(e.as_printed for e in extracted)
    return [
        Claim(
            "Table 1",
            f"points extracted with {', '.join(str(e.printed.outliers) for e in extracted)} "
            "outliers",
            ", ".join(str(e.printed.extracted) for e in extracted),
            "within our draws" if as_printed else "outside our draws",
            as_printed,
        ),
        Claim(
            "Tables 2-4",
            "printed draws inside 95 % of ours",
            len(compared),
            inside,
            inside >= 0.85 * len(compared),
        ),
    ]


def _cloud_with_outliers(outliers: int, generator: np.random.Generator) -> FloatArray:
    """(2500, 3) cm: the first points replaced by outliers."""
    cloud = rectangle_cloud(
        paper.SHORT_CM, paper.LONG_CM, paper.TABLE_1_POINTS, Spacing.INDEPENDENT, generator
    )
    cloud[:, 2] = paper.DEPTH_CM
    half = [0.5 * paper.SHORT_CM, 0.5 * paper.LONG_CM]
    low, high = [-half[0], -half[1], 0.0], [*half, _BOX_DEPTH_CM]
    cloud[:outliers] = generator.uniform(low, high, (outliers, 3))
    return cloud


def _extracted(cloud_m: FloatArray, threshold_m: float, seed: int) -> int:
    """How many points lie on the plane found."""
    m = ransac_plane(cloud_m, threshold_m, paper.TABLE_1_TRIALS, seed)
    assert m is not None, "half of the points lie on one plane"
    return int(np.count_nonzero(np.abs(cloud_m @ m - 1.0) < threshold_m * np.linalg.norm(m)))


def _draw(row: paper.MomentsRow, spacing: Spacing, generator: np.random.Generator) -> FloatArray:
    """(6,) centroid and eigenvalues of one cloud, cm and cm^2."""
    cloud = rectangle_cloud(paper.SHORT_CM, paper.LONG_CM, row.points, spacing, generator)
    cloud[:, 2] = paper.DEPTH_CM
    if row.noise_cm > 0.0:
        cloud += row.noise_cm * generator.standard_normal(cloud.shape)
    moments = distribution(cloud)
    return np.concatenate([moments.centroid, moments.eigenvalues])


def _extraction_table(extracted: Sequence[Extraction]) -> TextTable:
    return table_of(
        "table_1",
        extracted,
        {
            "outliers": lambda e: e.printed.outliers,
            "printed points": lambda e: e.printed.extracted,
            "our mean": lambda e: f"{np.mean(e.counts):.1f}",
            "95 % of draws": lambda e: "{:.0f} to {:.0f}".format(*e.range),
            "mean at 0.005 m": lambda e: f"{np.mean(e.loose):.0f}",
            "printed time, ms": lambda e: f"{e.printed.time_ms:.0f}",
            "our time, ms": lambda e: np.median(e.time_ms),
        },
    )


def _table(key: str, comparisons: Sequence[Comparison]) -> TextTable:
    return table_of(
        key,
        [c for c in comparisons if c.is_random],
        {
            "points": lambda c: c.row.points,
            "noise, cm": lambda c: c.row.noise_cm,
            "quantity": lambda c: c.name,
            "theory": lambda c: f"{c.theory:.4f}",
            "printed": lambda c: f"{c.printed:.4f}",
            "sd of draws": lambda c: f"{c.drawn.std(ddof=1):.4f}",
            "95 % of draws": lambda c: "{:.4f} to {:.4f}".format(*c.range),
            "inside": lambda c: c.inside,
            "printed error": lambda c: f"{c.error(np.array([c.printed])):.4f}",
            "median, draws": lambda c: f"{c.error(c.drawn):.4f}",
            "median, grid": lambda c: f"{c.error(c.even):.4f}",
        },
        text_columns=3,
    )
