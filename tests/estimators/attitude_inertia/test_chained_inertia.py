"""Attitude, rate and inertia from a chain of attitudes whose errors belong together."""

from dataclasses import replace

import numpy as np
import pytest

from pcnav.config.attitude_inertia import AttitudeInertiaTable
from pcnav.config.image_motion import ImageMotionTable
from pcnav.core.spatial import log_rotation
from pcnav.estimators.attitude_inertia.chained_inertia import ChainedInertiaEstimator
from pcnav.estimators.attitude_inertia.rotation_fit import AttitudeArc
from pcnav.estimators.attitude_inertia.rotation_model import (
    INERTIA,
    OMEGA,
    THETA,
    RotationState,
    parameters_from_printed,
)
from pcnav.estimators.image_motion.chain import ChainFrame, ChainLink, run_chain
from pcnav.estimators.image_motion.chain_errors import ChainErrors
from pcnav.estimators.image_motion.relative import Outcome
from pcnav.simulation.images import TrackFaults
from studies.applsci2022 import paper
from studies.applsci2022.scene import nutation, tracks_of

TABLE = AttitudeInertiaTable(rate_sd_deg_s=1.0)
SIGMA_PX = 0.1
SETTINGS = ImageMotionTable(pixel_sigma_px=SIGMA_PX)


def _link(rng: np.random.Generator, features: np.ndarray, seen: np.ndarray) -> ChainLink:
    """Any link: the gains of both frames are what its covariance is made of."""
    by_reference = rng.standard_normal((len(features), 3, 2))
    by_own = np.zeros((len(seen), 3, 2))
    told = np.isin(seen, features)
    by_own[told] = rng.standard_normal((told.sum(), 3, 2))
    covariance = np.einsum("nik,njk->ij", by_reference, by_reference)
    covariance += np.einsum("nik,njk->ij", by_own, by_own)
    return ChainLink(features, by_reference, seen, by_own, covariance, 1.0)


def test_joint_covariance_is_that_of_the_noise_carried_along_the_links() -> None:
    """Against the derivative of every error by every coordinate's noise, written out."""
    rng = np.random.default_rng(1)
    references = [None, 0, 0, 1, 1, 2, None, 6, 6, 7]
    all_features = np.arange(8)
    errors = ChainErrors()
    # By number of the frame, feature and coordinate.
    gains: list[np.ndarray] = []
    own_covariance = 0.3 * np.eye(3)
    in_view: list[np.ndarray] = []
    for number, reference in enumerate(references):
        seen = np.sort(rng.choice(all_features, 7, replace=False))
        noise = np.zeros((3, len(references), 8, 2))
        if reference is None:
            errors.begin(number, ChainLink.to_nothing(seen), own_covariance)
        else:
            features = np.intersect1d(seen, in_view[reference])[:5]
            link = _link(rng, features, seen)
            errors.add(number, reference, link)
            noise += gains[reference]
            noise[:, reference, features] += np.moveaxis(link.by_reference, 0, 1)
            noise[:, number, seen] += np.moveaxis(link.by_own, 0, 1)
        in_view.append(seen)
        gains.append(noise)
    by_noise = np.stack(gains).reshape(3 * len(references), -1)
    expected = by_noise @ by_noise.T
    for first in ([0, 1, 2, 3, 4, 5], [6, 7, 8, 9]):
        at = np.concatenate([3 * k + np.arange(3) for k in first])
        expected[np.ix_(at, at)] += np.kron(np.ones((len(first),) * 2), own_covariance)
    np.testing.assert_allclose(errors.covariance(range(10)), expected, atol=1e-12)


@pytest.mark.parametrize("kind", ["adjacent", "key_frame"])
def test_errors_of_a_chain_are_as_large_together_as_stated(kind: str) -> None:
    """Over runs the whitened errors of all frames together have unit variance."""
    settings = ImageMotionTable.model_validate(
        {"reference": kind, "pixel_sigma_px": SIGMA_PX, "max_sd_deg": 3.0}
    )
    squared, count = 0.0, 0
    for run in range(6):
        truth = nutation(120.0, 5.0, 3, 200)
        frames = run_chain(tracks_of(truth, TrackFaults(SIGMA_PX), 50 + run), settings)
        errors, thetas, numbers = ChainErrors(), [], []
        for k, frame in enumerate(frames):
            if frame.R_world_body is None or frame.link is None or frame.segment:
                continue
            if frame.reference is None:
                errors.begin(k, frame.link, np.zeros((3, 3)))
                R_true_body = truth.R_world_body[k].T @ frame.R_world_body
                continue
            errors.add(k, frame.reference, frame.link)
            assert frame.covariance is not None
            np.testing.assert_allclose(errors.covariance([k]), frame.covariance, atol=1e-15)
            if frame.link.worst_sd < np.radians(1.5):
                true = truth.R_world_body[k] @ R_true_body
                thetas.append(log_rotation(frame.R_world_body.T @ true))
                numbers.append(k)
        whitened = np.linalg.solve(
            np.linalg.cholesky(errors.covariance(numbers)), np.concatenate(thetas)
        )
        squared, count = squared + float(whitened @ whitened), count + len(whitened)
    # 2.6 standard deviations of a chi-square mean of so many degrees of freedom, and second order.
    assert squared / count == pytest.approx(1.0, abs=0.25)


