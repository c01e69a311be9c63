"""How well a rendered view explains a frame, pixel by pixel."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from pcnav.core.arrays import BoolArray, DepthImage
from pcnav.perception.continuation import continued_share
from pcnav.perception.surroundings import Surroundings
from pcnav.target.rendering import RenderedDepth

_EMPTY_SHARE = 0.35
"""A pixel with fewer returns about it than this looks into space; lone gaps are dropouts. Where a
frame holds other things, one with fewer at the predicted depth about it looks past the surface."""
_ABOUT_PX = 5
_ALONE_RATIO = 0.9
"""A view that explains so much of all that returned has nothing else about it that matters."""
_REACH = 0.6
"""What lies no farther than this share of the diameter from the middle of a view may be the
target's."""
_IN_FRONT = 0.25
"""Weight of a pixel hidden by what cannot be the target: it may as well stand before it as the view
be sunk into it."""
_EXCUSED = 0.25
"""Weight, against the target's being there at all, of what it may be hidden by, and of a return
that is missing: surfaces that are dark or slanted do not return."""
_SUNK_TOLERANCES, _SUNK_PX = 3.0, 2
"""What begins to hide a view no nearer than so many tolerances before it, so many pixels beside
what agrees, does not stand before it: the view is sunk into it ..."""
_SUNK_FOOTPRINTS = 3.0
"""... or than the side of so many pixels, by which a surface rises that meets it at 45 degrees."""
_CLAIMED = 0.1
"""A small part of which a view explains this share is the target's or nothing is."""
_MOST_OF_SQUARE = 6
"""Pixels of nine that a square has at least for a patch, where beams did not fall in the others: as
many as a pattern without rows and columns leaves, or more, in nine squares of ten."""
_MAX_UNTOLD = 0.02
"""So few conflicts, over what agrees, are not worth sorting."""
_MAX_HIDDEN = 3
"""With more than so many times as many pixels hidden as agree, a view is not seen."""


@dataclass(frozen=True)
class Agreement:
    """Pixels that speak for and against a view."""

    agree: int
    """Returns at the predicted depth."""
    conflict: int
    """Returns at another depth or where space is predicted, and space where a surface is: those
    that can be the target's, where the frame holds other things, too."""
    hidden: int = 0
    """Of the conflicts, returns before a predicted surface: something else may stand there."""
    seen_through: int = 0
    """Of the conflicts, what no other return makes good: something farther, or space, where a
    surface is predicted."""
    contradictions: int | None = None
    """Of the conflicts, in terms of pixels, those that false and lost returns, ragged rims and what
    stands before the target do not explain: whole patches of something else. None where they were
    not told apart."""
    may_lack_a_part: bool = False
    """Whether what contradicts it may be one body of several, turned or missing: of a target that
    is alone in the frame."""

    @property
    def against(self) -> int:
        """Pixels that say that it is not the target that is seen."""
        return self.conflict if self.contradictions is None else self.contradictions

    @property
    def inlier_ratio(self) -> float:
        """Share of them that speak for it, 0 to 1; nan when the frame is silent."""
        either = self.agree + self.conflict
        return self.agree / either if either else float("nan")

    @property
    def visible_ratio(self) -> float:
        """The same, if whatever is nearer than the view stands before it and no more is hidden by
        it than three times what is seen."""
        against = self.conflict - min(self.hidden, _MAX_HIDDEN * self.agree)
        either = self.agree + against
        return self.agree / either if either else float("nan")

    @property
    def support(self) -> int:
        """What tells views of one frame apart: a return that a view leaves unexplained is as
        unlikely under all of them, so each explains as much more as it has returns at its depth,
        less what is seen through it."""
        return self.agree - self.seen_through


