"""Frame against view on images small enough to count by hand."""

import numpy as np
import pytest
import trimesh

from pcnav.core.arrays import DepthImage
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import exp_rotation, make_transform
from pcnav.perception.agreement import Agreement, agreement, judged
from pcnav.perception.surroundings import Surroundings, surroundings_of
from pcnav.target.rendering import DepthRenderer, RenderedDepth

SIZE = 16
TOLERANCE = 0.1
PART = (slice(3, 13), slice(3, 13))
"""Of the view: a surface of 10 x 10 pixels at 5 m."""


def image() -> DepthImage:
    return np.zeros((SIZE, SIZE), dtype=np.float32)


def view(window: tuple[slice, slice] = (slice(0, SIZE), slice(0, SIZE))) -> RenderedDepth:
    """The surface before space."""
    depth_m, triangle = image(), np.full((SIZE, SIZE), -1, dtype=np.intp)
    depth_m[PART], triangle[PART] = 5.0, 0
    camera = PinholeCamera(SIZE, SIZE, 20.0, 20.0, 7.5, 7.5)
    return RenderedDepth(camera, depth_m, triangle, window, np.array([[0.0, 0.0, 0.2]]))


def counts(frame: DepthImage, rendered: RenderedDepth | None = None) -> tuple[int, int]:
    found = agreement(frame, view() if rendered is None else rendered, TOLERANCE)
    return found.agree, found.conflict


def test_the_view_itself_agrees_everywhere() -> None:
    frame = image()
    frame[PART] = 5.0
    assert counts(frame) == (100, 0)
    assert agreement(frame, view(), TOLERANCE).inlier_ratio == 1.0


def test_depths_count_by_the_tolerance() -> None:
    frame = image()
    frame[PART] = 5.0
    frame[3, 3:8] = [4.89, 4.91, 5.09, 5.11, 9.0]
    assert counts(frame) == (97, 3)


def test_returns_where_space_is_predicted_speak_against() -> None:
    frame = image()
    frame[PART] = 5.0
    frame[0, :4] = 5.0
    frame[15, 15] = 80.0
    assert counts(frame) == (100, 5)
    # Outside the window nothing is predicted; they count all the same.
    assert counts(frame, view(PART)) == (100, 5)


def test_gaps_between_returns_are_dropouts_and_say_nothing() -> None:
    frame = image()
    frame[PART] = 5.0
    frame[5, 5] = frame[8, 7] = frame[8, 10] = 0.0
    assert counts(frame) == (97, 0)
    # Every second return lost: in each 5 x 5 patch a third of them is left, at least.
    frame = image()
    frame[PART] = 5.0
    frame[4:12:2, 4:12:2] = frame[5:12:2, 5:12:2] = 0.0
    assert counts(frame) == (68, 0)


def test_empty_patches_where_a_surface_is_predicted_speak_against() -> None:
    frame = image()
    frame[PART] = 5.0
    frame[3:13, 8:13] = 0.0
    # Of the five columns without returns the first has two columns of five beside it, 40 %; the
    # others fewer, and the corner rows fewer again: (3, 8) sees 3 x 2 of 25, (4, 8) sees 4 x 2.
    empty = sum(
        np.count_nonzero(frame[max(i - 2, 0) : i + 3, j - 2 : j + 3]) < 0.35 * 25
        for i in range(3, 13)
        for j in range(8, 13)
    )
    assert empty == 4 * 10 + 4
    assert counts(frame) == (50, empty)
    # Nothing at all where all is predicted, and a single return elsewhere.
    frame = image()
    frame[0, 0] = 5.0
    assert counts(frame) == (0, 101)


def test_a_frame_beside_the_view_contradicts_it_twice() -> None:
    frame = image()
    frame[3:13, 11:16] = 5.0
    # Two columns fit, three are seen where space is, and of the eight missing columns the one
    # beside the returns has 40 % about it, but for its ends.
    assert counts(frame) == (20, 30 + 80 - 6)
    assert agreement(frame, view(), TOLERANCE).inlier_ratio == pytest.approx(20 / 124)


