"""Runs of the estimator on the paper's scenario, judged against the truth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from pcnav.batch.monte_carlo import Case, Run
from pcnav.config.principal_axes import FeatureMeasurements, PrincipalAxesTable
from pcnav.core.arrays import BoolArray, FloatArray, IntArray
from pcnav.core.spatial import log_rotation
from pcnav.dynamics.principal_inertia import (
    middle_ratio,
    moments_from_ratios,
    ratios_from_moments,
)
from pcnav.dynamics.state import NavigationState
from pcnav.dynamics.trajectory import Trajectory
from pcnav.estimators.features.photogrammetric_frame import photogrammetric_axes
from pcnav.estimators.principal_axes.estimator import PrincipalAxesEstimator
from pcnav.estimators.principal_axes.feature_states import PA_MOTION_SIZE, PrincipalState
from pcnav.estimators.principal_axes.principal_frame import principal_axes
from pcnav.recordings.tracks import StereoTracks
from pcnav.runs.status import Status
from pcnav.simulation.motion import disturbed_orbit, disturbed_rotation, trajectory_of
from pcnav.simulation.simulation import Simulation
from pcnav.simulation.stereo import StereoScenario, draw_points, observe, with_truth

from . import paper

LABELS = Rotation.create_group("O").as_matrix().round()
"""(24, 3, 3) turns that permute and reverse axes."""


@dataclass(frozen=True)
class Following:
    """Settings and scenario of the runs of a case."""

    table: PrincipalAxesTable
    disturbed: bool
    """Whether the truth is disturbed as the filter supposes; else it moves freely."""
    points: int = 6
    wrong_matches: float = 0.0
    every: int = 10
    """Frames from one that is judged to the next."""


def cases() -> dict[str, Case[Following]]:
    """All, by name."""
    printed, calm = paper.settings(1.0), paper.settings(paper.CALM)
    free = printed.model_copy(update={"unique_frame": False})
    double = calm.model_copy(update={"measurements": FeatureMeasurements.PRINTED})
    found = {
        "unique axes": Following(printed, disturbed=False, every=2),
        "free axes": Following(free, disturbed=False, every=2),
        "matched": Following(calm, disturbed=True),
        "pixels used twice": Following(double, disturbed=True),
        "wrong matches": Following(calm, disturbed=True, points=10, wrong_matches=0.1),
    }
    return {name: Case(name, settings) for name, settings in found.items()}


@dataclass(frozen=True)
class Judged:
    """Errors of runs at the n frames that are judged; nan before the start."""

    time_s: FloatArray
    """(n,)"""
    error: FloatArray
    """(runs, n, 14) truth minus estimate in the unique axes: attitude (rad, body axes), rate, p_x
    and p_z, position, velocity."""
    sd: FloatArray
    """(runs, n, 14) as the filter states them."""
    label_free: FloatArray
    """(runs, n, 14) errors from the nearest of the 24 names that the same axes may have."""
    middle_ratio_error: FloatArray
    """(runs, n) of p_y."""
    point_error: FloatArray
    """(runs, n, N, 3) of the points in the state; nan for others."""
    point_sd: FloatArray
    """(runs, n, N, 3)"""
    nees: FloatArray
    """(runs, n) normalised squared error of the whole state."""
    motion_nees: FloatArray
    """(runs, n) of its first 14 components."""
    size: FloatArray
    """(runs, n) components of the whole state."""
    locked: BoolArray
    """(runs, n) whether the frame is called so."""
    lost: BoolArray
    """(runs,) whether the target was lost at any time."""
    matches: IntArray
    """(runs, 4) right ones that the filter turned down, wrong ones that it used, right and wrong
    ones in all; from the start on."""

    def __len__(self) -> int:
        return len(self.error)

    @staticmethod
    def blank(time_s: FloatArray, points: int) -> "Judged":
        """One run, to be filled in."""
        motion, places, one = (
            np.full((1, len(time_s), *shape), np.nan)
            for shape in ((PA_MOTION_SIZE,), (points, 3), ())
        )
        bare = motion.copy(), motion.copy()
        unknown = (*bare, one, places, places.copy(), one.copy(), one.copy(), one.copy())
        locked, lost = np.zeros((1, len(time_s)), np.bool_), np.zeros(1, np.bool_)
        return Judged(time_s, motion, *unknown, locked, lost, np.zeros((1, 4), dtype=np.intp))

    def compare(
        self, n: int, true: PrincipalState, state: PrincipalState, P: FloatArray, slots: list[int]
    ) -> None:
        """Fill in a frame with an estimate, whose points are those of ``slots``."""
        plain = state.additive()
        sd = np.sqrt(np.diag(plain @ P @ plain.T))
        self.error[0, n] = motion_error(state, true)
        self.label_free[0, n] = motion_error(state, nearest_label(state, true))
        self.sd[0, n], self.point_sd[0, n, slots] = (
            sd[:PA_MOTION_SIZE],
            sd[PA_MOTION_SIZE:].reshape(-1, 3),
        )
        self.point_error[0, n, slots] = true.points - state.points
        self.middle_ratio_error[0, n] = middle_ratio(true.ratios) - middle_ratio(state.ratios)
        local = state.local(true)
        motion, motion_P = local[:PA_MOTION_SIZE], P[:PA_MOTION_SIZE, :PA_MOTION_SIZE]
        self.nees[0, n] = local @ np.linalg.solve(P, local)
        self.motion_nees[0, n] = motion @ np.linalg.solve(motion_P, motion)
        self.size[0, n] = len(local)


def motion_error(state: PrincipalState, true: PrincipalState) -> FloatArray:
    """(14,) truth minus estimate."""
    return np.concatenate(
        [
            log_rotation(state.R_world_body.T @ true.R_world_body),
            true.omega_body - state.omega_body,
            true.ratios - state.ratios,
            true.r_hill - state.r_hill,
            true.v_hill - state.v_hill,
        ]
    )


def nearest_label(state: PrincipalState, true: PrincipalState) -> PrincipalState:
    """The truth with its principal axes named and signed as is nearest to an estimate's."""
    turned = state.R_world_body.T @ true.R_world_body
    S = LABELS[np.argmax(np.einsum("ij,nji->n", turned, LABELS))]
    moments = np.abs(S.T) @ moments_from_ratios(true.ratios)
    return replace(
        true,
        R_world_body=true.R_world_body @ S,
        omega_body=S.T @ true.omega_body,
        ratios=ratios_from_moments(moments),
        points=true.points @ S,
    )