def test_whitening_by_a_joint_covariance_is_that_of_its_blocks() -> None:
    rng = np.random.default_rng(2)
    roots = rng.standard_normal((4, 3, 3))
    noise = roots @ np.swapaxes(roots, 1, 2) + np.eye(3)
    rows = rng.standard_normal((4, 2, 3, 5))
    joint = np.zeros((12, 12))
    for k in range(4):
        joint[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = noise[k]
    times, R = np.arange(4.0), np.broadcast_to(np.eye(3), (4, 2, 3, 3))
    np.testing.assert_allclose(
        AttitudeArc(times, R, joint).whitened(rows), AttitudeArc(times, R, noise).whitened(rows)
    )


def _estimates(frames: list[ChainFrame]):
    estimator = ChainedInertiaEstimator(TABLE)
    return [estimator.step(frame) for frame in frames]


def _chain(duration_s: float, seed: int) -> tuple[object, list[ChainFrame]]:
    truth = nutation(duration_s, 5.0, seed, 200)
    return truth, list(run_chain(tracks_of(truth, TrackFaults(SIGMA_PX), seed), SETTINGS))


def _error(truth, frames: list[ChainFrame], k: int, state: RotationState) -> np.ndarray:
    R_true_body = truth.R_world_body[0].T @ frames[0].R_world_body
    inertia = R_true_body.T @ paper.INERTIA_KG_M2 @ R_true_body
    entries = [inertia[i, j] / inertia[2, 2] for i, j in ((0, 0), (1, 1), (0, 1), (0, 2), (1, 2))]
    true = RotationState(
        (truth.R_world_body[k] @ R_true_body)[None],
        (truth.omega_body[k] @ R_true_body)[None],
        parameters_from_printed(np.array(entries))[None],
    )
    return state.local(true)[0]


@pytest.mark.study
def test_inertia_from_images_is_as_good_as_stated() -> None:
    normalised = []
    for seed in range(3, 9):
        truth, frames = _chain(300.0, seed)
        last = _estimates(frames)[-1]
        assert last is not None
        error = _error(truth, frames, len(frames) - 1, last.state)
        assert np.abs(error[INERTIA]).max() < 0.02
        assert np.abs(np.degrees(error[OMEGA])).max() < 0.01
        normalised.append(error @ np.linalg.solve(last.covariance, error))
    # 66 degrees of freedom: 0.1 % of the means lie above. A little caution is allowed for.
    assert 0.4 < np.mean(normalised) / 11.0 < 1.6


def test_a_new_segment_goes_on_with_what_was_learnt() -> None:
    """All features are lost at once: the chain begins anew, what is known of the inertia grows."""
    truth = nutation(300.0, 5.0, 5, 200)
    tracks = tracks_of(truth, TrackFaults(SIGMA_PX), 5)
    cut = 30
    renamed = tuple(
        replace(frame, features=frame.features + 1000) if k >= cut else frame
        for k, frame in enumerate(tracks.frames)
    )
    frames = list(run_chain(replace(tracks, frames=renamed), SETTINGS))
    assert frames[cut].outcome is Outcome.FIRST and frames[cut].segment == 1
    assert frames[-1].segment == 1
    estimates = _estimates(frames)
    before, last = estimates[cut - 1], estimates[-1]
    assert before is not None and last is not None
    sd_before, sd = (np.sqrt(np.diag(each.covariance)) for each in (before, last))
    assert np.all(sd[INERTIA] < 0.3 * sd_before[INERTIA])
    # In the axes of the first segment, although the second has others.
    error = _error(truth, frames, len(frames) - 1, last.state)
    assert error @ np.linalg.solve(last.covariance, error) / 11.0 < 2.5


def test_frames_without_attitude_are_coasted_through() -> None:
    truth, frames = _chain(250.0, 6)
    blind = [
        replace(frame, R_world_body=None, link=None, outcome=Outcome.FEW_MATCHES)
        if k > 40
        else frame
        for k, frame in enumerate(frames)
    ]
    estimates = _estimates(blind)
    assert estimates[0] is None
    last, before = estimates[-1], estimates[40]
    assert last is not None and before is not None
    assert last.time_s == frames[-1].time_s and not last.fitted
    assert np.trace(last.covariance[THETA, THETA]) > np.trace(before.covariance[THETA, THETA])
    error = _error(truth, frames, len(frames) - 1, last.state)
    assert error @ np.linalg.solve(last.covariance, error) / 11.0 < 2.5
