"""Frames with a mask: what it left out is told from what it should have kept."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from pcnav.core.arrays import BoolArray, DepthImage
from pcnav.core.camera import PinholeCamera
from pcnav.core.spatial import make_transform
from pcnav.perception.unseen import Unseen
from pcnav.recordings.region import Region, restricted
from pcnav.recordings.sequence import Frame
from pcnav.target.rendering import DepthRenderer, RenderedDepth

CAMERA = PinholeCamera.from_field_of_view(120, 90, 0.3)
SHEET = trimesh.creation.box((2.0, 1.2, 0.1))
T = make_transform(np.eye(3), np.array([0.0, 0.0, 12.0]))
TOLERANCE_M = 0.05


@pytest.fixture(scope="module")
def rendered() -> RenderedDepth:
    return DepthRenderer(SHEET, CAMERA).render(T)


def left_out(depth_m: DepthImage, mask: BoolArray, rendered: RenderedDepth) -> BoolArray:
    """Pixels that say nothing of the view, of a frame restricted to a mask."""
    frame = Frame(0, 0.0, depth_m.astype(np.float32), CAMERA, np.eye(4))
    unseen = Unseen.of(restricted(frame, Region(mask=mask)))
    assert unseen is not None
    return unseen.beside(rendered, TOLERANCE_M)


def before_a_wall(rendered: RenderedDepth) -> DepthImage:
    return np.where(rendered.depth_m > 0.0, rendered.depth_m, np.float32(14.0))


def test_a_mask_that_is_right_leaves_nothing_untold(rendered: RenderedDepth) -> None:
    surface = rendered.triangle >= 0
    assert not left_out(before_a_wall(rendered), surface, rendered).any()


def test_of_what_a_late_mask_lost_nothing_is_known(rendered: RenderedDepth) -> None:
    """The target has moved by a third of its width since the mask was made."""
    surface = rendered.triangle >= 0
    late = np.roll(surface, surface.any(axis=0).sum() // 3, axis=1)
    found = left_out(before_a_wall(rendered), late, rendered)
    np.testing.assert_array_equal(found, surface & ~late)


def test_what_stands_before_the_target_hides_it_and_its_rim(rendered: RenderedDepth) -> None:
    """Where a hand ends the mask, no edge of the target is seen; elsewhere its edges are."""
    surface, depth_m = rendered.triangle >= 0, before_a_wall(rendered)
    hand = np.zeros_like(surface)
    hand[40:, 50:70] = True
    depth_m[hand] = 11.0
    found = left_out(depth_m, surface & ~hand, rendered)
    assert found[surface & hand].all()
    below = found[np.flatnonzero(surface.any(axis=1))[-1] + 1]
    assert below[50:70].all() and not below[:45].any()
    assert not found[surface & ~hand].any()


def test_a_view_that_reaches_beyond_the_mask_by_a_pixel_is_contradicted(
    rendered: RenderedDepth,
) -> None:
    """A table touches the target at its depth: the mask tells where it ends."""
    surface = rendered.triangle >= 0
    standing = np.where(surface, rendered.depth_m, np.float32(12.0))
    higher = surface & np.roll(surface, -1, axis=0)
    assert not left_out(standing, higher, rendered).any()


def test_a_frame_seen_on_fewer_pixels_says_the_same(rendered: RenderedDepth) -> None:
    surface = rendered.triangle >= 0
    late = np.roll(surface, surface.any(axis=0).sum() // 3, axis=1)
    frame = Frame(0, 0.0, before_a_wall(rendered), CAMERA, np.eye(4))
    frame = restricted(replace(frame, unseen=None), Region(mask=late))
    coarse = frame.strided(2)
    unseen, of_coarse = Unseen.of(frame), Unseen.of(coarse)
    assert unseen is not None and of_coarse is not None
    view = DepthRenderer(SHEET, coarse.camera).render(T)
    by_frame = of_coarse.beside(view, TOLERANCE_M)
    assert by_frame.any()
    np.testing.assert_array_equal(unseen.strided(2).beside(view, TOLERANCE_M), by_frame)
