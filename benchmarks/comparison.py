"""The comparison with peers as tables: one for every case, and one verdict on them all.

The verdict compares medians over the second half of a case. Of the ICP peers the better one counts,
for position and attitude each on its own.
"""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.accuracy import CaseScores, Score
from benchmarks.peers import (
    ICP_PEERS,
    OPEN3D,
    OURS,
    SINGLE_FRAME,
    Method,
    peer_threads,
)
from pcnav.estimators.peers.icp import SAMPLES, START_SHIFT_FRACTION, START_TURN_DEG
from pcnav.files.text_table import TextTable

FILTERED_BAR = 0.5
"""Most that pcnav's filtered error may be of the best ICP peer's."""
SINGLE_FRAME_BAR = 0.8
"""The same for pcnav without memory."""
TIME_BAR = 1.0
"""Most that pcnav's filtered time a frame may be of Open3D ICP's."""
MARKDOWN_FILE, CASES_FILE, VERDICT_FILE = "comparison.md", "cases.csv", "verdict.csv"


@dataclass(frozen=True)
class Ratio:
    """A median of ours over one of theirs."""

    method: str
    peer: str
    quantity: str
    """With its unit."""
    ours: float
    theirs: float
    bar: float

    @property
    def value(self) -> float:
        """nan where there is no error to compare."""
        return self.ours / self.theirs

    @property
    def outcome(self) -> str:
        """``pass`` when within the bar, which nan is not."""
        return "pass" if self.value <= self.bar else "MISS"


@dataclass(frozen=True)
class CaseVerdict:
    """How pcnav stands against the best of its peers in one case."""

    title: str
    filtered_mm: Ratio
    filtered_deg: Ratio
    single_mm: Ratio
    single_deg: Ratio
    filtered_ms: Ratio

    @property
    def ratios(self) -> tuple[Ratio, ...]:
        """All of them."""
        return (
            self.filtered_mm,
            self.filtered_deg,
            self.single_mm,
            self.single_deg,
            self.filtered_ms,
        )


def judge(case: CaseScores) -> CaseVerdict:
    """Compare the medians of one case."""
    peers = [case.of(method) for method in ICP_PEERS]
    position = min(peers, key=lambda score: score.position_mm.median)
    attitude = min(peers, key=lambda score: score.attitude_deg.median)

    def millimetres(ours: Method, bar: float) -> Ratio:
        error, theirs = case.of(ours).position_mm.median, position.position_mm.median
        return Ratio(ours.name, position.method.name, "position, mm", error, theirs, bar)

    def degrees(ours: Method, bar: float) -> Ratio:
        error, theirs = case.of(ours).attitude_deg.median, attitude.attitude_deg.median
        return Ratio(ours.name, attitude.method.name, "attitude, deg", error, theirs, bar)

    ms, theirs_ms = case.of(OURS).frame_ms.median, case.of(OPEN3D).frame_ms.median
    return CaseVerdict(
        case.title,
        millimetres(OURS, FILTERED_BAR),
        degrees(OURS, FILTERED_BAR),
        millimetres(SINGLE_FRAME, SINGLE_FRAME_BAR),
        degrees(SINGLE_FRAME, SINGLE_FRAME_BAR),
        Ratio(OURS.name, OPEN3D.name, "time a frame, ms", ms, theirs_ms, TIME_BAR),
    )


def case_table(case: CaseScores) -> TextTable:
    """Errors and times of every method on one case."""
    half = case.last_frame + 1 - case.first_frame
    return TextTable(
        key="case",
        title=f"{case.title}: frames {case.first_frame} to {case.last_frame}",
        header=(
            "method",
            "is given",
            "frames",
            "mm median",
            "mm 95 %",
            "deg median",
            "deg 95 %",
            "ms mean",
            "ms median",
            "ms max",
        ),
        rows=tuple(
            (
                score.method.name,
                score.method.start,
                f"{score.frames}/{half}",
                f"{score.position_mm.median:.3f}",
                f"{score.position_mm.p95:.3f}",
                f"{score.attitude_deg.median:.4f}",
                f"{score.attitude_deg.p95:.4f}",
                f"{score.frame_ms.mean:.1f}",
                f"{score.frame_ms.median:.1f}",
                f"{score.frame_ms.longest:.1f}",
            )
            for score in case.scores
        ),
        note=f"Errors over the {case.compared} of {half} frames in which every method has a pose; "
        f"times over all {half}.",
        text_columns=2,
    )


