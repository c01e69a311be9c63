"""A body of revolution, followed up to turns about its axis."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from pcnav.config.pipeline_file import Pipeline
from pcnav.dynamics.blocks import ATTITUDE, RATE
from pcnav.runs.status import Status
from pcnav.simulation.depth import Scene
from pcnav.target.satellite import Target, load_target
from studies.following import JudgedRun, follow

PIPELINE = {
    "seed": 3,
    "scenario": {"frames": 9, "frame_rate_hz": 2.0},
    "orbit": {"r_hill_m": (20.0, 0.0, 0.0)},
    "body": {"attitude_rotvec_deg": (25.0, 50.0, -30.0), "omega_body_deg_s": (1.6, -1.1, 2.0)},
    "noise": {"range_sigma_m": 0.012},
}


@pytest.fixture(scope="module")
def followed(tmp_path_factory: pytest.TempPathFactory) -> tuple[Target, JudgedRun]:
    nozzle = trimesh.creation.cone(0.7, 1.2, sections=64)
    nozzle.apply_translation((0.0, 0.0, 1.6))
    stage = trimesh.util.concatenate([trimesh.creation.cylinder(1.2, 4.0, sections=64), nozzle])
    path: Path = tmp_path_factory.mktemp("round") / "stage.stl"
    stage.export(path)
    target = load_target(path)
    scene = Scene.showing(target, Pipeline.model_validate(PIPELINE))
    return target, follow(scene, target)


def test_a_round_target_is_followed_and_called_ambiguous(
    followed: tuple[Target, JudgedRun],
) -> None:
    target, run = followed
    assert target.symmetry_name == "round about z"
    assert run.said.status[-1] == Status.AMBIGUOUS
    assert np.count_nonzero(run.claims) >= 6
    assert np.all(run.is_within(np.radians(0.2), 0.01)[run.claims])


def test_nothing_is_claimed_of_the_turn_about_the_axis(
    followed: tuple[Target, JudgedRun],
) -> None:
    target, run = followed
    assert target.roundness is not None
    (axis,) = target.roundness.axes_model
    trajectory = run.said.trajectory
    assert trajectory.covariance is not None
    P = trajectory.covariance[-1]
    attitude, rate = (trajectory.layout.slice_of(block) for block in (ATTITUDE, RATE))
    about, across = (float(np.sqrt(a @ P[attitude, attitude] @ a)) for a in (axis, np.eye(3)[0]))
    # Facets of 64 sides would tell it to a few tenths of a degree.
    assert about > np.radians(5.0) > 50.0 * across
    error = run.errors[RATE][-1] @ axis
    assert abs(error) < 3.0 * np.sqrt(axis @ P[rate, rate] @ axis)
