"""A recording run from end to end, with an estimator of the test's own and with those shipped."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

import pcnav.pipeline
from pcnav.cli import main
from pcnav.config.pipeline_file import EstimatorKind, EstimatorTable, Pipeline, read_pipeline
from pcnav.config.scenario import BodyTable, OrbitTable, ScenarioTable
from pcnav.config.sensors import FeaturesTable
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, rotation_from_xyzw
from pcnav.dynamics.blocks import ATTITUDE, POSITION, RATE, VELOCITY
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.rigid_body import inertia_from_ratios, ratios_from_inertia
from pcnav.estimators.features.answer import Motion, Used, stereo_estimate, stereo_output
from pcnav.estimators.interface import Estimator, Given
from pcnav.estimators.registry import ESTIMATORS
from pcnav.evaluation.errors import principal_rotation
from pcnav.files.csv_table import read_csv
from pcnav.pipeline import run
from pcnav.recordings.stereo_tracks import read_stereo_tracks, read_truth_features
from pcnav.recordings.tracks import TrackFrame
from pcnav.recordings.truth import read_truth
from pcnav.runs.estimate import Estimate, FeaturePoint
from pcnav.simulation.simulate import simulate

SIGMA = 0.01
ACQUIRING = 3
ERROR_SIZE = 17
RATIOS = (0.7, 0.5, 0.05, -0.02, 0.03)


def pipeline(kind: EstimatorKind = EstimatorKind.INERTIA_BANK, frames: int = 60) -> Pipeline:
    return Pipeline(
        seed=7,
        scenario=ScenarioTable(frames=frames, frame_rate_hz=2.0),
        orbit=OrbitTable(mean_motion_rad_s=0.001, r_hill_m=(15.0, 1.0, -2.0)),
        body=BodyTable(omega_body_deg_s=(5.0, 4.0, 6.0), inertia_ratios=RATIOS),
        estimator=EstimatorTable(kind=kind),
        features=FeaturesTable(count=5, blackouts_s=((10.0, 15.0),)),
    )


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


def put(monkeypatch: pytest.MonkeyPatch, kind: str, make: Callable[[Given], Estimator]) -> None:
    """Put an estimator in place of one of the registry."""
    monkeypatch.setitem(ESTIMATORS, kind, replace(ESTIMATORS[kind], make=make))


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    simulate(pipeline()).write(tmp_path / "tracks")
    return tmp_path / "tracks"


@pytest.fixture
def with_oracle(recording: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[np.ndarray], None]:
    """Puts the oracle in place of both estimators, seeing axes turned by the rotation given."""

    def put_oracle(R_body_own: np.ndarray) -> None:
        def oracle(given: Given) -> Estimator:
            assert given.pipeline.sequence == str(recording.resolve())
            return Oracle(recording, R_body_own)

        for kind in (EstimatorKind.PRINCIPAL_AXES, EstimatorKind.INERTIA_BANK):
            put(monkeypatch, kind, oracle)

    return put_oracle


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leaves the report empty: its figures take longer than all the rest."""

    def write(path: Path, _: object) -> None:
        path.write_text("", encoding="utf-8")

    monkeypatch.setattr(pcnav.pipeline, "write_report", write)


def command(monkeypatch: pytest.MonkeyPatch, *words: object) -> int:
    monkeypatch.setattr("sys.argv", ["pcnav", *map(str, words)])
    with pytest.raises(SystemExit) as caught:
        main()
    return int(caught.value.code or 0)


def test_a_run_writes_all_of_its_folder(
    recording: Path, tmp_path: Path, with_oracle: Callable[[np.ndarray], None]
) -> None:
    with_oracle(np.eye(3))
    told: list[tuple[int, int]] = []
    out = tmp_path / "deep" / "run"
    summary = run(
        recording, out, pipeline(), on_estimate=lambda _, done, total: told.append((done, total))
    )
    assert told == [(k, 60) for k in range(1, 61)]
    names = ["covariances.npz", "features.csv", "metrics.json", "pipeline.toml"]
    more = ["points.csv", "poses.tum", "report.html", "states.csv"]
    assert sorted(p.name for p in out.iterdir()) == [*names, *more]
    assert [p.name for p in out.parent.iterdir()] == ["run"]
    assert summary.report == out / "report.html"
    assert summary.metrics.frames_compared == 57
    page = summary.report.read_text(encoding="utf-8")
    for word in ("inertia_bank", "p_x", "Error of the points", "coasting", "hypotheses"):
        assert word in page, word