def test_share_is_nan_where_frame_and_view_are_silent() -> None:
    rendered = view((slice(0, 0), slice(0, 0)))
    rendered.triangle[:], rendered.depth_m[:] = -1, 0.0
    assert counts(image(), rendered) == (0, 0)
    assert np.isnan(agreement(image(), rendered, TOLERANCE).inlier_ratio)
    assert np.isnan(Agreement(0, 0).inlier_ratio)
    assert Agreement(0, 3).inlier_ratio == 0.0
    # Where the view is empty, all returns speak against it.
    frame = image()
    frame[PART] = 5.0
    assert counts(frame, rendered) == (0, 100)


# Among other things.


def among(frame: DepthImage, rendered: RenderedDepth | None = None) -> Agreement:
    """Judged with the parts that the frame itself shows, for a target of 3 m."""
    rendered = view() if rendered is None else rendered
    surroundings = surroundings_of(frame, rendered.camera, 3.0, 0.01)
    return agreement(frame, rendered, TOLERANCE, surroundings)


def before_wall() -> DepthImage:
    """The surface (2.5 m wide) before a wall that fills the image."""
    frame = np.full((SIZE, SIZE), 9.0, dtype=np.float32)
    frame[PART] = 5.0
    return frame


def test_a_wall_behind_the_target_does_not_count() -> None:
    assert agreement(before_wall(), view(), TOLERANCE).conflict == SIZE**2 - 100
    found = among(before_wall())
    assert (found.agree, found.conflict, found.support) == (100, 0, 100)


def test_a_wall_seen_where_a_surface_is_predicted_counts_in_full() -> None:
    frame = before_wall()
    frame[3:13, 8:13] = 9.0
    # But for the column beside what agrees: two of its five columns do, the corners apart.
    found = among(frame)
    assert (found.agree, found.seen_through) == (50, 44)
    assert found.support == 6


def test_what_stands_before_the_target_hides_it_and_no_more() -> None:
    frame = before_wall()
    frame[:, 9:] = 3.0
    found = among(frame)
    # A quarter of a doubt for each pixel hidden, as the view may be sunk into it; but for six in
    # the first column, where two fifths of what is about them agrees.
    assert (found.agree, found.conflict, found.hidden) == (60, 8, 8)
    assert (found.visible_ratio, found.support) == (1.0, 60)
    # With nearly everything hidden, nothing is known.
    frame[:, 4:] = 3.0
    assert among(frame).inlier_ratio < 0.4


def test_a_view_that_slid_along_the_target_is_told_by_the_surface_that_goes_on() -> None:
    """A box on a table, and the same box sunk into it by a third."""
    camera = PinholeCamera(160, 160, 500.0, 500.0, 79.5, 79.5)
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    tilt = exp_rotation(np.array([-np.pi / 2 - 0.6, 0.0, 0.0]))
    upright = make_transform(
        tilt @ exp_rotation(np.array([0.0, 0.0, 0.5])), np.array([0.0, 0.0, 18.0])
    )
    table = trimesh.creation.box((30.0, 30.0, 0.2))
    under = upright @ make_transform(np.eye(3), np.array([0.0, 0.0, -1.1]))
    renderer = DepthRenderer(box, camera)
    target, ground = renderer.render(upright), DepthRenderer(table, camera).render(under)
    frame = np.where(target.depth_m > 0.0, target.depth_m, ground.depth_m)
    surroundings = surroundings_of(frame, camera, 3.5, 0.01)
    right = agreement(frame, target, 0.04, surroundings)
    assert right.inlier_ratio > 0.98
    for down in (0.3, 0.7, 1.2):
        sunk = upright @ make_transform(np.eye(3), np.array([0.0, 0.0, -down]))
        found = agreement(frame, renderer.render(sunk), 0.04, surroundings)
        assert found.inlier_ratio < 0.75
        assert found.support < 0.8 * right.support