def run_case(run: Run[Following]) -> Judged:
    """One run: truth, tracks and noise are the seed's."""
    return judge(run.case.settings, paper.scenario(), run.seed)


def judge(case: Following, scenario: StereoScenario, seed: int) -> Judged:
    """Simulate, estimate and compare."""
    features = scenario.features.model_copy(
        update={"count": case.points, "wrong_match_fraction": case.wrong_matches}
    )
    scenario = replace(scenario, features=features)
    on_points, on_motion, on_tracks = np.random.default_rng(seed).spawn(3)
    points = draw_points(features, on_points)
    truth = disturbed_truth(scenario, case.table if case.disturbed else None, on_motion)
    tracks = observe(scenario, truth, points, on_tracks)
    made = with_truth(tracks, truth, points)
    estimator = PrincipalAxesEstimator(tracks.rig, tracks.orbit, case.table, seed)
    last = len(tracks.frames) - 1
    judged = sorted({*range(0, last, case.every), last})
    run = Judged.blank(truth.time_s[judged], len(points))
    for k, frame in enumerate(tracks.frames):
        estimate = estimator.step(frame)
        use = estimate.features
        if case.wrong_matches and (use.used or use.rejected):
            bad = _wrong_matches(made, k)
            rejected_right, used_wrong = {*use.rejected} - bad, {*use.used} & bad
            right = len(frame.features) - len(bad)
            run.matches[0] += len(rejected_right), len(used_wrong), right, len(bad)
        run.lost[0] |= estimate.status == Status.LOST
        if k in judged:
            n = judged.index(k)
            run.locked[0, n] = estimate.status == Status.LOCKED
            state, P, triple = estimator.state, estimator.covariance, estimator.triple
            if state is not None and P is not None and triple is not None:
                slots = list(estimator.features)
                run.compare(n, true_state(made, k, slots, triple), state, P, slots)
    return run


def _wrong_matches(made: Simulation[StereoTracks], k: int) -> set[int]:
    """Features of a frame whose pixels are not their own."""
    tracks, true = made.recording, NavigationState.of(made.truth, k)
    frame = tracks.frames[k]
    r_world = tracks.orbit.R_hill_world(frame.time_s).T @ true.r_hill
    p_world = r_world + made.points[frame.features] @ true.R_world_body.T
    off = np.abs(tracks.rig.project(p_world @ frame.R_cam_world.T) - frame.pixels).max(axis=1)
    return set(frame.features[off > 6.0 * tracks.rig.pixel_sigma_px].tolist())


def disturbed_truth(
    scenario: StereoScenario, table: PrincipalAxesTable | None, rng: np.random.Generator
) -> Trajectory:
    """The true motion under white disturbances as (4) and (21) have them; None for none.

    The torque is the same about all axes, so its angular acceleration is not.
    """
    times, start = scenario.times_s, scenario.start
    linear = 0.0 if table is None else table.acceleration_psd_m2_s3
    angular = 0.0 if table is None else table.angular_acceleration_psd_rad2_s3
    orbit = disturbed_orbit(scenario.orbit_model, scenario.orbit, start, times, linear, rng)
    moments = np.diag(start.inertia)
    by_axis = angular * np.square(moments[0] / moments)
    return trajectory_of(times, start, orbit, *disturbed_rotation(start, times, by_axis, rng))


def true_state(
    made: Simulation[StereoTracks], k: int, features: Sequence[int], triple: tuple[int, int, int]
) -> PrincipalState:
    """The truth at a frame in its unique principal axes (17), signed by the same three points."""
    true, points = NavigationState.of(made.truth, k), made.points
    R_body_g = photogrammetric_axes(points[list(triple)])
    moments, axes = principal_axes(R_body_g.T @ true.inertia @ R_body_g)
    S = R_body_g @ axes
    return PrincipalState(
        R_world_body=true.R_world_body @ S,
        omega_body=S.T @ true.omega_body,
        ratios=ratios_from_moments(moments),
        r_hill=true.r_hill,
        v_hill=true.v_hill,
        points=points[list(features)] @ S,
    )
