"""The runs of the study: random points and pixels, a bank over each, errors against the truth."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from pcnav.batch.monte_carlo import Case, RunBatch
from pcnav.config.inertia_bank import InertiaBankTable
from pcnav.core.arrays import FloatArray, IntArray, picked
from pcnav.core.spatial import exp_rotation, log_rotation
from pcnav.estimators.inertia_bank.bank import InertiaBank, start_motion, triangulated
from pcnav.estimators.inertia_bank.hypotheses import moment_matched
from pcnav.estimators.inertia_bank.relative_state import (
    IB_MOTION,
    PixelMeasurements,
    RelativeStates,
    reduced_pixels,
)
from pcnav.evaluation.consistency import squared_normalised_errors

from . import paper
from .draws import (
    drawn_and_truth,
    drawn_as_printed,
    four_and_truth,
    four_moments_and_truth,
    truth_only,
)
from .paper import Motion

STUDY = "segal2011"
RUNS_PER_BATCH = 20
"""So many filters are one array that it stays in the processor's cache."""
QUANTITIES = ("position, m", "velocity, m/s", "attitude, deg", "angular rate, deg/s", "points, m")
"""Norms of errors; of the points the root mean square over them."""
VAGUE_ATTITUDE_SD_DEG = 5.0
"""That of the shipped settings, about each axis: how much the picks owe to the study's 1 degree."""
_DRAW_STREAM = 1


@dataclass(frozen=True)
class Bank:
    """What runs of one kind have in common."""

    hypotheses: Callable[[np.random.Generator], FloatArray]
    """(h, 3, 3) that the filters of a run believe in; the generator is the run's own."""
    motion: Motion
    table: InertiaBankTable = paper.BANK
    blend: int = 0
    """So many of the first hypotheses are also blended by their weights; 0 for none."""

    def case(self, name: str) -> Case["Bank"]:
        """By name; its work is that of its filters and frames."""
        count = len(self.hypotheses(np.random.default_rng(0)))
        return Case(name, self, 1e-3 * count * len(self.motion.times_s))


@dataclass(frozen=True)
class Found:
    """What runs found; they lie along the second axis."""

    inertia: FloatArray
    """(h, runs, 3, 3) that the filters believe in."""
    errors: FloatArray
    """(frames, runs, h, 5) of `QUANTITIES`."""
    blended: FloatArray
    """(1, runs, 5) of the weighted estimate at the last frame; nan without it."""
    log_innovation: FloatArray
    """(frames, runs, h) log likelihood of all frames so far, by innovation covariance."""
    log_printed: FloatArray
    """(frames, runs, h) by (12)."""
    nees: FloatArray
    """(frames, runs, h) normalised squared error of the motion (12 components)."""

    @property
    def runs(self) -> int:
        """How many."""
        return int(self.errors.shape[1])

    def picked(self, among: IntArray, printed: bool = False) -> IntArray:
        """(frames, runs) index of the most probable of some hypotheses at every frame."""
        logs = self.log_printed if printed else self.log_innovation
        return np.asarray(among[np.argmax(logs[..., among], axis=-1)], dtype=np.intp)

    def errors_of(self, hypothesis: IntArray) -> FloatArray:
        """(frames, runs, 5) errors of the hypothesis (frames, runs) that is believed."""
        chosen = np.take_along_axis(self.errors, hypothesis[..., None, None], axis=2)
        return np.asarray(chosen[:, :, 0])


def bank_cases(motion: Motion) -> list[Case[Bank]]:
    """The paper's five hypotheses, as a body can have them and as printed."""
    physical = Bank(drawn_and_truth, motion, blend=paper.HYPOTHESES)
    printed = replace(physical, hypotheses=drawn_as_printed)
    return [physical.case("physical draws"), printed.case("draws as printed")]


def coupling_cases(motion: Motion) -> list[Case[Bank]]:
    """The true inertia with the paper's uncoupled model, and without a lever arm."""
    plain = paper.BANK.model_copy(update={"kinematic_coupling": False})
    no_arm = paper.BANK.model_copy(update={"mass_centre_sd_m": 1e-3})
    return [
        Bank(truth_only, motion, plain).case("uncoupled, (22)-(24)"),
        Bank(truth_only, motion, no_arm).case("no lever arm"),
    ]


def motion_cases(motion: Motion) -> list[Case[Bank]]:
    """The printed motion with axes known worse, and others: faster, and about a principal axis."""
    _, axes = np.linalg.eigh(paper.TARGET_INERTIA)
    duration_s, interval_s = float(motion.times_s[-1]), float(motion.times_s[1])

    def moving(omega: FloatArray, share: float = 1.0) -> Bank:
        moved = paper.true_motion(
            omega_body=omega, duration_s=share * duration_s, interval_s=interval_s
        )
        return Bank(four_and_truth, moved)

    vague = paper.BANK.model_copy(update={"attitude_sd_deg": VAGUE_ATTITUDE_SD_DEG})
    name = f"as printed, attitude known to {VAGUE_ATTITUDE_SD_DEG:g} deg"
    half = moving(paper.OMEGA_0, 0.5)
    spin = moving(np.radians(0.5) * axes[:, 2])
    moments = replace(spin, hypotheses=four_moments_and_truth)
    return [
        Bank(four_and_truth, motion, vague).case(name),
        replace(half, table=vague).case(f"{name}, half the arc"),
        moving(3.0 * paper.OMEGA_0).case("three times the printed rate"),
        spin.case("spin about the largest moment, 0.5 deg/s"),
        moments.case("same spin, hypotheses that differ in moments only"),
    ]


