"""Made-up runs of every kind, written and read, whose errors are drawn from what they state."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.dynamics.blocks import (
    ATTITUDE,
    ATTITUDE_LAYOUT,
    CENTRE,
    MASS_CENTRE_LAYOUT,
    MOTION_LAYOUT,
    POSE_LAYOUT,
    POSITION,
    RATE,
    RATIOS,
    ROTATION_LAYOUT,
    VELOCITY,
)
from pcnav.dynamics.trajectory import Trajectory
from pcnav.evaluation.metrics import evaluate
from pcnav.report.content import ReportContent
from pcnav.runs.estimate import Estimate, FeaturePoint, FeatureUse, Output
from pcnav.runs.reader import read_run
from pcnav.runs.records import ACCEPTED, RectangleRecord
from pcnav.runs.writer import RunWriter

FIRST_ESTIMATE = 3
FRAME_S = 0.5
KINDS = {
    "depth": Output(MASS_CENTRE_LAYOUT, notes=("inlier_ratio", "n_rectangles"), has_records=True),
    "principal_axes": Output(
        MOTION_LAYOUT, notes=("n_features", "n_used", "n_rejected", "p_x"), has_features=True
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
POINTS = {4: np.array([1.0, 0.0, -0.5]), 7: np.array([-0.4, 0.9, 0.0])}
_SD = {
    POSITION.name: 0.05,
    VELOCITY.name: 0.002,
    CENTRE.name: 0.03,
    ATTITUDE.name: 0.01,
    RATE.name: 0.001,
    RATIOS.name: 0.02,
}
_OUTCOMES = (ACCEPTED, "side too short", ACCEPTED, "normal away from camera <45 deg>")


@dataclass(frozen=True)
class MadeRun:
    """Estimates of a kind and the truth behind them."""

    kind: str
    estimates: tuple[Estimate, ...]
    truth: Trajectory

    def content(self, folder: Path, *, with_truth: bool = True) -> ReportContent:
        """What a report is made from, of the run written to a folder and read again."""
        with RunWriter(folder, KINDS[self.kind]) as writer:
            for each in self.estimates:
                writer.add(each)
        run = replace(read_run(folder, with_covariance=True), estimator=self.kind)
        truth = self.truth if with_truth else None
        return ReportContent(
            title="run <one> & two",
            command='pcnav run "a b" --target x.toml',
            run=run,
            metrics=evaluate(run, truth, true_points=POINTS if with_truth else None),
            configuration={"seed": 7, "noise": {"range_sigma_m": 0.02, "extra": None}, "v": (1, 2)},
            versions={"numpy": "9.9.<9>"},
            target="bus <b>bold</b>" if CENTRE in run.trajectory else None,
        )


@pytest.fixture(scope="session")
def make_run() -> Callable[..., MadeRun]:
    """Makes a run of a kind and of so many frames, its errors ``inflation`` times as stated."""

    def make(kind: str, frames: int, inflation: float = 1.0) -> MadeRun:
        generator, truth = np.random.default_rng(7), _truth(frames)
        estimates = tuple(
            _estimate(k, truth, KINDS[kind], generator, inflation) for k in range(frames)
        )
        # Recordings of feature tracks know the true states, not poses of a model.
        known = replace(truth, T_cam_target=None) if KINDS[kind].has_features else truth
        return MadeRun(kind, estimates, known)

    return make


def _truth(frames: int) -> Trajectory:
    """A smooth motion; it need not obey any dynamics to be compared with. The axes are principal
    ones."""
    t = np.arange(frames, dtype=np.float64) * FRAME_S
    still = np.zeros(frames)
    R = exp_rotation(np.outer(t, [0.02, 0.15, -0.03])).reshape(-1, 3, 3)
    return Trajectory(
        time_s=t,
        layout=MASS_CENTRE_LAYOUT,
        values={
            POSITION.name: np.stack([25.0 + 0.01 * t, np.sin(0.02 * t), still + 0.3], axis=1),
            VELOCITY.name: np.stack([still + 0.01, 0.01 * np.cos(0.02 * t), still], axis=1),
            CENTRE.name: np.tile([0.12, -0.05, 0.2], (frames, 1)),
            ATTITUDE.name: R,
            RATE.name: np.tile([0.02, 0.15, -0.03], (frames, 1)),
            RATIOS.name: np.tile([0.8, 0.6, 0.0, 0.0, 0.0], (frames, 1)),
        },
        T_cam_target=make_transform(R, np.array([0.1, 0.2, 9.0])),
    )


def _estimate(
    k: int, truth: Trajectory, output: Output, generator: np.random.Generator, inflation: float
) -> Estimate:
    """One frame; some after the first estimate have no measurement, and every seventh more."""
    time_s, used = FRAME_S * k, int(generator.integers(0, 4))
    if k < FIRST_ESTIMATE:
        words = {"outcome": "too few <features>"} if "outcome" in output.notes else {}
        return Estimate(time_s, "acquiring", notes=words)
    blocks, values = output.layout.blocks, {}
    sd = np.array([_SD[block.name] for block in blocks for _ in range(block.size)])
    sd = sd * (0.15 + np.exp(-time_s / 10.0))
    if output.has_features:
        # The axes are principal ones by definition: three of the ratios are fixed.
        sd[-3:] = 0.0
    error = inflation * sd * generator.standard_normal(output.layout.size)
    for block in output.blocks:
        true = truth[block][k]
        own = error[output.layout.slice_of(block)] if block in blocks else np.zeros(block.size)
        values[block.name] = true @ exp_rotation(-own) if block is ATTITUDE else true - own
    records = tuple(
        RectangleRecord(
            time_s=time_s,
            rectangle=("front", "panel, +y", "", "rear")[j],
            length_m=4.0 / 3.0 + j,
            width_m=1.0,
            T_cam_rect=np.eye(4),
            sd=np.ones(6),
            case="IXYZ"[j],
            outcome=_OUTCOMES[j],
        )
        for j in range(used + (k % 7 == 0))
    )
    points = {
        i: FeaturePoint(p + 0.01 * generator.standard_normal(3), 1e-4 * np.eye(3))
        for i, p in POINTS.items()
    }
    notes = {
        "inlier_ratio": 0.95 + 0.04 * np.sin(0.3 * k),
        "n_rectangles": used,
        "n_features": 4,
        "n_used": used,
        "n_rejected": 4 - used,
        "p_x": 0.1 * k,
        "sd_measured_rad": 0.01 if used else None,
        "outcome": "measured" if used else "too few <features>",
        "segment": 0,
        "features": 40,
        "matches": 30 + used,
        "agreeing": 20 + used,
    }
    new_axes = values[ATTITUDE.name] if k == FIRST_ESTIMATE and "outcome" in output.notes else None
    pose = truth.T_cam_target
    assert pose is not None
    has_nis = output.has_nis and used > 0
    return Estimate(
        time_s=time_s,
        status="locked" if used else "coasting",
        values=values,
        covariance=np.diag(sd**2) if blocks else None,
        T_cam_target=pose[k] @ make_transform(np.eye(3), 0.001 * generator.standard_normal(3))
        if output.has_poses
        else None,
        nis=float(generator.chisquare(6 * used)) if has_nis else np.nan,
        nis_dof=6 * used if has_nis else 0,
        notes={name: notes[name] for name in output.notes},
        records=records if output.has_records else (),
        features=FeatureUse((4, 7), (4,), (7,), points) if output.has_features else FeatureUse(),
        new_axes=new_axes,
    )
