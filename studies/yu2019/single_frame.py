"""Figs. 8-10: pose errors of single frames on idealised clouds, with and without the ambiguity."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.batch.monte_carlo import Case, Run
from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import exp_rotation, log_rotation
from pcnav.files.text_table import TextTable
from pcnav.report.panels import Curve, Panel, Scale, panels_figure
from pcnav.simulation.motion import TrueMotion, true_motion

from ..folder import StudyFigure
from ..panels import error_panel
from ..pipelines import with_scenario
from ..tables import Claim, as_printed, cell, table
from . import paper
from .clouds import CloudSensor, Sensor, Spacing, centroid_sd, resolved, rotation_sd
from .extracted import OUTLIERS, ExtractedSensor

FRAMES = 360
"""One turn of the target at one frame a second."""
COUNTED = 180
"""Half a turn, after which the rectangle looks the same: the largest error is taken over these.
The paper does not print its number of frames."""
_WORK = 0.3
_FLIPPED_RAD = 0.5 * np.pi
_BOUND_SIDES_M = (18.0, 4.0, 1.8, 1.0, 0.6, 0.27)


@dataclass(frozen=True)
class FrameErrors:
    """Errors of single frames, axes of the first frame's camera (z along its boresight).

    Nan where the rectangle is not found.
    These axes are inertial, as the spin axis is, so the errors mean the same in every frame.
    """

    position_m: FloatArray
    """(n, 3)"""
    attitude_rad: FloatArray
    """(n, 3) rotation vector that takes the true attitude to the measured one."""
    raw_attitude_rad: FloatArray
    """(n, 3) the same before the ambiguity is solved."""

    @property
    def flipped(self) -> BoolArray:
        """(n,) frames left in a wrong case."""
        return np.asarray(np.linalg.norm(self.attitude_rad, axis=1) > _FLIPPED_RAD)

    @property
    def missed(self) -> int:
        """Frames in which the rectangle is not found."""
        return int(np.isnan(self.position_m[:, 0]).sum())

    @property
    def raw_flipped(self) -> BoolArray:
        """(n,) frames whose eigenvectors came out in another case."""
        return np.asarray(np.linalg.norm(self.raw_attitude_rad, axis=1) > _FLIPPED_RAD)


@dataclass(frozen=True)
class Turn:
    """What repetitions of a turn have in common."""

    pipeline: Pipeline
    spacing: Spacing
    outliers: int | None = None
    """Beside another face, through RANSAC and recognition; None for the rectangle alone."""


@dataclass(frozen=True)
class _Quantity:
    """Half of an error and what the paper prints of it."""

    figure: str
    name: str
    unit: str
    printed: tuple[float, float, float]
    """Largest error by axis."""
    of: Callable[[FrameErrors], FloatArray]
    """(n, 3) errors in the unit."""
    sd: Callable[[Spacing], tuple[float, float, float]]
    """By the closed form; of the two tilts, which the spin mixes, the root mean square."""

    def largest(self, errors: Sequence[FrameErrors], frames: int = COUNTED) -> FloatArray:
        """(runs, 3) largest error on each axis over the first frames of each run."""
        return np.array([np.nanmax(np.abs(self.of(each)[:frames]), axis=0) for each in errors])


def _mixed(x: float, y: float, z: float) -> tuple[float, float, float]:
    across = float(np.hypot(x, y) / np.sqrt(2.0))
    return across, across, z


def _rectangle(spacing: Spacing) -> tuple[float, float, int, float, Spacing]:
    sides = paper.RECTANGLE.width_m, paper.RECTANGLE.length_m
    return *sides, paper.CLOUD_POINTS, paper.CLOUD_NOISE_M, spacing


_QUANTITIES = (
    _Quantity(
        "Fig. 8",
        "position",
        "mm",
        paper.FIG_8_POSITION_MM,
        lambda errors: 1e3 * errors.position_m,
        lambda spacing: _mixed(*(1e3 * np.array(centroid_sd(*_rectangle(spacing))))),
    ),
    _Quantity(
        "Fig. 10",
        "attitude",
        "deg",
        paper.FIG_10_ATTITUDE_DEG,
        lambda errors: np.rad2deg(errors.attitude_rad),
        lambda spacing: _mixed(*np.rad2deg(rotation_sd(*_rectangle(spacing)))),
    ),
)


def turns(pipeline: Pipeline, count: int) -> list[Run[Turn]]:
    """So many repetitions of one turn with every kind of cloud."""
    return [
        Run(Case(spacing, Turn(pipeline, spacing), _WORK), k, pipeline.seed + 1000 * kind + k)
        for kind, spacing in enumerate(Spacing)
        for k in range(count)
    ]


def extracted_turns(pipeline: Pipeline, count: int) -> list[Run[Turn]]:
    """The same turns of even clouds through RANSAC and recognition, without outliers and with."""
    return [
        Run(Case(extracted_name(each), Turn(pipeline, Spacing.EVEN, each), _WORK), k, seed)
        for each in (0, OUTLIERS)
        for k, seed in enumerate(range(pipeline.seed, pipeline.seed + count))
    ]


def extracted_name(outliers: int) -> str:
    """Of a case of `extracted_turns`."""
    return f"even grid, RANSAC, {outliers} outliers"


def run_turn(run: Run[Turn]) -> FrameErrors:
    """One repetition."""
    turn = run.case.settings
    motion, noise_m = one_turn(turn.pipeline), turn.pipeline.noise.range_sigma_m
    clouds = CloudSensor(motion, noise_m, turn.spacing, run.seed)
    if turn.outliers is None:
        return frame_errors(motion, clouds)
    return frame_errors(motion, ExtractedSensor(clouds, turn.outliers, run.seed))


def one_turn(pipeline: Pipeline) -> TrueMotion:
    """The pipeline's motion at one frame a second for one turn."""
    return true_motion(with_scenario(pipeline, frames=FRAMES, frame_rate_hz=1.0))


