"""Runs of the estimator on the paper's scenario, judged against the truth."""

from dataclasses import dataclass, replace

import numpy as np

from pcnav.batch.monte_carlo import Run
from pcnav.config.principal_axes import FeatureMeasurements, PrincipalAxesTable
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.spatial import exp_rotation, log_rotation
from pcnav.dynamics.principal_inertia import middle_ratio, ratios_from_moments
from pcnav.estimators.features.photogrammetric_frame import photogrammetric_axes
from pcnav.estimators.principal_axes.estimator import PrincipalAxesEstimator
from pcnav.estimators.principal_axes.feature_states import (
    MOTION_SIZE,
    OMEGA,
    R_HILL,
    RATIOS,
    THETA,
    V_HILL,
    PrincipalState,
    propagate_rotation,
)
from pcnav.estimators.principal_axes.principal_frame import principal_axes
from pcnav.simulation.feature_motion import FeatureTruth, relative_orbit
from pcnav.simulation.features import FeatureScenario, draw_points, observe, stereo_rig

from . import paper


@dataclass(frozen=True)
class Case:
    """Settings and scenario of runs."""

    name: str
    table: PrincipalAxesTable
    disturbed: bool
    """Whether the truth is disturbed as the filter supposes; else it moves freely."""
    points: int = 6
    wrong_matches: float = 0.0
    every: int = 10
    """Frames from one that is judged to the next."""


def _with(table: PrincipalAxesTable, **changes: object) -> PrincipalAxesTable:
    return table.model_copy(update=changes)


def cases() -> dict[str, Case]:
    """All, by name."""
    printed, calm = paper.settings(1.0), paper.settings(paper.CALM)
    double = _with(calm, measurements=FeatureMeasurements.PRINTED)
    found = (
        Case("unique axes", printed, disturbed=False, every=2),
        Case("free axes", _with(printed, unique_frame=False), disturbed=False, every=2),
        Case("matched", calm, disturbed=True),
        Case("pixels used twice", double, disturbed=True),
        Case("wrong matches", calm, disturbed=True, points=10, wrong_matches=0.1),
    )
    return {case.name: case for case in found}


@dataclass(frozen=True)
class JudgedRun:
    """Errors of a run at the frames that are judged; nan before the start."""

    case: str
    seed: int
    time_s: FloatArray
    """(n,)"""
    seen: BoolArray
    """(n,) whether the frame shows features."""
    status: tuple[str, ...]
    error: FloatArray
    """(n, 14) truth minus estimate in the unique axes: attitude (rad, body axes), rate, p_x and
    p_z, position, velocity."""
    sd: FloatArray
    """(n, 14) as the filter states them."""
    middle_ratio_error: FloatArray
    """(n,) of p_y."""
    point_error: FloatArray
    """(n, N, 3) of the points in the state; nan for others."""
    point_sd: FloatArray
    """(n, N, 3)"""
    nees: FloatArray
    """(n,) normalised squared error of the whole state."""
    motion_nees: FloatArray
    """(n,) of its first 14 components."""
    size: FloatArray
    """(n,) components of the whole state."""
    rejected_right: int
    """Right observations that the filter turned down."""
    accepted_wrong: int
    """Wrong matches that it used."""
    right: int
    wrong: int

    def block(self, where: slice) -> FloatArray:
        """(n,) norms of the errors of a block."""
        return np.asarray(np.linalg.norm(self.error[:, where], axis=1))


def run_case(run: Run[str]) -> JudgedRun:
    """One run: truth, tracks and noise are the seed's."""
    return judge(cases()[run.case.settings], paper.scenario(), run.seed)


