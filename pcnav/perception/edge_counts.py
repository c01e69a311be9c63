"""Pixels counted across predicted edges: how far each edge is displaced where it crosses a line.

Where an edge crosses a pixel column (or row), the pixels beside the crossing should show the part
it bounds on one side and what lies behind on the other. Each pixel on the wrong side is one pixel
of displacement there.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from pcnav.core.arrays import BoolArray, DepthImage, FloatArray, IntArray
from pcnav.core.camera import PinholeCamera, pixel_rays
from pcnav.perception.edge_crossings import EdgeCrossings
from pcnav.perception.edge_gaps import edge_gaps
from pcnav.perception.pose_doubt import GATE_SIGMA, PoseDoubt
from pcnav.target.rendering import RenderedDepth

_NEAR_FRACTION = 0.01
"""The pixel beside an edge shows the part it bounds when their depths differ by less than this
share of the diameter: rims thinner than a pixel lie between them."""
_APART = 1.25
"""Two surfaces are distinguished where they differ by this many times the sum of their
tolerances."""
_MAX_UNKNOWN = 0.5
"""With more than this share of unusable pixels beside an edge it says nothing."""
_ABOUT_CROSSINGS = 5
_MAX_UNMODELLED = 0.5
"""Where more of the crossings about one than this show neither the part nor what lies behind it,
something that is not of the model hides the edge. Lone ones are outliers."""
OFFSET_PX = 0.1
"""How far beside the predicted edges pixels are counted."""
_GRAZED_SD_PX = 0.5
"""How well the far edge of a face is told that is seen at grazing incidence, where what returns
from a pixel may be of that face or of the one beside it."""


@dataclass(frozen=True)
class EdgeCounts:
    """What was counted at n crossings."""

    usable: BoolArray
    displacement_px: FloatArray
    """(n,) outward."""
    extra_variance: FloatArray
    """(n,) beyond that of the pixel grid, px^2; where a surface lies behind the edge, of each pixel
    that is displaced."""
    kind: IntArray
    """(n,) 0 where space lies behind the edge, 1 where another surface does."""
    triangle: IntArray
    """(n,) of the mesh, seen beside the edge."""
    shift_px: FloatArray
    """(n,) how far outward of the predicted edge pixels were counted."""
    common_px2: FloatArray
    """(n,) variance of an error that the crossings of an edge share, px^2."""
    gap_px: FloatArray
    """(n,) how much of that it is inward by is a gap longer than was counted."""


def count_offsets(n: int, T_cam_model: FloatArray) -> FloatArray:
    """(n,) how far outward of each predicted edge pixels are counted, plus or minus `OFFSET_PX`.

    Counted at the predicted edge itself, a good prediction sees no displaced pixel in most frames,
    and how good it is would have to be known to say what that means: a filter that thinks too well
    of itself is never put right. Counted a known step away, the counts tell the same displacement
    with noise that does not depend on the prediction. The signs are drawn from the pose, so that a
    comparison can be repeated, and each pass of a fit has others: with the same ones, fits settle
    where these counts happen to agree (of real frames about a stated first pose, five of six then
    came to nothing).
    """
    seed = np.frombuffer(np.ascontiguousarray(T_cam_model).tobytes(), dtype=np.uint32)
    signs = np.random.default_rng(seed).integers(0, 2, n)
    return np.asarray(OFFSET_PX * (2.0 * signs - 1.0), dtype=np.float64)


@dataclass(frozen=True)
class _Strips:
    """The pixels across the edge at each crossing.

    First those counted on the side of the part, from the edge on, and one more, which tells what
    should be there: the line counted at is not where the view has its edge. Then likewise beyond.
    """

    u: IntArray
    """(n, 2 reach + 2)"""
    v: IntArray
    inside: BoolArray
    """(n,) whether all are in the image."""
    first_inwards: IntArray
    """(n,) the first pixel inside the edge, along what is crossed."""

    @property
    def reach(self) -> int:
        """How many are counted on each side."""
        return int(self.u.shape[1]) // 2 - 1

    @property
    def counted(self) -> "_Strips":
        """The pixels (n, 2 reach) that are counted."""
        reach = self.reach
        counted = np.r_[0:reach, reach + 1 : 2 * reach + 1]
        return _Strips(self.u[:, counted], self.v[:, counted], self.inside, self.first_inwards)


def _strips(
    crossings: EdgeCrossings, shift_px: FloatArray, reach: int, camera: PinholeCamera
) -> _Strips:
    below = np.floor(crossings.minor - crossings.side * shift_px).astype(np.intp)
    nearest = np.where(crossings.side > 0, below + 1, below)
    steps = np.arange(reach + 1)
    near = nearest[:, None] + crossings.side[:, None] * steps
    far = nearest[:, None] - crossings.side[:, None] * (steps + 1)
    minor = np.hstack([near, far])
    size = np.where(crossings.upright, camera.width, camera.height)
    inside = np.asarray(((minor >= 0) & (minor < size[:, None])).all(axis=1))
    u, v = crossings.across(np.clip(minor, 0, size[:, None] - 1))
    return _Strips(u, v, inside, near[:, 0])


@dataclass(frozen=True)
class _Sides:
    """What a view has on both sides of each crossing."""

    usable: BoolArray
    """(n,) whether it is simple enough to be counted."""
    triangle: IntArray
    """(n,) of the part that the edge bounds."""
    space: BoolArray
    """(n,) whether nothing lies behind the edge."""
    before_space: BoolArray
    """(n,) whether nothing is there in all of the strip beyond it."""
    stepped: BoolArray
    """(n,) whether the face that ends there is seen at grazing incidence, with another beside it at
    once: whatever lies between the two is the part then."""
    part_m: FloatArray
    """(n, k) z-depth of the part, extended to each counted pixel."""
    part_tolerance_m: FloatArray
    """(n, 1) within which returns belong to it."""
    behind_m: FloatArray
    """(n, k) of what lies behind."""
    behind_tolerance_m: FloatArray


def _sides(
    crossings: EdgeCrossings,
    strips: _Strips,
    rendered: RenderedDepth,
    doubt: PoseDoubt,
    diameter_m: float,
    among_others: bool,
) -> _Sides:
    u, v, reach, rays = strips.u, strips.v, strips.reach, pixel_rays(rendered.camera)
    triangle = rendered.triangle[v, u]
    near_triangle, far_triangle = triangle[:, reach], triangle[:, -1]
    near_plane, far_plane = (
        rendered.planes_at(seen, (v[:, k], u[:, k]))
        for seen, k in ((near_triangle, reach), (far_triangle, -1))
    )
    edge_z = crossings.p_cam[:, 2]
    edge_rays = crossings.p_cam / edge_z[:, None]
    beside_z = _depths(near_plane, edge_rays[:, None])[:, 0]
    space = far_triangle < 0
    last_ray = rays[v[:, -1:], u[:, -1:]]
    far_z = np.where(space, edge_z, _depths(far_plane, last_ray)[:, 0])
    gap = np.where(space, np.inf, far_z - edge_z)
    allowed = np.minimum(_NEAR_FRACTION * diameter_m, 0.25 * gap)
    plain = (near_triangle >= 0) & (np.abs(beside_z - edge_z) < allowed)
    beyond = np.ones_like(plain)
    if reach > 1:
        # The strip must be plain: the part on one side, one surface or space on the other.
        near = v[:, 1:reach], u[:, 1:reach]
        predicted = _depths(near_plane, rays[near])
        plain &= (np.abs(rendered.depth_m[near] - predicted) < allowed[:, None]).all(axis=1)
        beyond = (triangle[:, reach + 2 :] == far_triangle[:, None]).all(axis=1)
    # The far edge of a face seen at grazing incidence has another face beside it at once. Among
    # other things, where the near edges may touch some of them, it is often all that is left.
    stepped = ~plain & space & (triangle[:, 1 : reach + 1] >= 0).all(axis=1)
    stepped &= among_others
    counted = strips.counted
    counted_rays = rays[counted.v, counted.u]
    # Displaced, the edge shows the rim that lies between it and the pixel beside it.
    half_rim = 0.5 * np.clip(edge_z - beside_z, -allowed, allowed)[:, None]
    part_tolerance = doubt.tolerance(near_plane, crossings.p_cam)[:, None] + np.abs(half_rim)
    sides = _Sides(
        usable=strips.inside & beyond & (plain | stepped),
        triangle=near_triangle,
        space=space,
        before_space=strips.inside & beyond & space & (near_triangle >= 0),
        stepped=stepped,
        part_m=_depths(near_plane, counted_rays) + half_rim,
        part_tolerance_m=part_tolerance,
        behind_m=_depths(far_plane, counted_rays),
        behind_tolerance_m=doubt.tolerance(far_plane, last_ray[:, 0] * far_z[:, None])[:, None],
    )
    deep_z = np.where(stepped, rendered.depth_m[v[:, reach], u[:, reach]], edge_z)
    return _with_steps(sides, edge_z[:, None], deep_z[:, None], doubt)


def _with_steps(sides: _Sides, edge_z: FloatArray, deep_z: FloatArray, doubt: PoseDoubt) -> _Sides:
    """Where faces are grazed, all between the edge and what lies beside it (n, 1) is the part."""
    stepped, half_step = sides.stepped[:, None], 0.5 * np.abs(edge_z - deep_z)
    tolerance = half_step + GATE_SIGMA * doubt.sigma_m
    return replace(
        sides,
        part_m=np.where(stepped, 0.5 * (edge_z + deep_z), sides.part_m),
        part_tolerance_m=np.where(stepped, tolerance, sides.part_tolerance_m),
    )


def edge_counts(
    crossings: EdgeCrossings,
    shift_px: FloatArray,
    depth_m: DepthImage,
    rendered: RenderedDepth,
    reach: int,
    doubt: PoseDoubt,
    dropout: float,
    diameter_m: float,
    among_others: bool,
) -> EdgeCounts:
    """Count the displaced pixels of a frame.

    Args:
        crossings: n of them.
        shift_px: (n,) how far outward of the predicted edge to count.
        depth_m: (height, width) the frame.
        rendered: the view.
        reach: how many pixels to look at on each side.
        doubt: about the pose of the view.
        dropout: share of the returns that are lost at random.
        diameter_m: of the target.
        among_others: whether the frame shows other things beside the target.
    """
    strips = _strips(crossings, shift_px, reach, rendered.camera)
    sides = _sides(crossings, strips, rendered, doubt, diameter_m, among_others)
    counted, space, usable = strips.counted, sides.space, sides.usable
    seen = depth_m[counted.v, counted.u].astype(np.float64)
    returned = seen > 0.0
    is_part = returned & (np.abs(seen - sides.part_m) < sides.part_tolerance_m)
    is_behind = returned & (np.abs(seen - sides.behind_m) < sides.behind_tolerance_m)
    # Extended beyond the edge, a steep part may come near what lies behind.
    tolerances = sides.part_tolerance_m + sides.behind_tolerance_m
    usable = usable & (space | (sides.behind_m - sides.part_m > _APART * tolerances).all(axis=1))
    unmodelled = (returned & ~is_part & (space[:, None] | ~is_behind)).any(axis=1)
    usable &= uniform_filter1d(unmodelled.astype(np.float64), _ABOUT_CROSSINGS) < _MAX_UNMODELLED
    grown = is_part[:, reach:].sum(axis=1).astype(np.float64)
    lost = (~returned[:, :reach]).sum(axis=1) - dropout * reach
    # Of whatever part: where nothing of it is seen, it need not be plain.
    missing = sides.before_space & ~returned[:, 0]
    gaps = edge_gaps(
        *(crossings, strips.first_inwards, depth_m, rendered, missing, usable, reach, dropout)
    )
    has_gap = gaps.length_px > 0.0
    lost, usable = np.where(has_gap, gaps.length_px, lost), (usable | has_gap) & ~gaps.is_cut
    covered = is_behind[:, :reach].sum(axis=1)
    known = (is_part | is_behind).mean(axis=1)
    surfaces = usable & ~space
    unknown = 1.0 - float(known[surfaces].mean()) if surfaces.any() else 1.0
    if unknown > _MAX_UNKNOWN:
        usable &= space
    unknown = min(unknown, _MAX_UNKNOWN)
    return EdgeCounts(
        usable=usable,
        displacement_px=shift_px
        + np.where(space, (grown - lost) / (1.0 - dropout), (grown - covered) / (1.0 - unknown)),
        # Which pixels are lost is chance: of those looked at on the part that stands before space,
        # of those displaced before another surface.
        extra_variance=np.where(
            space, reach * dropout / (1.0 - dropout), unknown / (1.0 - unknown)
        ),
        kind=(~space).astype(np.intp),
        triangle=sides.triangle,
        shift_px=shift_px,
        common_px2=np.where(sides.stepped, _GRAZED_SD_PX**2, 0.0),
        gap_px=np.where(gaps.length_px > reach, gaps.length_px, 0.0),
    )


def _depths(planes: FloatArray, rays: FloatArray) -> FloatArray:
    """(n, k) z-depth where rays (n, k, 3) meet planes (n, 3); infinite where they never do."""
    with np.errstate(divide="ignore"):
        return np.asarray(1.0 / np.einsum("ij,ikj->ik", planes, rays))
