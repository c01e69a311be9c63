"""What a forecast begins from: the end of a result folder, and the accelerations it showed."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT, POSITION
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.trajectory import Trajectory
from pcnav.evaluation.answer.telling import About, answer_of
from pcnav.evaluation.forecast.accelerations import Accelerations, accelerations_of_run
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
    assert start.accelerations.density[0].tolist() == [1e-14, 1e-16]


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
    exact = np.zeros((frames, 20, 20))
    motion = Trajectory(time_s, MASS_CENTRE_LAYOUT, values, covariance=exact)
    none = np.zeros(frames)
    return Run(
        *("made", None, "depth", None, motion, ("locked",) * frames),
        *(none, none.astype(np.intp), none),
        words={"motion": ("torque_free",) * 10 + ("kinematic",) * (frames - 10)},
    )


def test_accelerations_are_those_that_the_run_showed() -> None:
    found = accelerations_of_run(carried(1e-6), 0.0)
    # Those over few frames rest on many numbers, those over many on few.
    few, many = found.degrees > 100.0, found.degrees < 20.0
    np.testing.assert_allclose(found.density[few], 1e-6, rtol=0.4)
    assert few.sum() > 2 and many.any()
    assert ((found.density[many] > 1e-7) & (found.density[many] < 1e-5)).all()
    still = carried(0.0)
    assert not accelerations_of_run(still, 0.0).density.any()
    # What the estimates' own deviations explain is no acceleration.
    noisy = replace(still.trajectory, covariance=1e-6 * np.tile(np.eye(20), (len(still), 1, 1)))
    shaken = noisy[POSITION] + 1e-3 * np.random.default_rng(7).standard_normal((len(still), 3))
    values = {**noisy.values, POSITION.name: shaken}
    sure = replace(noisy, values=values, covariance=still.trajectory.covariance)
    without, taken_off = (
        accelerations_of_run(replace(still, trajectory=each), 0.0).density[0, 0]
        for each in (sure, replace(noisy, values=values))
    )
    assert taken_off < 0.1 * without


def test_a_density_is_drawn_as_it_is_known() -> None:
    rng = np.random.default_rng(8)
    spans, density = np.array([1.0, 2.0, 4.0]), np.array([[1.0, 8.0], [2.0, 8.0], [4.0, 8.0]])
    known = Accelerations(spans, density, np.full(3, np.inf))
    for ahead, translation in ((0.5, 1.0), (2.0, 2.0), (4.0, 4.0), (16.0, 16.0)):
        np.testing.assert_allclose(known.drawn(ahead, 2, rng), [[translation, 8.0]] * 2)
    measured = Accelerations(spans, density, np.array([500.0, 50.0, 9.0]))
    drawn = measured.drawn(16.0, 20000, rng)[:, 1]
    # What nine numbers of variance 8 leave possible, by inverting their chi-square distribution.
    bounds = 72.0 / np.asarray(chi2.ppf([0.95, 0.05], 9))
    assert np.mean((drawn > bounds[0]) & (drawn < bounds[1])) == pytest.approx(0.9, abs=0.01)


def test_too_few_frames_show_nothing() -> None:
    assert not accelerations_of_run(carried(1e-6, frames=13), 0.0).density.any()
