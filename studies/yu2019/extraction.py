"""Tables 1-4: planes out of clouds with outliers, centroid and eigenvalues of drawn clouds."""

from dataclasses import dataclass
from time import perf_counter

import numpy as np
from scipy.stats import binom

from pcnav.core.arrays import FloatArray
from pcnav.files.text_table import TextTable, number
from pcnav.perception.planes import ransac_plane
from pcnav.perception.rectangles import distribution

from ..folder import Chapter
from ..progress import Progress
from . import paper
from .clouds import Spread, rectangle_cloud

_BOX_DEPTH_CM = 13.0
"""Outliers fill the box over the rectangle from the sensor's plane to twice its distance."""
_TIMED_RUNS = 20
_DRAWS_PER_RUN = 20
"""A cloud takes a fraction of a millisecond: enough of them make the 95 % ranges sharp."""
_NAMES = ("x", "y", "z", "lambda 1", "lambda 2", "lambda 3")


@dataclass(frozen=True)
class _Comparison:
    """One printed number against our draws of the same quantity."""

    label: tuple[str, ...]
    theory: float
    printed: float
    drawn: FloatArray
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

    @property
    def even_error(self) -> float:
        """Median error of the even grids."""
        return float(np.median(np.abs(self.even - self.theory)))

    def row(self) -> tuple[str, ...]:
        """As it stands in the table."""
        low, high = self.range
        error = self.drawn - self.theory
        return (
            *self.label,
            f"{self.theory:.4f}",
            f"{self.printed:.4f}",
            f"{self.drawn.std(ddof=1):.4f}",
            f"{low:.4f} to {high:.4f}",
            "yes" if self.inside else "no",
            f"{abs(self.printed - self.theory):.4f}",
            f"{np.median(np.abs(error)):.4f}",
            f"{self.even_error:.4f}",
        )


_HEADER = (
    "theory",
    "printed",
    "sd of draws",
    "95 % of draws",
    "inside",
    "printed error",
    "median, draws",
    "median, grid",
)


@dataclass(frozen=True)
class ExtractionResult:
    """Tables 1-4 and what they come to."""

    chapter: Chapter
    inside: int
    compared: int
    extracted_as_printed: bool
    """Whether every printed count of Table 1 lies within our 95 % range."""
    smaller_errors: int
    """Numbers of those compared whose median error on an even grid is at most the printed error."""


def extraction_tables(runs: int, seed: int, progress: Progress) -> ExtractionResult:
    """Rebuild Tables 1-4 with so many draws of every row."""
    streams = np.random.SeedSequence(seed).spawn(3)
    table_1, as_printed = _table_1(runs, np.random.default_rng(streams[0]), progress)
    comparisons = []
    tables = [table_1]
    for key, title, rows, stream in (
        ("table_2", "Table 2: against the number of points, no noise", paper.TABLE_2, streams[1]),
        ("tables_3_4", "Tables 3 and 4: against noise", paper.TABLES_3_AND_4, streams[2]),
    ):
        own = _moments(rows, _DRAWS_PER_RUN * runs, np.random.default_rng(stream), progress)
        comparisons += own
        tables.append(_comparison_table(key, title, own))
    # Table 3 repeats the cloud without noise of Table 2: it counts once.
    table_2 = len(_NAMES) * len(paper.TABLE_2)
    new = [*comparisons[:table_2], *comparisons[table_2 + len(_NAMES) :]]
    random = [c for c in new if c.is_random]
    inside = sum(c.inside for c in random)
    smaller = sum(c.even_error <= abs(c.printed - c.theory) for c in random)
    chapter = Chapter(
        "Tables 1-4: extraction and recognition of the rectangle",
        _text(inside, len(random)),
        tuple(tables),
    )
    return ExtractionResult(chapter, inside, len(random), as_printed, smaller)


def extraction_units(runs: int) -> float:
    """Units of progress that `extraction_tables` counts."""
    moments = len(paper.TABLE_2) + len(paper.TABLES_3_AND_4)
    return 0.5 * moments + 0.05 * len(paper.TABLE_1) * max(2, min(runs, _TIMED_RUNS))


def _table_1(
    runs: int, generator: np.random.Generator, progress: Progress
) -> tuple[TextTable, bool]:
    rows, as_printed = [], True
    for printed in paper.TABLE_1:
        counts, loose, times = [], [], []
        for run in range(max(2, min(runs, _TIMED_RUNS))):
            cloud_m = 0.01 * _cloud_with_outliers(printed.outliers, generator)
            found, seconds = _extracted(cloud_m, 0.01 * paper.TABLE_1_THRESHOLD_CM, run)
            counts.append(found)
            times.append(1e3 * seconds)
            loose.append(_extracted(cloud_m, paper.TABLE_1_THRESHOLD_CM, run)[0])
            progress.add(0.05)
        low, high = np.percentile(counts, [2.5, 97.5])
        as_printed &= bool(low - 1.0 <= printed.extracted <= high + 1.0)
        rows.append(
            (
                str(printed.outliers),
                str(printed.extracted),
                f"{np.mean(counts):.1f}",
                f"{low:.0f} to {high:.0f}",
                f"{np.mean(loose):.0f}",
                f"{printed.time_ms:.0f}",
                number(float(np.median(times))),
            )
        )
    header = (
        "outliers",
        "printed points",
        "our mean",
        "95 % of draws",
        "mean at 0.005 m",
        "printed time, ms",
        "our time, ms",
    )
    note = (
        "2500 points, the outliers among them; 300 RANSAC trials. Outliers are uniform in the "
        "box over the rectangle from z = 0 to 13 cm. The time is the median of our runs on the "
        "machine that made this page; the paper names none."
    )
    title = "Table 1: points extracted with a threshold of 0.005 cm"
    return TextTable("table_1", title, header, tuple(rows), note), as_printed