def test_what_may_be_the_target_itself_counts_beside_the_view() -> None:
    frame = before_wall()
    frame[3:13, 13:15] = 5.5
    found = among(frame)
    assert (found.agree, found.conflict, found.seen_through) == (100, 20, 0)


def test_false_returns_do_not_count() -> None:
    rng = np.random.default_rng(1)
    frame = image()
    frame[PART] = 5.0
    false = rng.permutation(SIZE**2)[: SIZE**2 // 5]
    frame.ravel()[false] = rng.uniform(20.0, 90.0, len(false))
    found = among(frame)
    assert found.agree == np.count_nonzero(frame == 5.0)
    assert found.conflict == 0
    # Those of the target still say no to a view a metre behind it.
    behind = view()
    behind.depth_m[PART] = 6.0
    assert among(frame, behind).inlier_ratio == 0.0


def test_a_stretch_of_wall_is_no_evidence_of_the_target() -> None:
    wall = np.full((SIZE, SIZE), 5.0, dtype=np.float32)
    small = view((slice(5, 11), slice(5, 11)))
    small.depth_m[:], small.triangle[:] = 0.0, -1
    small.depth_m[5:11, 5:11], small.triangle[5:11, 5:11] = 5.0, 0
    frame = np.full((SIZE, SIZE), 9.0, dtype=np.float32)
    frame[5:11, 5:11] = 5.0
    tolerance = 0.05
    surroundings = surroundings_of(wall, small.camera, 1.5, 0.01)
    found = agreement(wall, small, tolerance, surroundings)
    assert (found.agree, found.conflict) == (0, 36)
    surroundings = surroundings_of(frame, small.camera, 1.5, 0.01)
    found = agreement(frame, small, tolerance, surroundings)
    assert (found.agree, found.conflict) == (36, 0)


def test_what_is_nearer_may_stand_before_the_target_of_which_a_quarter_is_seen() -> None:
    frame = image()
    frame[PART] = 5.0
    frame[3:13, 7:13] = 4.0
    found = agreement(frame, view(), TOLERANCE)
    assert (found.agree, found.hidden, found.conflict) == (40, 60, 60)
    assert (found.inlier_ratio, found.visible_ratio) == (0.4, 1.0)
    frame[3:13, 4:13] = 4.0
    assert agreement(frame, view(), TOLERANCE).visible_ratio == pytest.approx(10 / 70)
    # What is seen through the surface, or beside it, is not excused.
    frame[3:13, 3:8], frame[3:13, 8:13] = 5.0, 7.0
    assert agreement(frame, view(), TOLERANCE).visible_ratio == 0.5


def test_surroundings_are_asked_for_where_a_view_leaves_some_of_a_frame_unexplained() -> None:
    asked: list[int] = []

    def find() -> Surroundings | None:
        asked.append(1)
        return surroundings_of(before_wall(), view().camera, 3.0, 0.01)

    frame = image()
    frame[PART] = 5.0
    frame[0, :9] = 5.0
    found, surroundings = judged(frame, view(), TOLERANCE, find)
    assert (found.agree, found.conflict, surroundings, asked) == (100, 9, None, [])
    found, surroundings = judged(before_wall(), view(), TOLERANCE, find)
    assert (found.conflict, asked) == (0, [1])
    assert surroundings is not None
    # A frame that has no surroundings is judged as it is.
    found, surroundings = judged(frame, view(), 1e-9, lambda: None)
    assert (found.conflict, surroundings) == (9, None)


def test_patches_go_on_across_pixels_that_no_beam_fell_in() -> None:
    rng = np.random.default_rng(7)
    frame = image()
    frame[PART] = 5.0
    frame[3:13, 7:13] = 7.0
    unlooked = rng.uniform(size=frame.shape) < 0.2
    frame[unlooked] = 0.0
    strange = int(np.count_nonzero(frame == 7.0))
    rendered = view()
    rendered.depth_m[unlooked], rendered.triangle[unlooked] = 0.0, -1
    torn = agreement(frame, rendered, TOLERANCE).contradictions
    whole = agreement(frame, rendered, TOLERANCE, unlooked=unlooked).contradictions
    assert torn is not None and whole is not None
    # All of them are another surface, of which few squares of nine are whole.
    assert torn < 0.7 * strange and 0.95 * strange < whole <= strange
    # Lone false returns are no patch, however few pixels were looked at.
    lone = image()
    lone[PART] = 5.0
    lone[4:12:3, 4:12:3] = 7.0
    lone[unlooked] = 0.0
    assert agreement(lone, rendered, TOLERANCE, unlooked=unlooked).contradictions == 0


def test_contradictions_are_patches_of_something_else_and_no_scattered_returns() -> None:
    rng = np.random.default_rng(3)
    frame = image()
    frame[PART] = 5.0
    scattered = frame.copy()
    rows, columns = np.nonzero(frame)
    half = rng.permutation(len(rows))[: len(rows) // 3]
    scattered[rows[half], columns[half]] = rng.uniform(3.0, 8.0, len(half))
    found = agreement(scattered, view(), TOLERANCE)
    assert found.conflict > 25
    assert found.against < 0.5 * found.conflict
    # As many in one piece are another surface.
    patch = frame.copy()
    patch[3:6, 3:13] = 7.0
    found = agreement(patch, view(), TOLERANCE)
    assert (found.agree, found.conflict, found.against) == (70, 30, 30)
    # What is nearer, or does not return, may have reasons.
    patch[3:6, 3:13] = 4.0
    assert agreement(patch, view(), TOLERANCE).against == 8
    patch[3:6, 3:13] = 0.0
    assert agreement(patch, view(), TOLERANCE).against <= 8


def test_what_goes_on_from_the_target_contradicts_it() -> None:
    frame = before_wall()
    frame[3:13, 13:16] = 5.0
    assert among(frame).against >= 30


def test_a_view_sunk_into_a_table_is_contradicted_and_one_behind_a_hand_is_not() -> None:
    """A box that stands on a table, one pushed into it by half, and one half behind a slab."""
    camera = PinholeCamera(160, 160, 500.0, 500.0, 79.5, 79.5)
    box = trimesh.creation.box((2.0, 2.0, 2.0))
    tilt = exp_rotation(np.array([-np.pi / 2 - 0.6, 0.0, 0.0]))
    upright = make_transform(
        tilt @ exp_rotation(np.array([0.0, 0.0, 0.5])), np.array([0.0, 0.0, 18.0])
    )
    table = trimesh.creation.box((30.0, 30.0, 0.2))
    under = upright @ make_transform(np.eye(3), np.array([0.0, 0.0, -1.1]))
    target = DepthRenderer(box, camera).render(upright)
    ground = DepthRenderer(table, camera).render(under)
    frame = np.where(target.depth_m > 0.0, target.depth_m, ground.depth_m)
    surroundings = surroundings_of(frame, camera, 3.5, 0.01)
    long_box = trimesh.creation.box((2.0, 2.0, 3.4))
    long_box.apply_translation((0.0, 0.0, -0.7))
    sunk = agreement(frame, DepthRenderer(long_box, camera).render(upright), 0.04, surroundings)
    right = agreement(frame, target, 0.04, surroundings)
    assert right.against < 0.05 * right.agree
    assert sunk.against > 0.2 * sunk.agree
    hidden = frame.copy()
    hidden[:, :75] = 15.0
    surroundings = surroundings_of(hidden, camera, 3.5, 0.01)
    behind = agreement(hidden, target, 0.04, surroundings)
    assert behind.agree < 0.7 * right.agree
    assert behind.against < 0.08 * behind.agree