@pytest.mark.usefixtures("undrawn")
def test_tables_hold_what_was_estimated(
    recording: Path, tmp_path: Path, with_oracle: Callable[[np.ndarray], None]
) -> None:
    with_oracle(np.eye(3))
    run(recording, tmp_path / "run", pipeline())
    names = ("time_s", "r_x_m", "i_yy", "sd_theta_x_rad", "sd_i_yz", "nis", "p_x", "weight_0")
    counts = ("nis_dof", "n_features", "n_used", "n_rejected")
    columns = (*names, *counts, *("q_x", "q_y", "q_z", "q_w"))
    table = read_csv(tmp_path / "run" / "states.csv", (*columns, "status"), ("status",))
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
        tmp_path / "run" / "features.csv",
        ("feature", "x_m", "sd_z_m", "frames_seen", "frames_rejected"),
    )
    points = read_truth_features(recording)
    assert points is not None
    x = features.numbers(("x_m",))[:, 0]
    np.testing.assert_allclose(x[:4], [points[i][0] + 0.003 for i in range(4)], rtol=1e-12)
    assert np.isnan(x[4])
    np.testing.assert_array_equal(features.counts("frames_seen"), seen.sum() // 5)
    np.testing.assert_array_equal(features.counts("frames_rejected"), [0, 0, 47, 0, 0])
    stored = np.load(tmp_path / "run" / "covariances.npz")
    assert stored["P"].shape == (57, 17, 17)
    np.testing.assert_array_equal(stored["time_s"], values[3:, 0])


@pytest.mark.usefixtures("undrawn")
def test_poses_are_those_of_the_body_in_the_rig(
    recording: Path, tmp_path: Path, with_oracle: Callable[[np.ndarray], None]
) -> None:
    with_oracle(np.eye(3))
    run(recording, tmp_path / "run", pipeline())
    poses = np.loadtxt(tmp_path / "run" / "poses.tum")
    tracks, points = read_stereo_tracks(recording), read_truth_features(recording)
    assert points is not None
    frames = {frame.time_s: frame for frame in tracks.frames}
    assert len(poses) == 57
    for pose in poses[::7]:
        frame = frames[pose[0]]
        R_rig_body = rotation_from_xyzw(pose[4:])
        for i, pixels in zip(frame.features.tolist(), frame.pixels, strict=True):
            predicted = tracks.rig.project(R_rig_body @ points[i] + pose[1:4])
            # The oracle errs by 0.01 m and rad, which a lever of 2.6 m turns into few pixels.
            np.testing.assert_allclose(predicted, pixels, atol=15.0)


@pytest.mark.usefixtures("undrawn")
def test_metrics_and_consistency_are_those_of_the_oracle(
    recording: Path, tmp_path: Path, with_oracle: Callable[[np.ndarray], None]
) -> None:
    with_oracle(np.eye(3))
    run(recording, tmp_path / "run", pipeline())
    metrics = json.loads((tmp_path / "run" / "metrics.json").read_text(encoding="utf-8"))
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
@pytest.mark.usefixtures("undrawn")
def test_truth_is_told_in_the_nearest_principal_axes(
    recording: Path,
    tmp_path: Path,
    with_oracle: Callable[[np.ndarray], None],
    signs: tuple[int, int],
) -> None:
    axes = principal_rotation(inertia_from_ratios(np.array(RATIOS)))
    with_oracle(axes * np.array([*signs, signs[0] * signs[1]]))
    summary = run(
        recording, tmp_path / "run", pipeline(EstimatorKind.PRINCIPAL_AXES), overwrite=True
    )
    whole = {q.key: q.whole.rms for q in summary.metrics.quantities}
    assert whole["attitude"] == pytest.approx(np.rad2deg(SIGMA * 3**0.5), rel=0.2)
    assert whole["omega_body"] == pytest.approx(np.rad2deg(SIGMA * 3**0.5), rel=0.2)
    assert whole["inertia_ratios"] == pytest.approx(SIGMA * 2**0.5, rel=0.25)
    assert whole["features"] == pytest.approx(0.005, rel=1e-9)


@pytest.mark.usefixtures("undrawn")
def test_axes_in_another_order_are_an_error(
    recording: Path, tmp_path: Path, with_oracle: Callable[[np.ndarray], None]
) -> None:
    axes = principal_rotation(inertia_from_ratios(np.array(RATIOS)))
    with_oracle(axes[:, [1, 2, 0]])
    summary = run(recording, tmp_path / "run", pipeline(EstimatorKind.PRINCIPAL_AXES))
    whole = {q.key: q.whole.rms for q in summary.metrics.quantities}
    assert whole["attitude"] > 30.0
    assert whole["features"] > 0.3


def test_principal_rotation_diagonalises_with_falling_moments() -> None:
    inertia = inertia_from_ratios(np.array(RATIOS))
    R = principal_rotation(inertia)
    moments = R.T @ inertia @ R
    np.testing.assert_allclose(moments, np.diag(np.diag(moments)), atol=1e-14)
    assert (np.diff(np.diag(moments)) < 0.0).all()
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0)