def agreement(
    depth_m: DepthImage,
    rendered: RenderedDepth,
    tolerance_m: float,
    surroundings: Surroundings | None = None,
    unlooked: BoolArray | None = None,
) -> Agreement:
    """Compare a frame with a view; depths that differ by less than the tolerance agree.

    Space counts as much as returns: a return seen through a predicted surface, and none where one
    is predicted, both say no. A gap between returns is a dropout and says nothing.

    ``surroundings``: the parts of the frame, where it holds more than the target can fill. What is
    larger than the target then counts against a view only where it is seen through it, and for it
    only where it does not go on beyond it. ``unlooked`` (height, width): pixels that no beam of a
    scan fell in; patches go on across them.
    """
    if surroundings is not None:
        return _among_others(depth_m, rendered, tolerance_m, surroundings, unlooked)
    part = rendered.window
    returned = depth_m > 0.0
    seen, predicted = depth_m[part], rendered.depth_m[part]
    seen_here, surface = returned[part], rendered.triangle[part] >= 0
    close = np.abs(seen - predicted) < tolerance_m
    agree = int(np.count_nonzero(surface & seen_here & close))
    gaps = surface & ~seen_here
    empty = int(np.count_nonzero(gaps & _sparse(seen_here))) if gaps.any() else 0
    nearer = surface & seen_here & (seen <= predicted - tolerance_m)
    hidden = int(np.count_nonzero(nearer))
    conflict = int(np.count_nonzero(returned)) - agree + empty
    against = conflict
    if conflict > _MAX_UNTOLD * agree:
        strange = returned.copy()
        strange[part] &= ~(surface & close)
        patches = _in_patches(strange, unlooked)
        excused = int(np.count_nonzero(patches[part] & nearer)) + empty
        against = int(np.count_nonzero(patches)) + empty - round((1.0 - _EXCUSED) * excused)
    return Agreement(agree, conflict, hidden, empty, against)


def judged(
    depth_m: DepthImage,
    rendered: RenderedDepth,
    tolerance_m: float,
    surroundings: Callable[[], Surroundings | None],
    unlooked: BoolArray | None = None,
) -> tuple[Agreement, Surroundings | None]:
    """How far a view explains a frame, and the surroundings that were needed to say so.

    A view that explains nearly all of the frame needs none. ``unlooked``: see `agreement`.
    """
    alone = agreement(depth_m, rendered, tolerance_m, unlooked=unlooked)
    if alone.inlier_ratio >= _ALONE_RATIO:
        return alone, None
    found = surroundings()
    if found is None:
        return alone, None
    return _among_others(depth_m, rendered, tolerance_m, found, unlooked), found


def _among_others(
    depth_m: DepthImage,
    rendered: RenderedDepth,
    tolerance_m: float,
    surroundings: Surroundings,
    unlooked: BoolArray | None = None,
) -> Agreement:
    part = rendered.window
    seen, predicted = depth_m[part], rendered.depth_m[part]
    returned, surface = seen > 0.0, rendered.triangle[part] >= 0
    agrees = surface & returned & (np.abs(seen - predicted) < tolerance_m)
    agree = int(np.count_nonzero(agrees))
    if agree == 0:
        # Nothing speaks for the view, whatever may hide it.
        return Agreement(0, int(np.count_nonzero(surface)))
    about = _neighbourhood(rendered, surroundings.diameter_m)
    outside = rendered.triangle[about] < 0
    space_share = float(np.mean(depth_m[about][outside] <= 0.0)) if outside.any() else 0.0
    past = surface & ~agrees & _sparse(agrees)
    # Lone returns are false ones.
    joined = surroundings.labels[part] > 0
    farther = int(np.count_nonzero(past & joined & (seen > predicted)))
    missing = round(space_share * np.count_nonzero(past & ~returned))
    through = farther + missing
    candidates = surroundings.candidates_where(agrees, part)
    nearer = past & returned & (seen < predicted)
    foreign = int(np.count_nonzero(nearer & ~candidates[part]))
    sunk = 0
    if foreign > _MAX_UNTOLD * agree:
        beside_it = ndimage.binary_dilation(agrees, iterations=_SUNK_PX)
        begins = nearer & ~candidates[part] & beside_it
        footprint_m = predicted[begins] / max(rendered.camera.fx, rendered.camera.fy)
        reach_m = _SUNK_TOLERANCES * tolerance_m + _SUNK_FOOTPRINTS * footprint_m
        near = predicted[begins] - seen[begins] < reach_m
        # Noise has a few of the returns of what stands before it near, too.
        sunk = foreign if 2 * np.count_nonzero(near) > near.size else 0
    hidden = int(np.count_nonzero(nearer & candidates[part]))
    beside = candidates[about] & outside & _at_its_depth(depth_m[about], rendered, surroundings)
    going_on = round(agree * continued_share(depth_m, rendered, agrees, tolerance_m, space_share))
    hidden += round(_IN_FRONT * foreign)
    conflict = through + hidden + int(np.count_nonzero(beside)) + going_on
    # Other small things may lie beside the target; of one thing it is not a part.
    parts = surroundings.labels
    sizes = np.maximum(surroundings.sizes, 1)
    own = np.bincount(parts[part][agrees], minlength=len(sizes)) > _CLAIMED * sizes
    between = None if unlooked is None else unlooked[about]
    rest = int(np.count_nonzero(_in_patches(beside & own[parts[about]], between)))
    against = farther + rest + going_on + sunk + round(_EXCUSED * (missing + hidden))
    return Agreement(agree - going_on, conflict, hidden, through, against)


