"""From images to inertia: the chain's attitudes feed the filter on attitudes (Deng 2024)."""

from dataclasses import dataclass

import numpy as np

from pcnav.batch.cluster import Workers
from pcnav.batch.engine import run_all
from pcnav.batch.monte_carlo import run_seed
from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.core import chi_square
from pcnav.core.arrays import FloatArray
from pcnav.estimators.attitude_inertia.chained_inertia import ChainedInertiaEstimator
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    printed_covariance,
    printed_from_parameters,
)
from pcnav.estimators.image_motion.chain import run_chain
from pcnav.evaluation.metrics import squared_normalised_errors
from pcnav.files.text_table import TextTable, number
from pcnav.simulation.images import TrackFaults

from ..folder import Chapter
from ..progress import Progress
from . import campaign, paper
from .scene import nutation, tracks_of

INTERVAL_S = 5.0
"""Between frames: the turn is then large enough to be measured from one to the next."""
DURATION_S = 1200.0
"""A little over three turns of the target."""
_SHARES = (0.1, 0.25, 0.5, 1.0)
_NOISES_PX = (0.02, 0.1)
_POINTS = 200
"""All around the hull: about half of them are in view."""
_TABLE = AttitudeInertiaTable(
    rate_sd_deg_s=1.0, inertia_ratio_sd=0.3, angular_acceleration_psd_rad2_s3=1e-14
)


@dataclass(frozen=True)
class JoinedTask:
    """One run."""

    sigma_px: float
    duration_s: float
    seed: int

    def __str__(self) -> str:
        return f"inertia from images, {self.sigma_px:g} px (seed {self.seed})"


@dataclass(frozen=True)
class JoinedErrors:
    """One run: what is believed of the ratios when the arc was so long."""

    times_s: FloatArray
    """(k,) of the frames with an estimate."""
    error: FloatArray
    """(k, 5) of Jxx, Jyy, Jxy, Jxz, Jyz over Jzz."""
    covariance: FloatArray
    """(k, 5, 5) stated."""
    share: float
    """Of the frames with an attitude."""


def joined_tasks(runs: int, duration_s: float) -> list[JoinedTask]:
    """All runs of the chapter."""
    return [
        JoinedTask(sigma, duration_s, run_seed(f"{campaign.STUDY} joined", index))
        for sigma in _NOISES_PX
        for index in range(runs)
    ]


def joined_frames(tasks: list[JoinedTask]) -> int:
    """Frames in all."""
    return sum(round(task.duration_s / INTERVAL_S) + 1 for task in tasks)


def run_joined(task: JoinedTask) -> JoinedErrors:
    """Simulate tracks, chain attitudes, filter them."""
    truth = nutation(task.duration_s, INTERVAL_S, task.seed, _POINTS)
    tracks = tracks_of(truth, TrackFaults(task.sigma_px), task.seed)
    settings = campaign.KEY_FRAMES.model_copy(update={"pixel_sigma_px": task.sigma_px})
    frames = run_chain(tracks, settings)
    inertia = paper.INERTIA_KG_M2
    entries = ((0, 0), (1, 1), (0, 1), (0, 2), (1, 2))
    true_ratios = np.array([inertia[i, j] for i, j in entries]) / inertia[2, 2]
    estimator = ChainedInertiaEstimator(_TABLE)
    times, errors, covariances = [], [], []
    for frame in frames:
        estimate = estimator.step(frame)
        if estimate is None:
            continue
        covariance = printed_covariance(estimate.state, estimate.covariance[None])[0]
        times.append(frame.time_s)
        errors.append(printed_from_parameters(estimate.state.parameters[0]) - true_ratios)
        covariances.append(covariance[INERTIA, INERTIA])
    measured = sum(frame.R_world_body is not None for frame in frames)
    return JoinedErrors(
        np.array(times), np.array(errors), np.stack(covariances), measured / len(frames)
    )


def joined_chapter(tasks: list[JoinedTask], workers: Workers, progress: Progress) -> Chapter:
    """Run all and lay them out: error of the ratios against the length of the arc."""
    frames = joined_frames(tasks) // max(len(tasks), 1)
    found = run_all(run_joined, tasks, workers, lambda: progress.add(frames))
    rows = []
    for sigma in _NOISES_PX:
        runs = [result for task, result in zip(tasks, found, strict=True) if task.sigma_px == sigma]
        for share in _SHARES:
            length_s = share * tasks[0].duration_s
            last = [int(np.searchsorted(run.times_s, length_s + 1e-6)) - 1 for run in runs]
            error = np.stack([run.error[k] for run, k in zip(runs, last, strict=True)])
            stated = np.stack([run.covariance[k] for run, k in zip(runs, last, strict=True)])
            nees = squared_normalised_errors(error, stated)
            sd = np.sqrt(np.diagonal(stated, axis1=1, axis2=2))
            rows.append(
                (
                    f"{sigma:g} px",
                    f"{length_s:g}",
                    f"{np.mean([run.share for run in runs]):.0%}",
                    number(float(np.sqrt(np.mean(error**2)))),
                    number(float(np.max(np.abs(error)))),
                    number(float(np.sqrt(np.mean(sd**2)))),
                    number(float(np.mean(nees)) / 5.0),
                )
            )
    header = (
        "noise",
        "arc, s",
        "frames with an attitude",
        "RMS error of the ratios",
        "largest",
        "stated sd",
        "NEES per dof",
    )
    runs_each = len(tasks) // len(_NOISES_PX)
    low, high = (
        float(chi_square.quantile(p, 5 * runs_each)) / (5 * runs_each) for p in (0.025, 0.975)
    )
    note = (
        "Jxx, Jyy, Jxy, Jxz, Jyz over Jzz, from a prior of 0.3 about those of a ball; "
        f"{runs_each} runs of each noise, a frame every {INTERVAL_S:g} s. The 95 % bounds of the "
        f"NEES of {runs_each} runs are {low:.2f} to {high:.2f}."
    )
    text = (
        "The attitudes of the robust chain with key frames are all that the estimator is given: "
        "rates and inertia ratios come from images alone. Their errors share the noise of the key "
        "frames, so all attitudes are fitted as one arc under the joint covariance of their "
        "errors. Taken as independent they would lead to ratios far less accurate than stated. "
        "Where the chain has to begin anew, its axes are tied to the attitude that the motion "
        "predicts.",
    )
    table = TextTable("inertia_from_images", "Inertia ratios", header, tuple(rows), note)
    return Chapter("Inertia ratios from images alone", text, (table,))
