"""What a forecast begins from: the end of a result folder, and the accelerations it showed."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.trajectory import Trajectory
from pcnav.evaluation.answer.telling import About, answer_of
from pcnav.evaluation.forecast.accelerations import densities_of_run
from pcnav.evaluation.forecast.start import read_start
from pcnav.evaluation.metrics import run_metrics
from pcnav.runs.run import Run
from tests.made_runs import made_run


def stored(kind: str, folder: Path, eccentricity: float = 0.0) -> Run:
    run, orbit = made_run(kind, 20).stored(folder), KeplerOrbit(1e-3, eccentricity)
    answer = answer_of(run, run_metrics(run), About("made", orbit=orbit, mesh_scale=1.01))
    (folder / "summary.json").write_text(answer.model_dump_json())
    return run


@pytest.mark.parametrize("kind", ["depth", "inertia_bank"])
def test_a_forecast_begins_where_the_run_ended(kind: str, tmp_path: Path) -> None:
    run = stored(kind, tmp_path / "run")
    start, answer, _ = read_start(tmp_path / "run")
    last, covariance = run.trajectory.at(slice(19, 20)), run.trajectory.covariance
    assert (start.time_s, start.mesh_scale, start.torque_free) == (9.5, 1.01, True)
    assert start.mean_motion_rad_s == answer.mean_motion_rad_s == 1e-3
    np.testing.assert_array_equal(start.state.r_hill, last.values["r_hill"][0])
    assert covariance is not None
    has_centre = kind == "depth"
    rows = np.arange(20) if has_centre else np.r_[0:6, 9:20]
    np.testing.assert_array_equal(start.covariance[np.ix_(rows, rows)], covariance[19])
    assert has_centre or not start.covariance[6:9].any()
    assert start.acceleration_psd_m2_s3 == 1e-14


def test_what_cannot_be_forecast_is_said_in_one_line(tmp_path: Path) -> None:
    stored("open3d_icp", tmp_path / "poses")
    with pytest.raises(InputError, match=r"states\.csv: header: expected a run that estimates"):
        read_start(tmp_path / "poses")
    stored("depth", tmp_path / "elliptic", 0.1)
    with pytest.raises(InputError, match="orbit: expected a circular one"):
        read_start(tmp_path / "elliptic")
    stored("depth", tmp_path / "lost")
    path = tmp_path / "lost" / "summary.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), "found": False}))
    with pytest.raises(InputError, match="expected one that found the target"):
        read_start(tmp_path / "lost")
    path.write_text('{"found": 3')
    with pytest.raises(InputError, match=r"summary\.json: file: expected"):
        read_start(tmp_path / "lost")
    path.unlink()
    with pytest.raises(InputError, match="run it again with this version"):
        read_start(tmp_path / "lost")


def carried(accelerate: float, frames: int = 400) -> Run:
    """A run whose states are exact, under white accelerations and as strong angular ones."""
    rng, step = np.random.default_rng(6), 0.5
    time_s = step * np.arange(frames, dtype=np.float64)
    kick = np.sqrt(accelerate * step) * rng.standard_normal((2, frames, 3))
    rates = np.cumsum(kick, axis=1)
    place = np.cumsum(step * (rates[0] - 0.5 * kick[0]), axis=0)
    R = [np.eye(3)]
    for k in range(1, frames):
        R.append(R[-1] @ exp_rotation(step * (rates[1, k] - 0.5 * kick[1, k])))
    constant = {"com_model": np.zeros((frames, 3)), "inertia_ratios": np.ones((frames, 5))}
    values = {
        "r_hill": place,
        "v_hill": rates[0],
        "theta_body": np.array(R),
        "omega_body": rates[1],
        **constant,
    }
    sd = np.zeros((frames, 20))
    motion = Trajectory(time_s, MASS_CENTRE_LAYOUT, values, sd)
    none = np.zeros(frames)
    return Run(
        *("made", None, "depth", None, motion, ("locked",) * frames),
        *(none, none.astype(np.intp), none),
        words={"motion": ("torque_free",) * 10 + ("kinematic",) * (frames - 10)},
    )


def test_accelerations_are_those_that_the_run_showed() -> None:
    translation, rotation = densities_of_run(carried(1e-6), 0.0)
    # The largest of a few spans, each over few independent ones, is rather too large.
    assert 0.7e-6 < translation < 3e-6
    assert 0.7e-6 < rotation < 3e-6
    still = carried(0.0)
    assert densities_of_run(still, 0.0) == (0.0, 0.0)
    # What one estimate's own deviation explains is no acceleration.
    assert still.trajectory.sd is not None
    noisy = replace(still.trajectory, sd=still.trajectory.sd + 1e-3)
    assert densities_of_run(replace(still, trajectory=noisy), 0.0) == (0.0, 0.0)


def test_too_few_frames_show_nothing() -> None:
    run = carried(1e-6, frames=12)
    assert densities_of_run(run, 0.0) == (0.0, 0.0)