def verdict_table(verdicts: Sequence[CaseVerdict]) -> TextTable:
    """Ratios of medians in every case, each against its bar."""
    outcomes = [ratio.outcome for verdict in verdicts for ratio in verdict.ratios]
    return TextTable(
        key="verdict",
        title="Ratios of medians: pcnav over the best ICP peer, and its time over Open3D ICP's",
        header=(
            "case",
            "best ICP, mm",
            "best ICP, deg",
            f"filtered mm <= {FILTERED_BAR:g}",
            f"filtered deg <= {FILTERED_BAR:g}",
            f"single frame mm <= {SINGLE_FRAME_BAR:g}",
            f"single frame deg <= {SINGLE_FRAME_BAR:g}",
            f"filtered ms <= {TIME_BAR:g}",
        ),
        rows=tuple(
            (
                verdict.title,
                f"{verdict.filtered_mm.theirs:.3f} {verdict.filtered_mm.peer}",
                f"{verdict.filtered_deg.theirs:.4f} {verdict.filtered_deg.peer}",
                *(f"{ratio.value:.2f} {ratio.outcome}" for ratio in verdict.ratios),
            )
            for verdict in verdicts
        ),
        note=f"{outcomes.count('pass')} of {len(outcomes)} bars met.",
        text_columns=3,
    )


def conditions() -> tuple[str, ...]:
    """What everyone was given, one sentence or two each."""
    threads = peer_threads()
    blas = os.environ.get("OPENBLAS_NUM_THREADS", "not set")
    return (
        "Times are wall-clock times a frame, from the depth image in memory to the pose, one "
        f"method after the other, on {os.cpu_count()} cores. Open3D and small_gicp run on "
        f"{threads} threads, KISS-ICP on one; NumPy's linear algebra: OPENBLAS_NUM_THREADS {blas}.",
        f"Open3D and small_gicp know the mesh as {SAMPLES:,} points sampled from it, align each "
        "frame's returns to those that face the camera, and start at the pose extrapolated from "
        "their own last two. Having no cold start, they are given the first pose to "
        f"{START_TURN_DEG:g} deg and {START_SHIFT_FRACTION:.0%} of the diameter. KISS-ICP has no "
        "model and is given the true first pose. pcnav is given no pose.",
        "A symmetric target may be followed in any equivalent attitude, but in one throughout.",
    )


def cases_csv(cases: Sequence[CaseScores]) -> str:
    """Every method on every case, a line each, unrounded."""
    names = (
        "satellite,range_sigma_m,method,first_frame,last_frame,frames_with_pose,frames_compared,"
        "position_median_mm,position_p95_mm,attitude_median_deg,attitude_p95_deg,"
        "frame_mean_ms,frame_median_ms,frame_max_ms"
    )
    rows = tuple(
        (
            case.satellite,
            f"{case.range_sigma_m:g}",
            score.method.name,
            *(str(n) for n in (case.first_frame, case.last_frame, score.frames, case.compared)),
            *(f"{value:.6g}" for value in _numbers(score)),
        )
        for case in cases
        for score in case.scores
    )
    return TextTable("cases", "cases", tuple(names.split(",")), rows).to_csv()


def verdict_csv(verdicts: Sequence[CaseVerdict]) -> str:
    """Every ratio of every case, a line each, unrounded."""
    rows = tuple(
        (
            verdict.title,
            ratio.method,
            ratio.peer,
            ratio.quantity,
            *(f"{value:.6g}" for value in (ratio.ours, ratio.theirs, ratio.value, ratio.bar)),
            ratio.outcome,
        )
        for verdict in verdicts
        for ratio in verdict.ratios
    )
    names = "case,method,peer,quantity,median,median_of_peer,ratio,bar,outcome"
    return TextTable("verdict", "verdict", tuple(names.split(",")), rows).to_csv()


def write_comparison(out: Path, cases: Sequence[CaseScores]) -> None:
    """Write the tables into a folder: one Markdown page and two CSV files, replaced if there."""
    verdicts = [judge(case) for case in cases]
    out.mkdir(parents=True, exist_ok=True)
    pieces = ["# pcnav beside its peers", *conditions()]
    pieces += [case_table(case).to_markdown().rstrip() for case in cases]
    pieces.append(verdict_table(verdicts).to_markdown().rstrip())
    (out / MARKDOWN_FILE).write_text("\n\n".join(pieces) + "\n", encoding="utf-8")
    (out / CASES_FILE).write_text(cases_csv(cases), encoding="utf-8")
    (out / VERDICT_FILE).write_text(verdict_csv(verdicts), encoding="utf-8")


def _numbers(score: Score) -> tuple[float, ...]:
    position, attitude, ms = score.position_mm, score.attitude_deg, score.frame_ms
    return (
        position.median,
        position.p95,
        attitude.median,
        attitude.p95,
        ms.mean,
        ms.median,
        ms.longest,
    )