def _neighbourhood(rendered: RenderedDepth, diameter_m: float) -> tuple[slice, slice]:
    """Rows and columns in which the target may be, wherever in the view it is turned to."""
    camera = rendered.camera
    nearest_m = float(
        rendered.depth_m[rendered.window][rendered.triangle[rendered.window] >= 0].min()
    )
    reach = _REACH * diameter_m * max(camera.fx, camera.fy) / nearest_m
    found = []
    for span, size in zip(rendered.window, rendered.depth_m.shape, strict=True):
        middle, half = 0.5 * (span.start + span.stop), max(reach, 0.5 * (span.stop - span.start))
        found.append(slice(max(int(middle - half), 0), min(int(np.ceil(middle + half)), size)))
    return found[0], found[1]


def _at_its_depth(
    seen: DepthImage, rendered: RenderedDepth, surroundings: Surroundings
) -> BoolArray:
    predicted = rendered.depth_m[rendered.window][rendered.triangle[rendered.window] >= 0]
    low, high = float(predicted.min()), float(predicted.max())
    slack = max(_REACH * surroundings.diameter_m - 0.5 * (high - low), 0.0)
    return np.asarray((seen > low - slack) & (seen < high + slack))


def _sparse(mask: BoolArray) -> BoolArray:
    """Pixels with few of a kind about them."""
    about = ndimage.uniform_filter(mask.astype(np.float32), _ABOUT_PX, mode="constant")
    return np.asarray(about < _EMPTY_SHARE)


def _in_patches(mask: BoolArray, unlooked: BoolArray | None = None) -> BoolArray:
    """The pixels of a mask (height, width) that lie in squares of three by three of it; where
    nobody looked at all pixels of a square, of those that are known, if they are most of it."""
    if unlooked is None or not unlooked.any():
        return _in_squares(mask, mask)
    about = ndimage.uniform_filter(mask.astype(np.float32), 3, mode="constant")
    # By the middle of a square.
    most = np.asarray(about > (_MOST_OF_SQUARE - 0.5) / 9.0)
    return _in_squares(mask | unlooked, most) & mask


def _in_squares(mask: BoolArray, middle: BoolArray) -> BoolArray:
    """Pixels (height, width) of the squares of three by three of a mask whose middles may be so."""
    whole = np.zeros_like(mask)
    if min(mask.shape) < 3:
        return whole
    rows = mask[:-2] & mask[1:-1] & mask[2:]
    middles = rows[:, :-2] & rows[:, 1:-1] & rows[:, 2:] & middle[1:-1, 1:-1]
    wide = np.zeros((middles.shape[0], mask.shape[1]), dtype=np.bool_)
    for shift in range(3):
        wide[:, shift : shift + middles.shape[1]] |= middles
    for shift in range(3):
        whole[shift : shift + middles.shape[0]] |= wide
    return whole
