"""What a forecast begins from: the last estimate of a result folder, and how it moves on."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from pcnav.config.depth import MotionChoice
from pcnav.config.pipeline_file import Pipeline
from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.dynamics.blocks import (
    ATTITUDE,
    CENTRE,
    MASS_CENTRE_LAYOUT,
    POSITION,
    RATE,
    RATIOS,
    VELOCITY,
)
from pcnav.dynamics.state import STATE_SIZE, NavigationState
from pcnav.dynamics.trajectory import Trajectory
from pcnav.evaluation.answer.model import Answer
from pcnav.evaluation.forecast.accelerations import Accelerations, accelerations_of_run
from pcnav.files.regular_file import read_bytes
from pcnav.runs.reader import read_run
from pcnav.runs.result_files import COVARIANCES_FILE, STATES_FILE, SUMMARY_FILE
from pcnav.runs.run import Run

_MAX_BYTES = 10_000_000
_NEEDED = (POSITION, VELOCITY, ATTITUDE, RATE, RATIOS)


@dataclass(frozen=True)
class ForecastStart:
    """A state with its doubts, and the motion that it goes on in."""

    time_s: float
    state: NavigationState
    covariance: FloatArray
    """(20, 20) of its error, the inertia's part by the ratios, as results have it."""
    mean_motion_rad_s: float
    torque_free: bool
    """Else pose and twist go on as they are, but for the accelerations."""
    accelerations: Accelerations
    """That disturb the motion."""
    mesh_scale: float = 1.0
    """By which the target is larger than its mesh."""


def read_start(folder: Path) -> tuple[ForecastStart, Answer, Run]:
    """The start of a forecast, the answer of the run, and the run with its covariances.

    Raises `InputError` for a folder that is missing or damaged, and for a run that does not tell
    position, velocity, attitude, rate and inertia, or found nothing.
    """
    run = read_run(folder, with_covariance=True)
    answer = read_answer(folder)
    trajectory, known = run.trajectory, np.flatnonzero(run.has_estimate)
    missing = [block.title for block in _NEEDED if block not in trajectory.layout]
    if missing:
        expected = f"expected a run that estimates {missing[0]}, which a forecast needs"
        raise InputError(folder / STATES_FILE, "header", expected)
    if trajectory.covariance is None:
        raise InputError(folder / COVARIANCES_FILE, "file", "expected the run's covariances")
    if not known.size or not answer.found:
        raise InputError(folder, "run", "expected one that found the target")
    if answer.mean_motion_rad_s is None:
        raise InputError(folder, "orbit", "expected a circular one")
    last, words = int(known[-1]), run.words.get("motion")
    torque_free = words is None or words[last] == MotionChoice.TORQUE_FREE
    accelerations = _stated(run.pipeline)
    if not torque_free:
        accelerations = accelerations_of_run(run, answer.mean_motion_rad_s)
    start = ForecastStart(
        float(run.time_s[last]),
        state_at(trajectory, last),
        covariance_at(trajectory, last),
        answer.mean_motion_rad_s,
        torque_free,
        accelerations,
        mesh_scale=answer.mesh_scale,
    )
    return start, answer, run


def read_answer(folder: Path) -> Answer:
    """The answer in a result folder. Raises `InputError`."""
    path = folder / SUMMARY_FILE
    try:
        what = "what `pcnav run` writes at its end; run it again with this version"
        return Answer.model_validate_json(read_bytes(path, _MAX_BYTES, what))
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(map(str, first["loc"])) or "file"
        raise InputError(path, field, f"expected {first['msg']}") from error


def _stated(pipeline: Pipeline | None) -> Accelerations:
    """Disturbances of a free body as the run's filter had them."""
    table = (Pipeline() if pipeline is None else pipeline).filter
    return Accelerations.known(table.acceleration_psd_m2_s3, table.angular_acceleration_psd_rad2_s3)


def state_at(trajectory: Trajectory, k: int) -> NavigationState:
    """The state in frame k; of a run without a model the mass centre is the frame's origin."""
    if CENTRE in trajectory:
        return NavigationState.of(trajectory, k)
    values = {**trajectory.values, CENTRE.name: np.zeros((len(trajectory), 3))}
    return NavigationState.of(Trajectory(trajectory.time_s, trajectory.layout, values), k)


def covariance_at(trajectory: Trajectory, k: int) -> FloatArray:
    """(20, 20) in frame k; zero of what the run does not estimate."""
    assert trajectory.covariance is not None, "it was asked for"
    rows = np.concatenate(
        [
            np.arange(STATE_SIZE)[MASS_CENTRE_LAYOUT.slice_of(block)]
            for block in trajectory.layout.blocks
        ]
    )
    covariance = np.zeros((STATE_SIZE, STATE_SIZE))
    covariance[np.ix_(rows, rows)] = trajectory.covariance[k]
    return covariance