def judge(case: Case, scenario: FeatureScenario, seed: int) -> JudgedRun:
    """Simulate, estimate and compare."""
    features = scenario.features.model_copy(
        update={"count": case.points, "wrong_match_fraction": case.wrong_matches}
    )
    scenario = replace(scenario, features=features)
    on_points, on_motion, on_tracks = np.random.default_rng(seed).spawn(3)
    points = draw_points(features, on_points)
    truth = disturbed_truth(scenario, points, case.table if case.disturbed else None, on_motion)
    tracks = observe(scenario, truth, on_tracks)
    estimator = PrincipalAxesEstimator(tracks.rig, tracks.orbit, case.table, seed)
    record = _Record(case, seed, truth)
    for k, frame in enumerate(tracks.frames):
        estimate = estimator.step(frame)
        if case.wrong_matches:
            wrong = _wrong(scenario, truth, k, frame.R_rig_world, frame.features, frame.pixels)
            record.count(estimate.used, estimate.rejected, wrong, frame.features.tolist())
        if k % case.every == 0 or k == len(tracks.frames) - 1:
            record.add(k, len(frame.features) > 0, str(estimate.status), estimator)
    return record.run()


def disturbed_truth(
    scenario: FeatureScenario,
    points: FloatArray,
    table: PrincipalAxesTable | None,
    rng: np.random.Generator,
) -> FeatureTruth:
    """The true motion under white disturbances as (4) and (21) have them; None for none.

    The torque is the same about all axes, so its angular acceleration is not; the accelerations
    between two frames are drawn as what they add to place and rate.
    """
    times, start = scenario.times_s, scenario.start
    linear = 0.0 if table is None else table.acceleration_psd_m2_s3
    angular = 0.0 if table is None else table.angular_acceleration_psd_rad2_s3
    orbit = relative_orbit(scenario.orbit_model, scenario.orbit, start, times, linear, rng)
    moments = np.diag(scenario.inertia)
    scale = np.sqrt(angular) * moments[0] / moments
    R, omega = start.R_world_body, start.omega_body
    attitudes, rates = [R], [omega]
    for step in np.diff(times).tolist():
        done = propagate_rotation(omega, ratios_from_moments(moments), step)
        first, second = rng.standard_normal((2, 3)) * scale
        change = np.sqrt(step) * first
        kick = 0.5 * step * change + np.sqrt(step**3 / 12.0) * second
        R, omega = R @ done.turn @ exp_rotation(kick), done.omega_body + change
        attitudes.append(R)
        rates.append(omega)
    return FeatureTruth(
        times_s=times,
        r_hill=orbit[:, :3],
        v_hill=orbit[:, 3:],
        R_world_body=np.stack(attitudes),
        omega_body=np.stack(rates),
        inertia=scenario.inertia,
        points=points,
    )


def true_state(
    truth: FeatureTruth, k: int, features: tuple[int, ...], triple: tuple[int, int, int]
) -> PrincipalState:
    """The truth at a frame in its unique principal axes (17), signed by the same three points."""
    R_body_g = photogrammetric_axes(truth.points[list(triple)])
    moments, axes = principal_axes(R_body_g.T @ truth.inertia @ R_body_g)
    S = R_body_g @ axes
    return PrincipalState(
        R_world_body=truth.R_world_body[k] @ S,
        omega_body=S.T @ truth.omega_body[k],
        ratios=ratios_from_moments(moments),
        r_hill=truth.r_hill[k],
        v_hill=truth.v_hill[k],
        points=truth.points[list(features)] @ S,
    )


def _wrong(
    scenario: FeatureScenario,
    truth: FeatureTruth,
    k: int,
    R_rig_world: FloatArray,
    features: IntArray,
    pixels: FloatArray,
) -> set[int]:
    """Features of a frame whose pixels are not their own."""
    rig = stereo_rig(scenario.stereo)
    R_hill_world = scenario.orbit.R_hill_world(float(truth.times_s[k]))
    p_world = R_hill_world.T @ truth.r_hill[k] + truth.points[features] @ truth.R_world_body[k].T
    off = np.abs(rig.project(p_world @ R_rig_world.T) - pixels).max(axis=1)
    return set(features[off > 6.0 * rig.pixel_sigma_px].tolist())