def run_batch(batch: RunBatch[Bank]) -> Found:
    """Filter all runs of a batch as one array."""
    case = batch.case.settings
    motion, runs, frames = case.motion, len(batch.seeds), len(case.motion.times_s)
    inertia = np.stack(
        [case.hypotheses(np.random.default_rng([seed, _DRAW_STREAM])) for seed in batch.seeds]
    )
    generators = [np.random.default_rng(seed) for seed in batch.seeds]
    limit = paper.HALF_EXTENT_M
    points = np.stack([g.uniform(-limit, limit, (paper.POINTS, 3)) for g in generators])
    turns = np.stack([g.standard_normal(3) for g in generators])
    pixels = _pixels(motion, points, generators)
    bank = _started(case, inertia, pixels[0], np.radians(case.table.attitude_sd_deg) * turns)
    h = inertia.shape[1]
    errors = np.zeros((frames, runs, h, len(QUANTITIES)))
    blended = np.full((1, runs, len(QUANTITIES)), np.nan)
    innovation, printed, nees = (np.zeros((frames, runs, h)) for _ in range(3))
    for k, time in enumerate(motion.times_s):
        if k > 0:
            seen = PixelMeasurements(
                paper.RIG, paper.R_RIG_HILL, np.arange(paper.POINTS), reduced_pixels(pixels[k])
            )
            result = bank.step(float(time), seen)
            assert result is not None
            for logs, squares in (
                (innovation, result.joint_nis + result.log_determinant),
                (printed, result.noise_squares),
            ):
                lost = np.where(bank.broken, np.inf, squares)
                logs[k] = logs[k - 1] - 0.5 * lost.reshape(runs, h)
        truth = _truth(bank.states, motion, k, np.repeat(points, h, axis=0))
        errors[k] = _errors(bank.states, truth).reshape(runs, h, -1)
        local = bank.states.local(truth)[:, IB_MOTION]
        P = bank.covariance[:, IB_MOTION, IB_MOTION]
        nees[k] = squared_normalised_errors(local, P).reshape(runs, h)
    if case.blend:
        blended[0] = _blended_errors(bank, innovation[-1], case.blend, truth, h)
    return Found(np.swapaxes(inertia, 0, 1), errors, blended, innovation, printed, nees)


def _pixels(
    motion: Motion, points: FloatArray, generators: list[np.random.Generator]
) -> FloatArray:
    """(frames, runs, N, 4) measured coordinates; each run draws its own noise."""
    turned = points[None] @ np.swapaxes(motion.R_hill_body, -1, -2)[:, None]
    p_rig = (motion.r_hill[:, None, None] + turned) @ paper.R_RIG_HILL.T
    clean = paper.RIG.project(p_rig)
    shape = (len(clean), paper.POINTS, 4)
    noise = np.stack([g.standard_normal(shape) for g in generators], axis=1)
    return np.asarray(clean + paper.RIG.pixel_sigma_px * noise)


def _started(case: Bank, inertia: FloatArray, pixels: FloatArray, tilt: FloatArray) -> InertiaBank:
    """The bank after the first frame; ``tilt`` (runs, 3) is by how much the attitude is off."""
    positions, noise = triangulated(paper.RIG, paper.R_RIG_HILL, pixels)
    R_hill_body = case.motion.R_hill_body[0] @ exp_rotation(tilt)
    start = start_motion(case.table, positions, R_hill_body)
    bank = InertiaBank(case.table, paper.ORBIT, inertia, start, float(case.motion.times_s[0]))
    bank.add(positions, noise)
    return bank


def _truth(states: RelativeStates, motion: Motion, k: int, points: FloatArray) -> RelativeStates:
    size = len(states.r_hill)
    return RelativeStates(
        np.broadcast_to(motion.r_hill[k], (size, 3)),
        np.broadcast_to(motion.v_hill[k], (size, 3)),
        np.broadcast_to(motion.R_hill_body[k], (size, 3, 3)),
        np.broadcast_to(motion.omega_body[k], (size, 3)),
        points,
        states.coupled,
    )


def _errors(states: RelativeStates, truth: RelativeStates) -> FloatArray:
    """(B, 5) of `QUANTITIES`."""
    turn = np.swapaxes(states.R_hill_body, -1, -2) @ truth.R_hill_body
    apart = states.points_body - truth.points_body
    return np.stack(
        [
            np.linalg.norm(states.r_hill - truth.r_hill, axis=-1),
            np.linalg.norm(states.v_hill - truth.v_hill, axis=-1),
            np.degrees(np.linalg.norm(log_rotation(turn), axis=-1)),
            np.degrees(np.linalg.norm(states.omega_body - truth.omega_body, axis=-1)),
            np.sqrt(np.mean(np.sum(apart**2, axis=-1), axis=-1)),
        ],
        axis=-1,
    )


def _blended_errors(
    bank: InertiaBank, log_likelihood: FloatArray, blend: int, truth: RelativeStates, h: int
) -> FloatArray:
    """(runs, 5) errors of the estimate weighted over the first ``blend`` hypotheses."""
    runs = len(log_likelihood)
    some = (np.arange(runs)[:, None] * h + np.arange(blend)).ravel()
    logs = log_likelihood[:, :blend]
    weights = np.exp(logs - logs.max(axis=1, keepdims=True))
    weights /= weights.sum(axis=1, keepdims=True)
    mixture = moment_matched(
        picked(bank.states, some), bank.covariance[some], weights, np.zeros((runs, blend, 0))
    )
    return _errors(mixture.states, picked(truth, np.arange(runs) * h))
