"""Batches of runs: random points and pixels, a bank over each, errors against the truth."""

from dataclasses import dataclass

import numpy as np

from pcnav.config.inertia_bank import InertiaBankTable
from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, log_rotation
from pcnav.estimators.inertia_bank.bank import InertiaBank, start_motion, triangulated
from pcnav.estimators.inertia_bank.hypotheses import moment_matched
from pcnav.estimators.inertia_bank.relative_state import (
    MOTION,
    PixelMeasurements,
    RelativeStates,
    reduced_pixels,
)

from . import paper
from .paper import Motion

QUANTITIES = ("position, m", "velocity, m/s", "attitude, deg", "angular rate, deg/s", "points, m")
"""Norms of errors; of the points the root mean square over them."""


@dataclass(frozen=True)
class Batch:
    """Runs that share a motion and settings and are filtered as one array."""

    name: str
    motion: Motion
    table: InertiaBankTable
    seeds: tuple[int, ...]
    """One per run."""
    inertia: FloatArray
    """(runs, h, 3, 3) what the filters of each run believe in."""
    blend: int = 0
    """So many of the first hypotheses are also blended by their weights; 0 for none."""

    def __str__(self) -> str:
        return f"{self.name}, seeds {self.seeds[0]} and after"


@dataclass(frozen=True)
class BatchErrors:
    """What a batch found."""

    errors: FloatArray
    """(frames, runs, h, 5) of `QUANTITIES`."""
    blended: FloatArray
    """(runs, 5) of the weighted estimate at the last frame; no runs without it."""
    log_innovation: FloatArray
    """(frames, runs, h) log likelihood of all frames so far, by innovation covariance."""
    log_printed: FloatArray
    """(frames, runs, h) by (12)."""
    nees: FloatArray
    """(frames, runs, h) normalised squared error of the motion (12 components)."""


def run_batch(batch: Batch) -> BatchErrors:
    """Filter all runs of a batch."""
    motion, runs = batch.motion, len(batch.seeds)
    generators = [np.random.default_rng(seed) for seed in batch.seeds]
    limit = paper.HALF_EXTENT_M
    points = np.stack([g.uniform(-limit, limit, (paper.POINTS, 3)) for g in generators])
    tilt = np.radians(batch.table.attitude_sd_deg) * np.stack(
        [g.standard_normal(3) for g in generators]
    )
    frames = len(motion.times_s)
    pixels = _pixels(motion, points, generators)
    bank = _started(batch, pixels[0], tilt)
    h = batch.inertia.shape[1]
    errors = np.zeros((frames, runs, h, len(QUANTITIES)))
    blended = np.zeros((0, len(QUANTITIES)))
    innovation, printed, nees = (np.zeros((frames, runs, h)) for _ in range(3))
    for k, time in enumerate(motion.times_s):
        if k > 0:
            seen = PixelMeasurements(
                paper.RIG, paper.R_RIG_HILL, np.arange(paper.POINTS), reduced_pixels(pixels[k])
            )
            result = bank.step(float(time), seen)
            assert result is not None
            squares = np.where(bank.broken, np.inf, result.joint_nis + result.log_determinant)
            innovation[k] = innovation[k - 1] - 0.5 * squares.reshape(runs, h)
            squares = np.where(bank.broken, np.inf, result.noise_squares)
            printed[k] = printed[k - 1] - 0.5 * squares.reshape(runs, h)
        truth = _truth(bank.states, motion, k, np.repeat(points, h, axis=0))
        errors[k] = _errors(bank.states, truth).reshape(runs, h, -1)
        nees[k] = _nees(bank, truth).reshape(runs, h)
        if batch.blend and k == frames - 1:
            blended = _blended_errors(bank, innovation[k], batch.blend, truth, h)
    return BatchErrors(errors, blended, innovation, printed, nees)


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


def _started(batch: Batch, pixels: FloatArray, tilt: FloatArray) -> InertiaBank:
    """The bank after the first frame; ``tilt`` (runs, 3) is by how much the attitude is off."""
    positions, noise = triangulated(paper.RIG, paper.R_RIG_HILL, pixels)
    R_hill_body = batch.motion.R_hill_body[0] @ exp_rotation(tilt)
    start = start_motion(batch.table, positions, R_hill_body)
    bank = InertiaBank(
        batch.table, paper.ORBIT, batch.inertia, start, float(batch.motion.times_s[0])
    )
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


def _nees(bank: InertiaBank, truth: RelativeStates) -> FloatArray:
    """(B,) of the motion."""
    error = bank.states.local(truth)[:, MOTION]
    P = bank.covariance[:, MOTION, MOTION]
    return np.asarray(np.sum(error * np.linalg.solve(P, error[..., None])[..., 0], axis=-1))


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
        bank.states.take(some), bank.covariance[some], weights, np.zeros((runs, blend, 0))
    )
    return _errors(mixture.states, truth.take(np.arange(runs) * h))