def frame_errors(motion: TrueMotion, sensor: Sensor) -> FrameErrors:
    """Measure every frame; the attitude of the frame before predicts the case."""
    count = len(motion.truth.time_s)
    position, attitude, raw = np.full((3, count, 3), np.nan)
    guess = sensor.true_T_cam_rect(0)[:3, :3] @ exp_rotation(np.array(paper.FIRST_GUESS_RAD))
    for k in range(count):
        observation = sensor.observe(k)
        if observation is None:
            continue
        T_true = sensor.true_T_cam_rect(k)
        T_cam_rect = resolved(observation, guess, sensor.rectangle)
        guess = T_cam_rect[:3, :3]
        R_first_cam = motion.T_cam_world[0, :3, :3] @ motion.T_cam_world[k, :3, :3].T
        position[k] = R_first_cam @ (T_cam_rect[:3, 3] - T_true[:3, 3])
        attitude[k] = R_first_cam @ log_rotation(guess @ T_true[:3, :3].T)
        raw_turn = log_rotation(observation.T_cam_rect[:3, :3] @ T_true[:3, :3].T)
        raw[k] = R_first_cam @ raw_turn
    return FrameErrors(position, attitude, raw)


def tables(found: Mapping[str, Sequence[FrameErrors]]) -> list[TextTable]:
    """Figs. 8-10 over the repetitions with every kind of cloud."""
    return [_error_table(found), _flip_table(found[Spacing.EVEN]), _bound_table()]


def claims(by_spacing: Mapping[str, Sequence[FrameErrors]]) -> list[Claim]:
    """Largest errors in half a turn, the median over the runs, as printed, for every spacing.

    Which spacing print has is not printed: the even grid is the one that meets it.
    """
    found = [
        as_printed(
            each.figure,
            f"largest {each.name} error {axis}, {each.unit}, {spacing}",
            printed,
            ours,
        )
        for spacing, errors in by_spacing.items()
        for each in _QUANTITIES
        for axis, printed, ours in zip(
            "xyz", each.printed, np.median(each.largest(errors), axis=0), strict=True
        )
    ]
    flips = sum(int(errors.flipped.sum()) for errors in by_spacing[Spacing.EVEN])
    return [*found, as_printed("Fig. 10", "frames flipped by 180 degrees, even grid", 0, flips)]


