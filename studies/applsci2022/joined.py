"""From images to inertia: the chain's attitudes feed the filter on attitudes (Deng 2024)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.batch.monte_carlo import Run, runs_of
from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.core.arrays import FloatArray
from pcnav.core.statistics import MeanSquared, mean_squared, root_mean_square
from pcnav.dynamics.inertia_parameters import parameters_of
from pcnav.estimators.attitude_inertia.chained_inertia import ChainedInertiaEstimator
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    printed_covariance,
    printed_from_parameters,
)
from pcnav.evaluation.consistency import squared_normalised_errors
from pcnav.files.text_table import TextTable
from pcnav.simulation.images import TrackFaults

from ..tables import table
from . import paper
from .runs import KEY_FRAMES, STUDY, Chained

INTERVAL_S = 5.0
"""Between frames: the turn is then large enough to be measured from one to the next."""
DURATION_S = 1200.0
"""A little over three turns of the target."""
_SHARES = (0.1, 0.25, 0.5, 1.0)
_NOISES_PX = (0.02, 0.1)
SIZE = 5
"""Ratios."""
_POINTS = 200
"""All around the hull: about half of them are in view."""
_TABLE = AttitudeInertiaTable(
    rate_sd_deg_s=1.0, inertia_ratio_sd=0.3, angular_acceleration_psd_rad2_s3=1e-14
)


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

    def last_up_to(self, time_s: float) -> int:
        """The last estimate up to a time."""
        return int(np.searchsorted(self.times_s, time_s + 1e-6)) - 1


def joined_runs(count: int, duration_s: float) -> list[Run[Chained]]:
    """So many runs of every noise."""
    cases = [
        Chained(KEY_FRAMES, TrackFaults(sigma), INTERVAL_S, duration_s, _POINTS).case(
            f"{sigma:g} px"
        )
        for sigma in _NOISES_PX
    ]
    return runs_of(f"{STUDY} joined", cases, count)


def run_joined(run: Run[Chained]) -> JoinedErrors:
    """Simulate tracks, chain attitudes, filter them."""
    _, frames = run.case.settings.frames(run.seed)
    true_ratios = printed_from_parameters(parameters_of(paper.INERTIA_KG_M2))
    estimator = ChainedInertiaEstimator(_TABLE)
    steps = ((frame.time_s, estimator.step(frame)) for frame in frames)
    found = [(time_s, each.state, each.covariance) for time_s, each in steps if each is not None]
    covariances = [printed_covariance(state, P[None])[0] for _, state, P in found]
    return JoinedErrors(
        np.array([time_s for time_s, _, _ in found]),
        np.array([state.printed_ratios[0] - true_ratios for _, state, _ in found]),
        np.stack(covariances)[:, INERTIA, INERTIA],
        float(np.mean([frame.R_world_body is not None for frame in frames])),
    )


def nees_at(runs: Sequence[JoinedErrors], length_s: float) -> MeanSquared:
    """Mean over the runs, after an arc of a length."""
    last = [(run, run.last_up_to(length_s)) for run in runs]
    error = np.stack([run.error[k] for run, k in last])
    stated = np.stack([run.covariance[k] for run, k in last])
    return mean_squared(squared_normalised_errors(error, stated), SIZE)


def joined_table(by_case: Mapping[str, Sequence[JoinedErrors]], duration_s: float) -> TextTable:
    """Error of the ratios against the length of the arc."""
    rows = []
    for name, runs in by_case.items():
        for part in _SHARES:
            length_s = part * duration_s
            last = [(run, run.last_up_to(length_s)) for run in runs]
            error = np.stack([run.error[k] for run, k in last])
            stated = np.stack([run.covariance[k] for run, k in last])
            nees = squared_normalised_errors(error, stated).mean() / SIZE
            sd = np.sqrt(np.diagonal(stated, axis1=1, axis2=2))
            seen = f"{np.mean([run.share for run in runs]):.0%}"
            errors = (root_mean_square(error), np.abs(error).max(), root_mean_square(sd))
            rows.append((name, f"{length_s:g}", seen, *errors, nees))
    header = (
        "noise",
        "arc, s",
        "frames with an attitude",
        "RMS error of the ratios",
        "largest",
        "stated sd",
        "NEES per dof",
    )
    return table("inertia_from_images", header, rows)
