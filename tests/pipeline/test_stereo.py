"""Runs on stereo tracks, with an estimator of the test's own that knows the truth."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from pcnav.config.pipeline_file import EstimatorKind
from pcnav.core.spatial import exp_rotation, rotation_from_xyzw
from pcnav.dynamics.blocks import ATTITUDE, POSITION, RATE, VELOCITY
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.rigid_body import inertia_from_ratios, ratios_from_inertia
from pcnav.estimators.features.answer import Motion, Used, stereo_estimate, stereo_output
from pcnav.estimators.interface import Estimator
from pcnav.evaluation.errors import principal_rotation
from pcnav.files.csv_table import read_csv
from pcnav.navigation import RunSummary
from pcnav.pipeline import run
from pcnav.recordings.stereo_tracks import read_stereo_tracks, read_truth_features
from pcnav.recordings.tracks import TrackFrame
from pcnav.recordings.truth import read_truth
from pcnav.runs.estimate import Estimate, FeaturePoint
from pcnav.runs.provenance import library_versions, pipeline_toml
from pcnav.simulation.simulate import simulate
from tests.pipeline.made import RATIOS, Made, command, put, stereo

SIGMA = 0.01
ACQUIRING = 3
ERROR_SIZE = 17


class Oracle(Estimator):
    """Tells the truth of a recording with errors of known covariance, in axes of its own."""

    output = stereo_output(("p_x", "weight_0"))

    def __init__(self, folder: Path, R_body_own: np.ndarray) -> None:
        self._truth = read_truth(folder)
        self._points = read_truth_features(folder)
        self._R = R_body_own
        self._rng = np.random.default_rng(3)
        self._frame = -1

    def step(self, frame: TrackFrame, /) -> Estimate:
        self._frame += 1
        k, truth, R, orbit = self._frame, self._truth, self._R, KeplerOrbit(0.001)
        if k < ACQUIRING:
            return stereo_estimate(frame, orbit, "acquiring")
        assert truth is not None and self._points is not None
        error = SIGMA * self._rng.standard_normal(ERROR_SIZE)
        covariance = SIGMA**2 * np.eye(ERROR_SIZE)
        error[14:] = 0.0
        covariance[14:] = 0.0
        inertia = R.T @ inertia_from_ratios(np.array(RATIOS)) @ R
        motion = Motion(
            r_hill=truth[POSITION][k] - error[:3],
            v_hill=truth[VELOCITY][k] - error[3:6],
            R_world_body=truth[ATTITUDE][k] @ R @ exp_rotation(-error[6:9]),
            omega_body=R.T @ truth[RATE][k] - error[9:12],
            inertia_ratios=ratios_from_inertia(inertia) - error[12:],
            covariance=covariance,
            points={
                i: FeaturePoint(R.T @ p + [0.003, 0.0, 0.004], 1e-4 * np.eye(3))
                for i, p in self._points.items()
                if i != 4
            },
        )
        used = tuple(i for i in frame.features.tolist() if i != 2)
        rejected = (2,) if 2 in frame.features else ()
        notes = {"p_x": 0.5} if k % 2 else {"weight_0": 1.0, "p_x": 0.25}
        nis = float(self._rng.chisquare(16)) if used else float("nan")
        status = "locked" if used else "coasting"
        use = Used(used, rejected, nis, 4 * len(used))
        return stereo_estimate(frame, orbit, status, motion, use, notes)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("stereo") / "tracks"
    simulate(stereo()).write(folder)
    return folder


@pytest.fixture(scope="module")
def made(made_of: Callable[[str], Made]) -> Made:
    return made_of("inertia_bank")


@pytest.fixture
def in_axes(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, undrawn: None
) -> Callable[..., RunSummary]:
    """Runs the oracle in axes turned by a rotation, in place of an estimator."""

    def run_in_axes(
        R_body_own: np.ndarray, kind: EstimatorKind = EstimatorKind.INERTIA_BANK
    ) -> RunSummary:
        put(monkeypatch, kind, lambda _: Oracle(recording, R_body_own))
        return run(recording, tmp_path / "run", stereo(kind))

    return run_in_axes


def test_tables_hold_what_was_estimated(
    recording: Path, in_axes: Callable[..., RunSummary]
) -> None:
    folder = in_axes(np.eye(3)).folder
    names = ("time_s", "r_x_m", "i_yy", "sd_theta_x_rad", "sd_i_yz", "nis", "p_x", "weight_0")
    counts = ("nis_dof", "n_features", "n_used", "n_rejected")
    columns = (*names, *counts, *("q_x", "q_y", "q_z", "q_w"))
    table = read_csv(folder / "states.csv", (*columns, "status"), ("status",))
    assert table.words("status")[:4] == ("acquiring",) * 3 + ("locked",)
    values = table.numbers(names)
    assert np.isnan(values[:3, 1:]).all()
    np.testing.assert_array_equal(values[3:, 3], SIGMA)
    np.testing.assert_array_equal(values[3:, 4], 0.0)
    np.testing.assert_array_equal(values[3:6, 6], [0.5, 0.25, 0.5])
    np.testing.assert_array_equal(np.isnan(values[3:6, 7]), [True, False, True])
    dark = (values[:, 0] >= 10.0) & (values[:, 0] < 15.0)
    np.testing.assert_array_equal(np.isnan(values[3:, 5]), dark[3:])
    seen = np.where(dark, 0, 5)
    np.testing.assert_array_equal(table.counts("n_features"), seen)
    np.testing.assert_array_equal(table.counts("n_used")[3:], np.where(dark, 0, 4)[3:])
    np.testing.assert_array_equal(table.counts("n_rejected")[3:], np.where(dark, 0, 1)[3:])
    features = read_csv(
        folder / "features.csv",
        ("feature", "x_m", "sd_z_m", "frames_seen", "frames_rejected"),
    )
    points = read_truth_features(recording)
    assert points is not None
    x = features.numbers(("x_m",))[:, 0]
    np.testing.assert_allclose(x[:4], [points[i][0] + 0.003 for i in range(4)], rtol=1e-12)
    assert np.isnan(x[4])
    np.testing.assert_array_equal(features.counts("frames_seen"), seen.sum() // 5)
    np.testing.assert_array_equal(features.counts("frames_rejected"), [0, 0, 47, 0, 0])
    stored = np.load(folder / "covariances.npz")
    assert stored["P"].shape == (57, 17, 17)
    np.testing.assert_array_equal(stored["time_s"], values[3:, 0])


def test_poses_are_those_of_the_body_in_the_rig(
    recording: Path, in_axes: Callable[..., RunSummary]
) -> None:
    folder = in_axes(np.eye(3)).folder
    poses = np.loadtxt(folder / "poses.tum")
    tracks, points = read_stereo_tracks(recording), read_truth_features(recording)
    assert points is not None
    frames = {frame.time_s: frame for frame in tracks.frames}
    assert len(poses) == 57 and tracks.orbit == KeplerOrbit(0.001)
    for pose in poses[::7]:
        frame = frames[pose[0]]
        R_rig_body = rotation_from_xyzw(pose[4:])
        for i, pixels in zip(frame.features.tolist(), frame.pixels, strict=True):
            predicted = tracks.rig.project(R_rig_body @ points[i] + pose[1:4])
            # The oracle errs by 0.01 m and rad, which a lever of 2.6 m turns into few pixels.
            np.testing.assert_allclose(predicted, pixels, atol=15.0)


def test_metrics_and_consistency_are_those_of_the_oracle(
    recording: Path, in_axes: Callable[..., RunSummary]
) -> None:
    folder = in_axes(np.eye(3)).folder
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    errors = metrics["errors"]
    assert errors["r_hill_m"]["whole"]["rms"] == pytest.approx(SIGMA * 3**0.5, rel=0.2)
    assert errors["attitude_deg"]["whole"]["rms"] == pytest.approx(
        np.rad2deg(SIGMA * 3**0.5), rel=0.2
    )
    assert errors["omega_body_deg_s"]["whole"]["rms"] == pytest.approx(
        np.rad2deg(SIGMA * 3**0.5), rel=0.2
    )
    assert errors["inertia_ratios"]["whole"]["rms"] == pytest.approx(SIGMA * 2**0.5, rel=0.25)
    assert errors["features_m"]["whole"]["rms"] == pytest.approx(0.005, rel=1e-9)
    nees = metrics["nees"]
    # Twelve states of motion and the two free ratios; those held fixed do not count.
    assert nees["all"]["degrees_of_freedom"] == 57 * 14
    assert nees["inertia_ratios"]["degrees_of_freedom"] == 57 * 2
    # The errors of this oracle are independent from frame to frame; the bounds allow for more.
    assert nees["all"]["mean_per_degree_of_freedom"] == pytest.approx(1.0, abs=0.12)
    assert nees["all"]["bounds_95_of_mean"] == pytest.approx(chi2.ppf([0.025, 0.975], 14) / 14)
    assert metrics["nis"]["mean_per_degree_of_freedom"] == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("signs", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
def test_truth_is_brought_into_the_nearest_principal_axes(
    in_axes: Callable[..., RunSummary], signs: tuple[int, int]
) -> None:
    axes = principal_rotation(inertia_from_ratios(np.array(RATIOS)))
    turned = axes * np.array([*signs, signs[0] * signs[1]])
    summary = in_axes(turned, EstimatorKind.PRINCIPAL_AXES)
    whole = {q.key: q.whole.rms for q in summary.metrics.quantities}
    assert whole["attitude"] == pytest.approx(np.rad2deg(SIGMA * 3**0.5), rel=0.2)
    assert whole["omega_body"] == pytest.approx(np.rad2deg(SIGMA * 3**0.5), rel=0.2)
    assert whole["inertia_ratios"] == pytest.approx(SIGMA * 2**0.5, rel=0.25)
    assert whole["features"] == pytest.approx(0.005, rel=1e-9)


def test_axes_in_another_order_are_an_error(in_axes: Callable[..., RunSummary]) -> None:
    axes = principal_rotation(inertia_from_ratios(np.array(RATIOS)))
    summary = in_axes(axes[:, [1, 2, 0]], EstimatorKind.PRINCIPAL_AXES)
    whole = {q.key: q.whole.rms for q in summary.metrics.quantities}
    assert whole["attitude"] > 30.0
    assert whole["features"] > 0.3


class Silent(Estimator):
    """Never gets to an estimate."""

    output = stereo_output(())

    def step(self, frame: TrackFrame, /) -> Estimate:
        return Estimate(frame.time_s, "acquiring")


def test_a_run_without_an_estimate_says_so(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(monkeypatch, EstimatorKind.INERTIA_BANK, lambda _: Silent())
    summary = run(recording, tmp_path / "run", stereo())
    assert summary.metrics.frames_with_estimate == 0
    assert (summary.folder / "poses.tum").read_text() == ""
    assert "none" in summary.report.read_text()


@pytest.mark.usefixtures("undrawn")
def test_the_command_line_simulates_and_runs_tracks(
    made: Made,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """A recording may be given by its table, too."""
    file, tracks, out = (tmp_path / name for name in ("my.toml", "tracks", "run"))
    file.write_text(pipeline_toml(made.simulated, library_versions()))
    assert command(monkeypatch, "simulate", file, "-o", tracks) == 0
    assert "30 frames, 0 of them empty" in capsys.readouterr().out
    assert command(monkeypatch, "run", tracks / "tracks.csv", "--pipeline", file, "-o", out) == 0
    assert "report: " in capsys.readouterr().out
    assert (out / "states.csv").read_bytes() == (made.result / "states.csv").read_bytes()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("run", "tracks", "-o", "q"), "tracks: --pipeline: expected one with an estimator"),
        (("run", "tracks", "--pipeline", "demo", "-o", "q"), "estimator.kind: expected"),
        (
            ("run", "tracks", "--pipeline", "segal2011", "--target", "boxsat", "-o", "q"),
            "--target: expected none",
        ),
        (("run", "absent", "--pipeline", "segal2011", "-o", "q"), "expected a folder with tracks"),
        (
            ("run", "tracks", "--pipeline", "segal2011", "-o", "tracks", "--overwrite"),
            "does not hold",
        ),
        (("simulate", "hu2024", "-o", "tracks"), "expected an empty or new folder"),
    ],
)
def test_what_does_not_fit_is_one_line(
    recording: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: tuple[str, ...],
    message: str,
) -> None:
    monkeypatch.chdir(recording.parent)
    assert command(monkeypatch, *words) == 2
    captured = capsys.readouterr().err
    assert message in captured
    assert captured.count("\n") == 1
    assert not Path("q").exists()