class _Record:
    """Collects a run."""

    def __init__(self, case: Case, seed: int, truth: FeatureTruth) -> None:
        self._case, self._seed, self._truth = case, seed, truth
        self._rows: list[dict[str, object]] = []
        self._counts = np.zeros(4, dtype=int)

    def count(
        self,
        used: tuple[int, ...],
        rejected: tuple[int, ...],
        wrong: set[int],
        seen: list[int],
    ) -> None:
        """Take note of matches; nothing is used before the start."""
        if used or rejected:
            self._counts += [
                len([f for f in rejected if f not in wrong]),
                len([f for f in used if f in wrong]),
                len([f for f in seen if f not in wrong]),
                len(wrong),
            ]

    def add(self, k: int, seen: bool, status: str, estimator: PrincipalAxesEstimator) -> None:
        """Compare the estimate of a frame."""
        count = len(self._truth.points)
        row: dict[str, object] = {
            "time_s": self._truth.times_s[k],
            "seen": seen,
            "status": status,
            "error": np.full(MOTION_SIZE, np.nan),
            "sd": np.full(MOTION_SIZE, np.nan),
            "middle": np.nan,
            "point_error": np.full((count, 3), np.nan),
            "point_sd": np.full((count, 3), np.nan),
            "nees": np.nan,
            "motion_nees": np.nan,
            "size": np.nan,
        }
        state, P, triple = estimator.state, estimator.covariance, estimator.triple
        if state is not None and P is not None and triple is not None:
            row |= self._compared(k, state, P, estimator.features, triple)
        self._rows.append(row)

    def _compared(
        self,
        k: int,
        state: PrincipalState,
        P: FloatArray,
        features: tuple[int, ...],
        triple: tuple[int, int, int],
    ) -> dict[str, object]:
        true = true_state(self._truth, k, features, triple)
        plain = state.additive()
        sd = np.sqrt(np.diag(plain @ P @ plain.T))
        points = np.full((len(self._truth.points), 3), np.nan)
        point_sd = points.copy()
        points[list(features)] = true.points - state.points
        point_sd[list(features)] = sd[MOTION_SIZE:].reshape(-1, 3)
        local = state.local(true)
        motion = local[:MOTION_SIZE]
        motion_P = P[:MOTION_SIZE, :MOTION_SIZE]
        return {
            "error": np.concatenate(
                [
                    log_rotation(state.R_world_body.T @ true.R_world_body),
                    true.omega_body - state.omega_body,
                    true.ratios - state.ratios,
                    true.r_hill - state.r_hill,
                    true.v_hill - state.v_hill,
                ]
            ),
            "sd": sd[:MOTION_SIZE],
            "middle": middle_ratio(true.ratios) - middle_ratio(state.ratios),
            "point_error": points,
            "point_sd": point_sd,
            "nees": float(local @ np.linalg.solve(P, local)),
            "motion_nees": float(motion @ np.linalg.solve(motion_P, motion)),
            "size": float(len(local)),
        }

    def run(self) -> JudgedRun:
        """What was collected."""

        def stacked(key: str) -> FloatArray:
            return np.array([row[key] for row in self._rows], dtype=np.float64)

        rejected_right, accepted_wrong, right, wrong = self._counts.tolist()
        return JudgedRun(
            case=self._case.name,
            seed=self._seed,
            time_s=stacked("time_s"),
            seen=np.array([row["seen"] for row in self._rows], dtype=np.bool_),
            status=tuple(str(row["status"]) for row in self._rows),
            error=stacked("error"),
            sd=stacked("sd"),
            middle_ratio_error=stacked("middle"),
            point_error=stacked("point_error"),
            point_sd=stacked("point_sd"),
            nees=stacked("nees"),
            motion_nees=stacked("motion_nees"),
            size=stacked("size"),
            rejected_right=rejected_right,
            accepted_wrong=accepted_wrong,
            right=right,
            wrong=wrong,
        )


BLOCKS = {
    "attitude, deg": (THETA, float(np.rad2deg(1.0))),
    "rate, deg/s": (OMEGA, float(np.rad2deg(1.0))),
    "inertia ratios p_x, p_z": (RATIOS, 1.0),
    "position, m": (R_HILL, 1.0),
    "velocity, m/s": (V_HILL, 1.0),
}
"""Blocks of the state by the name and unit of tables, with the factor from SI."""
