"""What the ranges along the rays of a frame tell of a pose at best: by geometry alone.

No pixel is left out, at creases and at grazing incidence neither, as `perception` has reasons to:
there a hundredth of a pixel, or a wrinkle, is worth more than the noise. So this is a bound for a
camera and a mesh that are exact, and rays as thin as those of the simulator.
"""

import numpy as np

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.camera import pixel_rays, range_per_depth
from pcnav.target.rendering import RenderedDepth


def ray_information(
    rendered: RenderedDepth, T_cam_model: FloatArray, returned: BoolArray, sigma_m: float
) -> FloatArray:
    """(6, 6) inverse covariance of a pose's error by independent ranges on the planes of a view.

    Args:
        rendered: the view at the true pose.
        T_cam_model: (4, 4) that pose.
        returned: (height, width) pixels with a range.
        sigma_m: deviation of each, along its ray.

    The error is (6,): translation of the model origin (m, camera axes), then rotation (rad, model
    axes). A plane ``n . p = c`` that is moved by d at the point p changes the range along the ray u
    by ``n . d / (n . u)``; ``d = t + (R theta) x (p - o)`` about the model origin o.
    """
    window, camera = rendered.window, rendered.camera
    seen = (rendered.triangle[window] >= 0) & returned[window]
    rays = pixel_rays(camera)[window][seen] / range_per_depth(camera)[window][seen][:, None]
    # m . u = 1 / range on a plane, so that m times the range is n / (n . u).
    planes = rendered.inverse_depth_planes[rendered.triangle[window][seen]]
    range_m = 1.0 / np.einsum("ij,ij->i", planes, rays)
    along = planes * range_m[:, None]
    lever = np.cross(rays * range_m[:, None] - T_cam_model[:3, 3], along)
    jacobian = np.hstack([along, lever @ T_cam_model[:3, :3]]) / sigma_m
    return np.asarray(jacobian.T @ jacobian)
