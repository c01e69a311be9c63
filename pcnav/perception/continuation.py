"""Whether surfaces that fit a view end where the view has them end.

Any flat stretch of a wall or a table fits the face of a box at its depth. What tells the box is its
rim: beyond it one looks past the surface. Where the frame shows the same surface going on, its
returns are no evidence of the target.
"""

import numpy as np
from scipy import ndimage

from pcnav.core.arrays import BoolArray, DepthImage
from pcnav.core.camera import pixel_rays
from pcnav.target.rendering import RenderedDepth

_CLEAR_TOLERANCES = 2.0
"""What touches a surface at right angles differs from it by the tolerance so many of them off."""
_MAX_CLEAR_PX = 12
_RING_PX = 3
_MIN_RING_PIXELS = 12
"""With fewer pixels beyond the rim that tell, nothing is said."""


def continued_share(
    depth_m: DepthImage,
    rendered: RenderedDepth,
    agrees: BoolArray,
    tolerance_m: float,
    space_share: float,
) -> float:
    """Share of the rim, 0 to 1, beyond which the surfaces that agree with a view go on.

    Nothing is said by what is nearer there: it may touch the target or stand before it.

    Args:
        depth_m: (height, width) the frame.
        rendered: the view.
        agrees: (height, width) of its window, pixels at the predicted depth; at least one.
        tolerance_m: depths that differ by less are alike.
        space_share: 0 to 1, how far a missing return is known to be space.
    """
    rows, columns = rendered.window
    camera = rendered.camera
    distance_m = float(np.median(rendered.depth_m[rendered.window][agrees]))
    footprint_m = distance_m / max(camera.fx, camera.fy)
    clear = min(max(int(np.ceil(_CLEAR_TOLERANCES * tolerance_m / footprint_m)), 1), _MAX_CLEAR_PX)
    margin = clear + _RING_PX
    top, left = max(rows.start - margin, 0), max(columns.start - margin, 0)
    bottom = min(rows.stop + margin, camera.height)
    right = min(columns.stop + margin, camera.width)
    part = (slice(top, bottom), slice(left, right))
    inside = np.zeros((bottom - top, right - left), dtype=np.bool_)
    inside[rows.start - top : rows.stop - top, columns.start - left : columns.stop - left] = agrees
    core = _inside_surfaces(rendered, part, inside, clear, tolerance_m)
    if not core.any():
        return 0.0
    distance, nearest = ndimage.distance_transform_edt(~core, return_indices=True)
    ring = (distance > clear) & (distance <= margin) & ~inside
    i, j = nearest[:, ring]
    planes = rendered.inverse_depth_planes[rendered.triangle[part][i, j]]
    with np.errstate(divide="ignore"):
        extended = 1.0 / np.einsum("ij,ij->i", planes, pixel_rays(camera)[part][ring])
    seen = depth_m[part][ring]
    returned = seen > 0.0
    # A plane that the ray meets nowhere before the camera goes on nowhere.
    extended = np.where(extended > 0.0, extended, np.inf)
    continued = np.count_nonzero(returned & (np.abs(seen - extended) < tolerance_m))
    behind = np.count_nonzero(returned & (seen >= extended + tolerance_m))
    behind += round(space_share * np.count_nonzero(~returned))
    told = continued + behind
    return continued / told if told >= _MIN_RING_PIXELS else 0.0


def _inside_surfaces(
    rendered: RenderedDepth,
    part: tuple[slice, slice],
    agrees: BoolArray,
    step: int,
    tolerance_m: float,
) -> BoolArray:
    """(height, width) of a part: pixels that agree with a view as parts of smooth surfaces do.

    Beside a crease of the model a strip of one face may agree with what is another, or with
    something else that runs through there. It does not where the face is continued by its width.
    """
    depth, triangle = rendered.depth_m[part], rendered.triangle[part]
    rays, planes = pixel_rays(rendered.camera)[part], rendered.inverse_depth_planes
    found = agrees.copy()
    for axis in (0, 1):
        beside = np.zeros(agrees.shape, dtype=np.bool_)
        first, second, whole = slice(None, -step), slice(step, None), slice(None)
        pairs = (
            ((first, whole), (second, whole)) if axis == 0 else ((whole, first), (whole, second))
        )
        for here, there in (pairs, pairs[::-1]):
            both = agrees[here] & agrees[there]
            ray = rays[there][both]
            with np.errstate(divide="ignore"):
                extended = 1.0 / np.einsum("ij,ij->i", planes[triangle[here][both]], ray)
            smooth = np.abs(extended - depth[there][both]) < 0.5 * tolerance_m
            beside[here] |= both
            found[here][both] &= smooth
        found &= beside
    return found
