"""From a run to its answer."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

import pcnav
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.mass_prior import PriorMass
from pcnav.evaluation.answer.findings import Found, findings
from pcnav.evaluation.answer.model import Answer, FinalEstimate, RunState
from pcnav.evaluation.answer.sources import Sources
from pcnav.evaluation.answer.stated_priors import stated_prior_sd
from pcnav.evaluation.consistency import finite_or_none
from pcnav.evaluation.diagnosis import claimed_frames
from pcnav.evaluation.metrics import Metrics
from pcnav.runs.run import Run


@dataclass(frozen=True)
class About:
    """What is known of a run beside its tables."""

    recording: str = ""
    target: str | None = None
    symmetry: str = "C1"
    mesh_scale: float = 1.0
    orbit: KeplerOrbit | None = None
    """Of the chaser; None where nobody knows of one."""
    prior: PriorMass | None = None
    """Of the target's mass, before the first frame."""
    budget: Mapping[str, FloatArray] = field(default_factory=dict)
    """(n, n) parts of the covariance of the last claimed estimate, by what makes them."""
    warnings: tuple[str, ...] = ()
    state: RunState = RunState.FINISHED


def answer_of(run: Run, metrics: Metrics, about: About) -> Answer:
    """The answer of a run that was read with its covariances."""
    claimed, nis = claimed_frames(run), metrics.nis
    orbit = about.orbit
    circular = orbit is not None and orbit.eccentricity == 0.0
    return Answer(
        pcnav=pcnav.__version__,
        state=about.state,
        found=bool(claimed.any()),
        estimate=final_estimate(run, about),
        frames=len(run),
        frames_claimed=int(claimed.sum()),
        duration_s=metrics.duration_s,
        status_share=metrics.status_share,
        nis_per_dof=finite_or_none(nis.mean_per_degree),
        nis_bounds=(nis.lower, nis.upper) if nis.frames else None,
        warnings=about.warnings,
        recording=about.recording,
        estimator=run.estimator,
        target=about.target,
        symmetry=about.symmetry,
        mesh_scale=about.mesh_scale,
        mean_motion_rad_s=orbit.mean_motion_rad_s if orbit is not None and circular else None,
    )


def final_estimate(run: Run, about: About) -> FinalEstimate | None:
    """The last estimate that a run stands for, else the last one; None of a run without."""
    k = run.final_frame
    if k is None:
        return None
    trajectory = run.trajectory
    T_cam_target = _known(trajectory.T_cam_target, k)
    covariance = _known(trajectory.covariance, k)
    time_s = float(run.time_s[k])
    hill = None if about.orbit is None else about.orbit.R_hill_world(time_s)
    values = {name: array[k] for name, array in trajectory.values.items()}
    values = {name: value for name, value in values.items() if np.isfinite(value).all()}
    is_claimed = bool(run.claimed[k])
    layout = trajectory.layout
    told = stated_prior_sd(run.estimator, run.pipeline, layout)
    budget = about.budget if is_claimed else {}
    sources = Sources.of(values, covariance, about.prior, hill, is_claimed, told)
    motion = run.words.get("motion")
    return FinalEstimate(
        frame=k,
        time_s=time_s,
        age_s=float(run.time_s[-1]) - time_s,
        status=run.status[k],
        is_claimed=is_claimed,
        motion=motion[k] or None if motion else None,
        T_cam_target=_rows(T_cam_target),
        findings=findings(Found(values, layout, sources, T_cam_target, hill, budget)),
    )


def _known(arrays: FloatArray | None, k: int) -> FloatArray | None:
    return None if arrays is None or not np.isfinite(arrays[k]).all() else arrays[k]


def _rows(T: FloatArray | None) -> tuple[tuple[float, float, float, float], ...] | None:
    if T is None:
        return None
    a, b, c, d = ((float(w), float(x), float(y), float(z)) for w, x, y, z in T)
    return a, b, c, d