def test_a_recording_without_truth_gets_no_metrics(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bare = tmp_path / "bare"
    bare.mkdir()
    for name in ("tracks.csv", "rig.toml", "camera_attitude.csv"):
        (bare / name).write_bytes((recording / name).read_bytes())
    put(monkeypatch, EstimatorKind.INERTIA_BANK, lambda _: Oracle(recording, np.eye(3)))
    run(bare, tmp_path / "run", pipeline())
    assert not (tmp_path / "run" / "metrics.json").exists()
    assert "Against the truth" not in (tmp_path / "run" / "report.html").read_text()


class Silent(Estimator):
    """Never gets to an estimate."""

    output = stereo_output(())

    def step(self, frame: TrackFrame, /) -> Estimate:
        return Estimate(frame.time_s, "acquiring")


class Failing(Estimator):
    """Refuses the third frame."""

    output = stereo_output(())

    def step(self, frame: TrackFrame, /) -> Estimate:
        if frame.time_s >= 1.0:
            raise InputError("tracks.csv", "feature", "expected what cannot be had")
        return Estimate(frame.time_s, "acquiring")


def test_a_run_without_an_estimate_says_so(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(monkeypatch, EstimatorKind.INERTIA_BANK, lambda _: Silent())
    summary = run(recording, tmp_path / "run", pipeline())
    assert summary.metrics.frames_with_estimate == 0
    assert (tmp_path / "run" / "poses.tum").read_text() == ""
    assert "none" in (tmp_path / "run" / "report.html").read_text()


def test_a_run_that_fails_leaves_nothing(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(monkeypatch, EstimatorKind.INERTIA_BANK, lambda _: Failing())
    with pytest.raises(InputError, match="cannot be had"):
        run(recording, tmp_path / "deep" / "run", pipeline())
    assert [path.name for path in tmp_path.iterdir()] == ["tracks"]


def test_a_result_does_not_replace_its_recording(recording: Path) -> None:
    for out in (recording, recording.parent):
        with pytest.raises(InputError, match="does not hold"):
            run(recording, out, pipeline(), overwrite=True)
    assert (recording / "tracks.csv").is_file()


def test_simulated_tracks_repeat_and_carry_the_orbit(tmp_path: Path, recording: Path) -> None:
    simulate(pipeline()).write(tmp_path / "again")
    names = ("tracks.csv", "truth.csv", "truth_features.csv", "camera_attitude.csv", "rig.toml")
    for name in names:
        assert (tmp_path / "again" / name).read_bytes() == (recording / name).read_bytes()
    assert read_stereo_tracks(recording).orbit == KeplerOrbit(0.001)


def test_shipped_scenarios_are_those_of_the_papers(repository: Path) -> None:
    hu = read_pipeline(repository / "pipelines" / "hu2024.toml")
    assert hu.estimator.kind is EstimatorKind.PRINCIPAL_AXES
    assert hu.scenario.frames / hu.scenario.frame_rate_hz == 200.0
    np.testing.assert_allclose(np.deg2rad(hu.body.omega_body_deg_s), 0.1)
    np.testing.assert_allclose(np.array([8, 5, 4])[1:] / 8, hu.body.inertia_ratios[:2])
    segal = read_pipeline(repository / "pipelines" / "segal2011.toml")
    assert segal.estimator.kind is EstimatorKind.INERTIA_BANK
    orbit = KeplerOrbit(
        segal.orbit.mean_motion_rad_s,
        segal.orbit.eccentricity,
        np.deg2rad(segal.orbit.true_anomaly_deg),
    )
    assert np.rad2deg(orbit.at(0.0).rate_rad_s) == pytest.approx(0.0656, abs=1e-6)
    # Seen in the paper's axes (radially out, along-track, normal), ours are y, -z, -x.
    R_ours_paper = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
    np.testing.assert_allclose(segal.orbit.r_hill_m, R_ours_paper @ [10.0, 100.0, 10.0])
    np.testing.assert_allclose(segal.orbit.v_hill_m_s, R_ours_paper @ [0.01, -0.0225, -0.01])
    attitude = exp_rotation(np.deg2rad(np.array(segal.body.attitude_rotvec_deg)))
    np.testing.assert_allclose(attitude, R_ours_paper, atol=1e-12)
    started = rotation_from_xyzw(np.array(segal.inertia_bank.attitude_xyzw))
    np.testing.assert_allclose(started, R_ours_paper, atol=1e-12)
    printed = np.array([[96.0, 43.0, 20.0], [43.0, 104.0, 10.0], [20.0, 10.0, 133.0]])
    np.testing.assert_allclose(segal.body.inertia_ratios, ratios_from_inertia(printed))


SHORT = """
seed = 3
[scenario]
frames = {frames}
frame_rate_hz = 5.0
[orbit]
mean_motion_rad_s = 0.001
r_hill_m = [12.0, 0.0, 1.0]
[body]
omega_body_deg_s = [5.0, 4.0, 6.0]
inertia_ratios = [0.7, 0.5, 0.0, 0.0, 0.0]
[estimator]
kind = "{kind}"
[stereo]
pixel_sigma_px = 0.02
"""


@pytest.mark.parametrize(("kind", "frames"), [("inertia_bank", 30), ("principal_axes", 60)])
def test_the_command_line_simulates_and_runs_tracks(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    kind: str,
    frames: int,
) -> None:
    file = tmp_path / "my.toml"
    file.write_text(SHORT.format(kind=kind, frames=frames), encoding="utf-8")
    recording, out, other = (tmp_path / name for name in ("tracks", "run", "other"))
    drawn = kind == "principal_axes"
    if not drawn:
        monkeypatch.setattr(pcnav.pipeline, "write_report", lambda *_: None)
    assert command(monkeypatch, "simulate", file, "-o", recording) == 0
    assert f"{frames} frames, 0 of them empty" in capsys.readouterr().out
    assert command(monkeypatch, "run", recording, "--pipeline", file, "-o", out) == 0
    assert "report: " in capsys.readouterr().out
    assert not drawn or "States over time" in (out / "report.html").read_text(encoding="utf-8")
    monkeypatch.setattr(pcnav.pipeline, "write_report", lambda *_: None)
    summary = run(recording / "tracks.csv", other, read_pipeline(out / "pipeline.toml"))
    assert summary.metrics.frames == frames
    assert (other / "states.csv").read_bytes() == (out / "states.csv").read_bytes()


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
        (("run", "tracks", "--pipeline", "segal2011", "-o", "tracks"), "does not hold"),
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
