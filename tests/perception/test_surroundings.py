"""Parts of frames small enough to count by hand."""

import numpy as np
import pytest

from pcnav.core.arrays import DepthImage
from pcnav.core.camera import PinholeCamera
from pcnav.perception.surroundings import Surroundings, SurroundingsFinder, surroundings_of

SIZE = 40
CAMERA = PinholeCamera(SIZE, SIZE, 40.0, 40.0, 19.5, 19.5)
DIAMETER_M, SIGMA_M = 2.0, 0.01


def target_alone() -> DepthImage:
    """1.5 m of a target at 5 m, in space."""
    frame = np.zeros((SIZE, SIZE), dtype=np.float32)
    frame[14:26, 14:26] = 5.0
    return frame


def found(frame: DepthImage) -> Surroundings:
    surroundings = surroundings_of(frame, CAMERA, DIAMETER_M, SIGMA_M)
    assert surroundings is not None
    return surroundings


def test_a_frame_with_nothing_but_the_target_has_none() -> None:
    assert surroundings_of(target_alone(), CAMERA, DIAMETER_M, SIGMA_M) is None
    assert surroundings_of(0.0 * target_alone(), CAMERA, DIAMETER_M, SIGMA_M) is None


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_a_wall_is_none_of_the_target_and_the_target_before_it_may_be(share: float) -> None:
    frame = np.full((SIZE, SIZE), 8.0, dtype=np.float32)
    frame[14:26, 14:26] = 5.0
    rng = np.random.default_rng(2)
    frame[rng.random(frame.shape) < share] = 0.0
    candidates = found(frame).candidates
    assert not candidates[frame == 8.0].any()
    assert candidates[frame == 5.0].mean() > 0.98


def test_a_target_that_touches_a_wall_is_one_part_with_it() -> None:
    frame = np.full((SIZE, SIZE), 5.2, dtype=np.float32)
    frame[14:26, 14:26] = 5.0
    # 0.2 m is within the slope of a surface that spans 0.5 m from pixel to pixel.
    assert not found(frame).candidates.any()


def test_what_the_border_cuts_is_no_target() -> None:
    frame = target_alone()
    frame[18:22, 30:] = 2.0
    candidates = found(frame).candidates
    np.testing.assert_array_equal(candidates, frame == 5.0)


def test_lone_returns_are_false_ones() -> None:
    frame = target_alone()
    frame[2::7, 3::7] = np.where(frame[2::7, 3::7] > 0.0, 1.0, 60.0)
    parts = found(frame)
    assert not parts.labels[(frame == 60.0) | (frame == 1.0)].any()
    assert parts.candidates[frame == 5.0].all()


def test_a_large_image_is_joined_on_every_second_pixel() -> None:
    camera = PinholeCamera(600, 400, 600.0, 600.0, 299.5, 199.5)
    frame = np.full((400, 600), 8.0, dtype=np.float32)
    frame[100:300, 201:400] = 5.0
    surroundings = surroundings_of(frame, camera, DIAMETER_M, SIGMA_M)
    assert surroundings is not None
    np.testing.assert_array_equal(surroundings.candidates, frame == 5.0)
    assert (surroundings.labels > 0).all()


def test_a_frame_is_looked_at_once() -> None:
    finder = SurroundingsFinder(DIAMETER_M)
    frame = np.full((SIZE, SIZE), 8.0, dtype=np.float32)
    first = finder.of(frame, CAMERA, SIGMA_M)
    assert first is not None
    assert finder.of(frame, CAMERA, SIGMA_M) is first
    assert finder.of(target_alone(), CAMERA, SIGMA_M) is None


def test_a_coarse_grid_has_the_parts_of_the_whole_image() -> None:
    # On every fourth pixel a gap of two between the halves of a target is none.
    frame = np.zeros((SIZE, SIZE), dtype=np.float32)
    frame[12:20, 30:], frame[22:30, 20:37], frame[:34, 4:8] = 5.0, 5.0, 4.0
    finder = SurroundingsFinder(2.0 * DIAMETER_M)
    whole, coarse = finder.of(frame, CAMERA, SIGMA_M), finder.of(frame, CAMERA, SIGMA_M, 4)
    assert whole is not None
    assert coarse is not None
    np.testing.assert_array_equal(coarse.labels, whole.labels[::4, ::4])
    np.testing.assert_array_equal(coarse.candidates, whole.candidates[::4, ::4])
    assert coarse.sizes.sum() == coarse.labels.size
    strided = CAMERA.strided(4)
    assert surroundings_of(frame[::4, ::4], strided, 2.0 * DIAMETER_M, SIGMA_M) is None


def test_an_arm_from_the_border_is_told_from_the_target_though_both_are_small() -> None:
    frame = target_alone()
    frame[18:22, 24:] = 4.0
    candidates = found(frame).candidates
    np.testing.assert_array_equal(candidates, frame == 5.0)
    # A target that leaves the view is alone in it.
    alone = np.zeros_like(frame)
    alone[14:26, 32:] = 5.0
    assert surroundings_of(alone, CAMERA, DIAMETER_M, SIGMA_M) is None


def test_a_small_part_that_the_border_cuts_is_the_targets_where_a_view_agrees_with_it() -> None:
    frame = target_alone()
    frame[18:22, 24:] = 4.0
    whole = (slice(None), slice(None))
    parts = found(frame)
    on_the_arm, elsewhere = frame == 4.0, frame == 5.0
    np.testing.assert_array_equal(parts.candidates_where(on_the_arm, whole), frame > 0.0)
    np.testing.assert_array_equal(parts.candidates_where(elsewhere, whole), frame == 5.0)
