"""Made-up runs of every kind, whose errors are drawn from the covariance that they state."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.blocks import (
    ATTITUDE,
    ATTITUDE_LAYOUT,
    BLOCKS,
    MASS_CENTRE_LAYOUT,
    MOTION_LAYOUT,
    POSE_LAYOUT,
    RATE,
    ROTATION_LAYOUT,
)
from pcnav.dynamics.state import INERTIA_RATIOS, STATE_SIZE, NavigationState
from pcnav.dynamics.trajectory import Trajectory
from pcnav.runs.estimate import Estimate, FeaturePoint, FeatureUse, Output
from pcnav.runs.reader import read_run
from pcnav.runs.records import ACCEPTED, RectangleRecord
from pcnav.runs.run import Run
from pcnav.runs.writer import RunWriter

KINDS = {
    "depth": Output(MASS_CENTRE_LAYOUT, notes=("inlier_ratio", "n_rectangles"), has_records=True),
    "inertia_bank": Output(
        MOTION_LAYOUT, notes=("n_features", "n_used", "n_rejected", "hypothesis"), has_features=True
    ),
    "attitude_inertia": Output(ROTATION_LAYOUT, notes=("sd_measured_rad",)),
    "image_motion": Output(
        ATTITUDE_LAYOUT,
        (RATE,),
        ("outcome", "segment", "features", "matches", "agreeing"),
        has_nis=False,
    ),
    "open3d_icp": Output(POSE_LAYOUT, has_nis=False),
}
"""As the estimators of these names have them."""
FIRST_ESTIMATE = 3
POINTS = {4: np.array([1.0, 0.0, -0.5]), 7: np.array([-0.4, 0.9, 0.0])}
"""True points of the body, by feature."""
_SD = np.repeat([0.05, 0.002, 0.03, 0.01, 0.001, 0.02], [3, 3, 3, 3, 3, 5])
_T_CAM_WORLD = make_transform(exp_rotation(np.array([0.3, -1.2, 0.4])), np.zeros(3))
_OUTCOMES = (ACCEPTED, "side too short", ACCEPTED, "normal away from camera <45 deg>")


@dataclass(frozen=True)
class MadeRun:
    """The frames of a run and the truth behind them."""

    kind: str
    estimates: tuple[Estimate, ...]
    truth: Trajectory

    def stored(self, folder: Path) -> Run:
        """The run with its covariances, by way of the disk."""
        with RunWriter(folder, KINDS[self.kind]) as writer:
            for each in self.estimates:
                writer.add(each)
        return replace(read_run(folder, with_covariance=True), estimator=self.kind)


def made_run(kind: str, frames: int, inflation: float = 1.0) -> MadeRun:
    """Of so many frames, with errors ``inflation`` times what is stated."""
    generator, output = np.random.default_rng(7), KINDS[kind]
    states = [_true_state(0.5 * k) for k in range(frames)]
    estimates = tuple(
        _estimate(k, state, output, generator, inflation) for k, state in enumerate(states)
    )
    poses = np.array([_pose(state) for state in states]).reshape(-1, 4, 4)
    truth = Trajectory(
        time_s=0.5 * np.arange(frames, dtype=np.float64),
        layout=MASS_CENTRE_LAYOUT,
        values={name: np.array([each.values[name] for each in states]) for name in BLOCKS}
        if states
        else {},
        # Recordings of feature tracks know the true states, not poses of a model.
        T_cam_target=None if output.has_features else poses,
    )
    return MadeRun(kind, estimates, truth)


def _true_state(time_s: float) -> NavigationState:
    """A smooth motion; it need not obey any dynamics to be compared with."""
    return NavigationState(
        r_hill=np.array([25.0 + 0.01 * time_s, -1.0 + 0.5 * np.sin(0.02 * time_s), 0.3]),
        v_hill=np.array([0.01, 0.01 * np.cos(0.02 * time_s), 0.0]),
        com_model=np.array([0.12, -0.05, 0.2]),
        R_world_body=exp_rotation(np.array([0.02, 0.15, -0.03]) * time_s),
        omega_body=np.array([0.02, 0.15, -0.03]),
        inertia_ratios=np.array([1.3, 0.8, 0.02, -0.01, 0.03]),
    )


def _covariance(generator: np.random.Generator, time_s: float) -> FloatArray:
    """A (20, 20) covariance with strong correlations that shrinks with time."""
    factor = np.eye(STATE_SIZE) + 0.5 * generator.standard_normal((STATE_SIZE, STATE_SIZE))
    correlation = factor @ factor.T
    scale = _SD * (0.15 + np.exp(-time_s / 10.0)) / np.sqrt(np.diagonal(correlation))
    return np.asarray(correlation * scale[:, None] * scale)


def _pose(state: NavigationState) -> FloatArray:
    return state.T_cam_model(_T_CAM_WORLD, np.eye(3))


def _estimate(
    index: int,
    truth: NavigationState,
    output: Output,
    generator: np.random.Generator,
    inflation: float,
) -> Estimate:
    """One frame. Some have no measurement; every seventh has a rectangle that is not used."""
    time_s, used = 0.5 * index, int(generator.integers(0, 4))
    nis = float(generator.chisquare(6 * used)) if used else np.nan
    notes: dict[str, float | str | None] = {
        "inlier_ratio": 0.95 + 0.04 * float(np.sin(0.3 * index)),
        "n_rectangles": used,
        "n_features": 4,
        "n_used": used,
        "n_rejected": 4 - used,
        "hypothesis": 0.1 * index,
        "sd_measured_rad": 0.01 if used else None,
        "outcome": "measured" if used else "too few <features>",
        "segment": 0,
        "features": 40,
        "matches": 30 + used,
        "agreeing": 20 + used,
    }
    if index < FIRST_ESTIMATE:
        notes |= {"n_rectangles": 0, "outcome": "too few <features>"}
        known = [name for name in ("n_rectangles", "outcome") if name in output.notes]
        return Estimate(time_s, "acquiring", notes={name: notes[name] for name in known})
    P = _covariance(generator, time_s)
    # The truth is the estimate moved by the error; with a small error the reverse holds as well.
    # The covariance is that of a result: by the inertia ratios, not by the filter's parameters.
    off = generator.multivariate_normal(np.zeros(STATE_SIZE), P, method="cholesky") * -inflation
    ratios = truth.inertia_ratios + off[INERTIA_RATIOS]
    off[INERTIA_RATIOS] = 0.0
    state = replace(truth.retract(off), inertia_ratios=ratios)
    rows = [slice(0, 0), *(MASS_CENTRE_LAYOUT.slice_of(block) for block in output.layout.blocks)]
    own = np.concatenate([np.arange(STATE_SIZE)[part] for part in rows])
    records = tuple(
        RectangleRecord(
            time_s=time_s,
            rectangle=("front", "panel, +y", "", "rear")[k],
            length_m=4.0 / 3.0 + k,
            width_m=1.0,
            T_cam_rect=_pose(state),
            sd=np.array([0.001, 0.002, np.inf, 0.01, 0.02, 0.03]) * (k + 1),
            case="IXYZ"[k],
            outcome=_OUTCOMES[k],
        )
        for k in range(used + (index % 7 == 0))
    )
    points = {feature: FeaturePoint(p + 0.01, 1e-4 * np.eye(3)) for feature, p in POINTS.items()}
    begins = index == FIRST_ESTIMATE and "segment" in output.notes
    return Estimate(
        time_s=time_s,
        status="locked" if used else "coasting",
        values={block.name: state.values[block.name] for block in output.blocks},
        covariance=P[np.ix_(own, own)] if own.size else None,
        T_cam_target=_pose(state) if output.has_poses else None,
        nis=nis if output.has_nis else np.nan,
        nis_dof=6 * used if output.has_nis else 0,
        notes={name: notes[name] for name in output.notes},
        records=records if output.has_records else (),
        features=FeatureUse((4, 7), (4,), (7,), points) if output.has_features else FeatureUse(),
        new_axes=state.values[ATTITUDE.name] if begins else None,
    )