def _error_table(found: Mapping[str, Sequence[FrameErrors]]) -> TextTable:
    rows = []
    for spacing, each in ((spacing, each) for spacing in found for each in _QUANTITIES):
        errors = found[spacing]
        # The closed form is that of the moments alone.
        closed = Spacing(spacing) if spacing in {*Spacing} else Spacing.EVEN
        worst, whole_turn = each.largest(errors), each.largest(errors, FRAMES)
        low, high = np.percentile(worst, [2.5, 97.5], axis=0)
        rms = np.sqrt(np.nanmean(np.concatenate([each.of(e) for e in errors]) ** 2, axis=0))
        for k, axis in enumerate("xyz"):
            rows.append(
                (
                    spacing,
                    f"{each.name} {axis}, {each.unit}",
                    each.printed[k],
                    each.sd(closed)[k],
                    rms[k],
                    np.median(worst[:, k]),
                    f"{cell(low[k])} to {cell(high[k])}",
                    f"{np.mean(worst[:, k] <= each.printed[k]):.0%} of runs",
                    np.median(whole_turn[:, k]),
                    sum(each.missed for each in errors),
                )
            )
    header = (
        *("cloud", "quantity", "printed", "closed-form sd", "RMS", "largest", "95 % of runs"),
        *("at most printed", "largest, whole turn", "frames not found"),
    )
    return table(
        "figs_8_10",
        header,
        rows,
        text_columns=2,
    )


def _flip_table(even: Sequence[FrameErrors]) -> TextTable:
    frames = FRAMES * len(even)
    cases = (
        ("not solved (Fig. 9)", sum(int(errors.raw_flipped.sum()) for errors in even)),
        ("solved (Fig. 10)", sum(int(errors.flipped.sum()) for errors in even)),
    )
    return table(
        "fig_9",
        ("ambiguity", "frames", "wrong case", "share"),
        [(name, frames, flips, f"{flips / frames:.1%}") for name, flips in cases],
    )


def _bound_table() -> TextTable:
    rows = []
    for length in _BOUND_SIDES_M:
        width = paper.SHORT_CM / paper.LONG_CM * length
        row: list[object] = [f"{cell(width)} x {cell(length)}"]
        for spacing in (Spacing.EVEN, Spacing.INDEPENDENT):
            cloud = (width, length, paper.CLOUD_POINTS, paper.CLOUD_NOISE_M, spacing)
            row += [1e3 * max(centroid_sd(*cloud)), np.rad2deg(max(rotation_sd(*cloud)))]
        rows.append(row)
    return table(
        "cloud_bound",
        (
            "rectangle, m",
            *("even: position sd, mm", "even: attitude sd, deg"),
            *("independent: position sd, mm", "independent: attitude sd, deg"),
        ),
        rows,
    )


def figures(pipeline: Pipeline, errors: FrameErrors, suffix: str = "") -> list[StudyFigure]:
    """Figs. 8-10 of one turn, their keys with a suffix."""
    time_s = one_turn(pipeline).truth.time_s
    position, attitude = (
        [
            error_panel(f"{axis}, {each.unit}", each.of(errors)[:, k], printed=each.printed[k])
            for k, axis in enumerate("xyz")
        ]
        for each in _QUANTITIES
    )
    raw = [
        Panel(f"{axis}, deg", [Curve("error", column, style=".")], Scale.ABOUT_ZERO)
        for axis, column in zip("xyz", np.rad2deg(errors.raw_attitude_rad).T, strict=True)
    ]
    return [
        StudyFigure(f"fig_08{suffix}", panels_figure(time_s, position)),
        StudyFigure(f"fig_09{suffix}", panels_figure(time_s, raw)),
        StudyFigure(f"fig_10{suffix}", panels_figure(time_s, attitude)),
    ]