def _cloud_with_outliers(outliers: int, generator: np.random.Generator) -> FloatArray:
    """(2500, 3) cm: the first points replaced by outliers."""
    cloud = rectangle_cloud(
        paper.SHORT_CM, paper.LONG_CM, paper.TABLE_1_POINTS, Spread.INDEPENDENT, generator
    )
    cloud[:, 2] = paper.DEPTH_CM
    half = [0.5 * paper.SHORT_CM, 0.5 * paper.LONG_CM]
    low, high = [-half[0], -half[1], 0.0], [*half, _BOX_DEPTH_CM]
    cloud[:outliers] = generator.uniform(low, high, (outliers, 3))
    return cloud


def _extracted(cloud_m: FloatArray, threshold_m: float, seed: int) -> tuple[int, float]:
    """How many points lie on the plane found, and the seconds it took."""
    start = perf_counter()
    m = ransac_plane(cloud_m, threshold_m, paper.TABLE_1_TRIALS, seed)
    assert m is not None, "half of the points lie on one plane"
    near = np.abs(cloud_m @ m - 1.0) < threshold_m * np.linalg.norm(m)
    return int(np.count_nonzero(near)), perf_counter() - start


def _moments(
    rows: tuple[paper.MomentsRow, ...],
    runs: int,
    generator: np.random.Generator,
    progress: Progress,
) -> list[_Comparison]:
    comparisons = []
    for row in rows:
        drawn = np.array([_draw(row, Spread.INDEPENDENT, generator) for _ in range(runs)])
        even = np.array([_draw(row, Spread.EVEN, generator) for _ in range(min(runs, 50))])
        theory = [0.0, 0.0, paper.DEPTH_CM, *paper.theory_eigenvalues(row.noise_cm)]
        printed = [*row.centroid, *row.eigenvalues]
        for k, name in enumerate(_NAMES):
            label = (str(row.points), number(row.noise_cm), name)
            comparisons.append(_Comparison(label, theory[k], printed[k], drawn[:, k], even[:, k]))
        progress.add(0.5)
    return comparisons


def _draw(row: paper.MomentsRow, spread: Spread, generator: np.random.Generator) -> FloatArray:
    """(6,) centroid and eigenvalues of one cloud, cm and cm^2."""
    cloud = rectangle_cloud(paper.SHORT_CM, paper.LONG_CM, row.points, spread, generator)
    cloud[:, 2] = paper.DEPTH_CM
    if row.noise_cm > 0.0:
        cloud += row.noise_cm * generator.standard_normal(cloud.shape)
    moments = distribution(cloud)
    return np.concatenate([moments.centroid, moments.eigenvalues])


def _comparison_table(key: str, title: str, comparisons: list[_Comparison]) -> TextTable:
    header = ("points", "noise, cm", "quantity", *_HEADER)
    note = (
        "x, y, z in cm, eigenvalues lambda in cm2: theory is a2/12 + sigma2 (17). Inside: "
        "whether the printed number lies in the range of our draws. Last three columns: size of "
        "the error, printed, of our draws and of even grids. Without noise z and lambda 3 are "
        "exact and left out."
    )
    rows = tuple(comparison.row() for comparison in comparisons if comparison.is_random)
    return TextTable(key, title, header, rows, note, text_columns=3)


def _text(inside: int, compared: int) -> tuple[str, ...]:
    low, high = np.asarray(binom.ppf([0.025, 0.975], compared, 0.95))
    return (
        "The paper prints one draw of each cloud. A draw cannot be repeated, but its "
        "distribution can: the tables give the spread and the 95 % range of ours. If the printed "
        f"draws come from the same distribution, {low:.0f} to {high:.0f} of the {compared} "
        f"numbers that are random lie inside our 95 % ranges (were they independent); {inside} do.",
        "The errors printed are those of placing points at random, not of the method: an even "
        "grid of as many points (last column) has no such error, only that of the noise and of "
        "the cells' finite size.",
        "The distance threshold 0.005 is printed without a unit. In centimetres, the unit of all "
        "else there, it lets through about one outlier of 1250, and the paper counts 1252 points "
        "where 1250 are on the plane; 0.005 m would let through about a hundred.",
    )
