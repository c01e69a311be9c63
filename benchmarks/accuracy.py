"""Pose errors and times of pcnav and its peers on the same frames."""

from dataclasses import dataclass

import numpy as np
from rich.table import Table

from benchmarks.peers import METHODS, OURS, SAMPLES, START_SHIFT_FRACTION, Method, Poses
from benchmarks.scenes import Case
from pcnav.arrays import BoolArray, FloatArray
from pcnav.spatial import rotation_angle


@dataclass(frozen=True)
class Spread:
    """How an error norm is spread over frames."""

    median: float
    rms: float
    p95: float

    @staticmethod
    def of(errors: FloatArray) -> "Spread":
        """Of the error norms (n,)."""
        rms = float(np.sqrt(np.mean(errors**2)))
        return Spread(float(np.median(errors)), rms, float(np.percentile(errors, 95)))

    def cells(self, digits: int) -> list[str]:
        """The three numbers as text."""
        return [f"{value:.{digits}f}" for value in (self.median, self.rms, self.p95)]


@dataclass(frozen=True)
class Score:
    """One method on one case."""

    method: Method
    position_mm: Spread
    """Of the model frame's origin."""
    attitude_deg: Spread
    mean_ms: float
    median_ms: float
    frames: int
    """Frames of the case with a pose."""


def score_case(case: Case, methods: tuple[Method, ...] = METHODS) -> tuple[Score, ...]:
    """Errors of every method over the frames in which all of them have a pose."""
    answers = [method.estimate(case) for method in methods]
    has_pose = [np.isfinite(answer.T_cam_model).all(axis=(1, 2)) for answer in answers]
    compared = np.logical_and.reduce(has_pose)
    if not compared.any():
        found = ", ".join(f"{m.name}: {h.sum()}" for m, h in zip(methods, has_pose, strict=True))
        raise RuntimeError(f"{case.title}: no frame in which all have a pose ({found})")
    return tuple(
        _score(case, method, answer, compared, int(has.sum()))
        for method, answer, has in zip(methods, answers, has_pose, strict=True)
    )


def _score(case: Case, method: Method, answer: Poses, compared: BoolArray, frames: int) -> Score:
    truth = case.T_cam_model[compared]
    estimated = answer.T_cam_model[compared]
    shift_m, turn_rad = _errors(case, method, estimated, truth)
    return Score(
        method=method,
        position_mm=Spread.of(1e3 * shift_m),
        attitude_deg=Spread.of(np.rad2deg(turn_rad)),
        mean_ms=1e3 * float(np.mean(answer.seconds)),
        median_ms=1e3 * float(np.median(answer.seconds)),
        frames=frames,
    )


def _errors(
    case: Case, method: Method, estimated: FloatArray, truth: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Distance (n,), m, and angle (n,), rad, to the equivalent truth that fits best.

    A symmetric target may be followed in any of its equivalent attitudes, but in one throughout; a
    method without memory may take another in every frame.
    """
    options = [truth @ symmetry for symmetry in case.scene.target.symmetry_rotations]
    turns = np.stack([rotation_angle(_between(estimated, option)) for option in options])
    shifts = np.stack(
        [np.linalg.norm(estimated[:, :3, 3] - option[:, :3, 3], axis=1) for option in options]
    )
    if method.remembers:
        best = int(np.argmin(np.median(turns, axis=1)))
        return shifts[best], turns[best]
    chosen = turns.argmin(axis=0)[None]
    return np.take_along_axis(shifts, chosen, 0)[0], np.take_along_axis(turns, chosen, 0)[0]


def _between(T_from: FloatArray, T_to: FloatArray) -> FloatArray:
    """(n, 3, 3) rotation between the attitudes of poses (n, 4, 4)."""
    return np.asarray(np.swapaxes(T_from[:, :3, :3], 1, 2) @ T_to[:, :3, :3])


def score_table(case: Case, scores: tuple[Score, ...]) -> Table:
    """Errors and times, and the ratio of pcnav's to each peer's."""
    shift_m = START_SHIFT_FRACTION * case.scene.target.diameter_m
    table = Table(
        title=case.title,
        caption=(
            "Errors over the frames in which every method has a pose; times over all frames, from "
            "depth image to pose. Open3D and small_gicp use all cores and align to "
            f"those of {SAMPLES} samples of the mesh that face the camera, started from their own "
            "extrapolated pose; "
            f"having no cold start, they are given the first pose to 5 deg and {shift_m:.2g} m. "
            "Ratios are of medians (position, attitude) and means (time), pcnav over peer."
        ),
    )
    table.add_column("method")
    table.add_column("is given")
    table.add_column("frames", justify="right")
    for name in ("mm median", "RMS", "95 %", "deg median", "RMS", "95 %", "ms mean", "median"):
        table.add_column(name, justify="right")
    table.add_column("pcnav / peer: mm, deg, ms", justify="right")
    ours = next(score for score in scores if score.method is OURS)
    for score in scores:
        table.add_row(
            score.method.name,
            score.method.start,
            str(score.frames),
            *score.position_mm.cells(2),
            *score.attitude_deg.cells(3),
            f"{score.mean_ms:.1f}",
            f"{score.median_ms:.1f}",
            "" if score is ours else _ratios(ours, score),
        )
    return table


def _ratios(ours: Score, peer: Score) -> str:
    pairs = (
        (ours.position_mm.median, peer.position_mm.median),
        (ours.attitude_deg.median, peer.attitude_deg.median),
        (ours.mean_ms, peer.mean_ms),
    )
    return "  ".join(f"{a / b:.2f}" for a, b in pairs)
