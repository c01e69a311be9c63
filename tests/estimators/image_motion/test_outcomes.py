"""What became of each feature of an image, and why."""

from dataclasses import replace

import numpy as np

from pcnav.config.image_motion import ImageMotionTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation
from pcnav.estimators.image_motion.chain import ChainFrame, ImageMotionChain
from pcnav.estimators.image_motion.outcomes import feature_outcomes
from pcnav.estimators.image_motion.relative import Outcome
from pcnav.recordings.tracks import TrackFrame
from pcnav.runs.feature_outcomes import GATED, INLIER, TRACKED
from pcnav.runs.records import ACCEPTED

CAMERA = PinholeCamera(2048, 2048, 2909.0, 2909.0, 1024.0, 1024.0)
SIGMA_PX = 0.3
SETTINGS = ImageMotionTable()
WRONG = (3, 17, 40)
NEW = 99


def pixels_of(p_body: FloatArray, turn_rad: float) -> FloatArray:
    """(n, 2) of points (n, 3) of a target 30 m ahead that has turned about an oblique axis."""
    p_cam = p_body @ exp_rotation(turn_rad * np.array([0.5, 0.8, 0.3])).T + [0.0, 0.0, 30.0]
    return np.asarray(p_cam[:, :2] / p_cam[:, 2:] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy])


def two_frames(*, turn_rad: float = 0.12, flat: bool = False) -> tuple[TrackFrame, TrackFrame]:
    """The second shows three features elsewhere, and one that is new."""
    rng = np.random.default_rng(11)
    p_body = rng.uniform(-2.0, 2.0, (60, 3)) * ([1.0, 1.0, 0.0] if flat else [1.0, 1.0, 1.0])
    names = np.arange(60)
    seen = [
        pixels_of(p_body, turn) + SIGMA_PX * rng.standard_normal((60, 2))
        for turn in (0.0, turn_rad)
    ]
    seen[1][list(WRONG)] += [[60.0, -80.0], [-90.0, 50.0], [70.0, 100.0]]
    names_2 = np.append(names, NEW)
    return (
        TrackFrame(0.0, np.eye(3), names, seen[0]),
        TrackFrame(1.0, np.eye(3), names_2, np.vstack([seen[1], [[1000.0, 900.0]]])),
    )


def answers(frames: tuple[TrackFrame, TrackFrame]) -> list[ChainFrame]:
    chain = ImageMotionChain(CAMERA, SIGMA_PX, SETTINGS)
    return [chain.step(frame) for frame in frames]


def test_wrong_matches_are_beyond_the_gate_and_the_others_within() -> None:
    first, second = two_frames()
    begun, measured = answers((first, second))
    assert measured.outcome is Outcome.MEASURED
    assert set(feature_outcomes(begun, first.features).outcome) == {TRACKED}
    found = feature_outcomes(measured, second.features)
    of = dict(zip(second.features.tolist(), found.outcome, strict=True))
    assert [name for name, outcome in of.items() if outcome == GATED] == list(WRONG)
    assert of[NEW] == TRACKED and np.isnan(found.of(NEW)[1])
    accepted = np.array([outcome == ACCEPTED for outcome in found.outcome])
    assert accepted.sum() == 57 == measured.agreeing
    assert found.gate == SETTINGS.inlier_gate_sigma**2
    assert (found.squared_distance[accepted] < found.gate).all()
    assert all(found.of(name)[1] > found.gate for name in WRONG)
    # Five degrees of freedom are fitted; the variance of a squared normal number is 2.
    mean = float(found.squared_distance[accepted].mean())
    assert abs(mean - 52.0 / 57.0) < 3.0 * np.sqrt(2.0 / 57.0)


def test_the_distance_is_that_of_the_epipolar_constraint_over_its_deviation() -> None:
    """Its gradient by all four pixel coordinates, taken numerically."""
    first, second = two_frames()
    measured = answers((first, second))[1]
    found = feature_outcomes(measured, second.features)
    relative = measured.relative
    assert relative is not None
    t, R = relative.candidates[0].direction, relative.candidates[0].R_second_first

    def constraint(coordinates: FloatArray) -> float:
        rays = [
            np.append((xy - [CAMERA.cx, CAMERA.cy]) / [CAMERA.fx, CAMERA.fy], 1.0)
            for xy in (coordinates[:2], coordinates[2:])
        ]
        return float(rays[1] @ np.cross(t, R @ rays[0]))

    for name in (*WRONG, 0, 30):
        at = np.concatenate([first.pixels[name], second.pixels[name]])
        slopes = [constraint(at + step) - constraint(at - step) for step in 0.5 * np.eye(4)]
        expected = constraint(at) ** 2 / (SIGMA_PX**2 * np.dot(slopes, slopes))
        np.testing.assert_allclose(found.of(name)[1], expected, rtol=1e-4)


def test_features_of_a_frame_that_is_not_measured_are_not_told_to_be_used() -> None:
    frames = two_frames(flat=True)
    planar = answers(frames)[1]
    assert planar.outcome is Outcome.PLANAR
    found = feature_outcomes(planar, frames[1].features)
    assert INLIER in found.outcome and ACCEPTED not in found.outcome
    # Nothing moved: there is nothing to compare with.
    still = replace(frames[0], time_s=1.0)
    same = answers((frames[0], still))[1]
    assert same.outcome is Outcome.NO_MOTION
    found = feature_outcomes(same, still.features)
    assert set(found.outcome) == {TRACKED} and np.isnan(found.squared_distance).all()
