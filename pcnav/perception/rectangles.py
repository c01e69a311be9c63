"""Rectangles from the eigen-decomposition of the distribution matrix (Yu 2019, 2.2-2.3).

Two sets of statistics share this code. `paper` takes plain means of the measured points. The
default, `area_weighted`, first slides every point along its ray onto the fitted plane, which takes
the range noise out of the in-plane coordinates, and weighs it with the area of the face its pixel
covers, because a camera samples the near end of an oblique face more densely than the far end.
"""

from dataclasses import dataclass

import numpy as np

from pcnav.config.depth import PerceptionMode
from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.camera import PinholeCamera, ray_steps
from pcnav.core.spatial import make_transform
from pcnav.perception.edges import moment_covariance
from pcnav.perception.planes import PlaneFit, plane_range
from pcnav.perception.returns import Window
from pcnav.perception.segmentation import Segment

_MAX_CUT = 0.02
"""Share of the outline that may be hidden before the face counts as cut: a mast or a wire."""
_MIN_CUT_PX = 3
_MIN_GAP = 1e-3
"""Relative gap of the eigenvalues below which a face is a square: yaw is lost, not infinite."""
X, Y, Z, TILT_X, TILT_Y, YAW, LENGTH, WIDTH, AREA = range(9)
"""Order of the errors in `RectangleObservation.covariance`."""


@dataclass(frozen=True)
class Moments:
    """Centroid and distribution matrix of a set of points, and its eigen-decomposition."""

    centroid: FloatArray
    """(3,) r_m of Yu 2019 (3), m."""
    R_cam_rect: FloatArray
    """(3, 3) columns: short side, long side, normal facing the sensor; right-handed."""
    eigenvalues: FloatArray
    """(3,) along those axes: middle, largest, smallest, m^2."""


@dataclass(frozen=True)
class RectangleObservation:
    """A flat segment read as a rectangle, not yet recognised."""

    T_cam_rect: FloatArray
    """(4, 4) rectangle frame: x short, y long, z normal to the sensor; up to the ambiguity."""
    length_m: float
    """Long side."""
    width_m: float
    """Short side."""
    area_m2: float
    """Area covered; nan where points carry no area (bare clouds)."""
    covariance: FloatArray
    """(9, 9) of x, y, z (m), rotation about x, y, z (rad) in rectangle axes, length, width (m),
    area (m^2)."""
    cut_sides: tuple[bool, bool, bool, bool]
    """Whether something hides part of the side at -x, +x, -y, +y."""
    rim_m: float
    """How wide a rim beside the face could be without being distinguished from it: it would be no
    wider than a pixel or no deeper than the noise; one standard deviation."""

    @property
    def is_cut(self) -> bool:
        """Whether the whole face is not seen: then only its plane can be trusted."""
        return any(self.cut_sides)


def distribution(points: FloatArray, weights: FloatArray | None = None) -> Moments:
    """Centroid (3), distribution matrix (4), eigen-decomposition (5) of points (n, 3) in `cam`.

    The eigenvectors are ordered short, long, normal, with the normal turned to the sensor and the
    frame made right-handed: an eigenvector matrix as it comes may be a reflection.
    """
    w = np.full(len(points), 1.0 / len(points)) if weights is None else weights / weights.sum()
    centroid = w @ points
    offset = points - centroid
    eigenvalues, vectors = np.linalg.eigh((offset * w[:, None]).T @ offset)
    normal = vectors[:, 0] * (-1.0 if vectors[:, 0] @ centroid > 0.0 else 1.0)
    long_axis = vectors[:, 2]
    R = np.column_stack([np.cross(long_axis, normal), long_axis, normal])
    return Moments(centroid, R, eigenvalues[[1, 2, 0]])


def side_lengths(
    moments: Moments, noise_covariance: FloatArray, footprint_covariance: FloatArray | None = None
) -> tuple[float, float]:
    """Long and short side, m, from the eigenvalues: ``lambda = a^2 / 12 + sigma^2`` (Yu 2019 (17)).

    Args:
        moments: of the segment.
        noise_covariance: (3, 3) mean covariance of the points' errors, taken out.
        footprint_covariance: (3, 3) mean second moment of a pixel's own footprint on the face,
            put back: pixel centres spread less than the face they stand for.
    """
    excess = (
        noise_covariance
        if footprint_covariance is None
        else noise_covariance - footprint_covariance
    )
    along = np.einsum("ik,ij,jk->k", moments.R_cam_rect, excess, moments.R_cam_rect)
    width, length = np.sqrt(12.0 * np.maximum(moments.eigenvalues - along, 0.0))[:2]
    return float(length), float(width)


@dataclass(frozen=True)
class SegmentShape:
    """The moments of a segment and the rectangle that has them."""

    moments: Moments
    length_m: float
    width_m: float
    area_m2: float
    points: FloatArray
    """(n, 3) what the moments were taken of, camera frame, m."""
    weights: FloatArray | None
    """(n,) area of the face under each point up to a factor; None for plain means."""

    @property
    def T_cam_rect(self) -> FloatArray:
        """(4, 4) rectangle frame, up to the ambiguity."""
        return make_transform(self.moments.R_cam_rect, self.moments.centroid)


def shape_of_segment(
    camera: PinholeCamera, window: Window, segment: Segment, sigma_m: float, mode: PerceptionMode
) -> SegmentShape:
    """The shape of a segment of a depth frame, measured in the way of a mode."""
    rays = window.rays[segment.pixels]
    distance = plane_range(segment.fit.m, rays)
    # range^2 / cos(incidence) is range^3 up to the factor |m|.
    weights = distance**3 * window.solid_angle[segment.pixels]
    area_m2 = float(np.linalg.norm(segment.fit.m) * weights.sum())
    if mode is PerceptionMode.PAPER:
        measured = window.range_m[segment.pixels] > 0.0
        rays = rays[measured]
        points = rays * window.range_m[segment.pixels[measured], None]
        moments = distribution(points)
        noise = sigma_m**2 * (rays.T @ rays) / len(rays)
        return SegmentShape(moments, *side_lengths(moments, noise), area_m2, points, None)
    points = rays * distance[:, None]
    moments = distribution(points, weights)
    footprint = _mean_footprint(camera, segment.fit, points, weights)
    sides = side_lengths(moments, np.zeros((3, 3)), footprint)
    return SegmentShape(moments, *sides, area_m2, points, weights)


def observe_segment(
    camera: PinholeCamera, window: Window, segment: Segment, sigma_m: float, mode: PerceptionMode
) -> RectangleObservation:
    """Read a segment of a depth frame as a rectangle."""
    shape = shape_of_segment(camera, window, segment, sigma_m, mode)
    if shape.weights is None:
        covariance = random_sampling_covariance(shape.moments, len(shape.points))
    else:
        covariance = _area_weighted_covariance(camera, segment.fit, shape, shape.weights)
    return RectangleObservation(
        T_cam_rect=shape.T_cam_rect,
        length_m=shape.length_m,
        width_m=shape.width_m,
        area_m2=shape.area_m2,
        covariance=covariance,
        cut_sides=_cut_sides(window, segment, shape),
        rim_m=_rim(camera, shape.moments.centroid, sigma_m),
    )


def observe_cloud(
    points: FloatArray, noise_covariance: FloatArray, *, evenly_spread: bool = False
) -> RectangleObservation:
    """Read a bare cloud (n, 3) that lies on one rectangle, as Yu 2019 does.

    Args:
        points: camera frame, m.
        noise_covariance: (3, 3) of each point's error, m^2.
        evenly_spread: the points cover the face evenly (a grid), so only their noise makes the
            moments uncertain; otherwise they are independent uniform draws.
    """
    moments = distribution(points)
    length, width = side_lengths(moments, noise_covariance)
    if evenly_spread:
        covariance = even_sampling_covariance(moments, noise_covariance, len(points))
    else:
        covariance = random_sampling_covariance(moments, len(points))
    return RectangleObservation(
        T_cam_rect=make_transform(moments.R_cam_rect, moments.centroid),
        length_m=length,
        width_m=width,
        area_m2=float("nan"),
        covariance=covariance,
        cut_sides=(False, False, False, False),
        rim_m=0.0,
    )


def random_sampling_covariance(moments: Moments, n: int) -> FloatArray:
    """(9, 9) covariance of what plain means give for n independent uniform draws on a rectangle.

    Centroid: ``lambda / n``. Rotation about the axis across i and j: ``lambda_i lambda_j /
    (n (lambda_i - lambda_j)^2)``, the first-order perturbation of the eigenvectors. Sides: the
    sample variance of a uniform law has variance ``0.8 lambda^2 / n``.
    """
    spread = np.maximum(moments.eigenvalues, 1e-18)
    x, y, z = spread
    return _sampling_covariance(spread, spread, (y * z, x * z, x * y), (2.4 * y, 2.4 * x), n)


def even_sampling_covariance(moments: Moments, noise_covariance: FloatArray, n: int) -> FloatArray:
    """(9, 9) covariance for n points that cover the face evenly: only their noise is left.

    Rotation across i and j: the noise of the cross moment, ``(sigma_i^2 lambda_j + sigma_j^2
    lambda_i) / n``, over the squared gap of the eigenvalues.
    """
    spread = np.maximum(moments.eigenvalues, 1e-18)
    x, y, z = spread
    noise = np.einsum("ik,ij,jk->k", moments.R_cam_rect, noise_covariance, moments.R_cam_rect)
    sx, sy, sz = noise
    cross = (sy * z + sz * y, sx * z + sz * x, sx * y + sy * x)
    # d(side) = 6 d(lambda) / side, and lambda's noise is 2 sqrt(lambda) sigma / sqrt(n).
    return _sampling_covariance(spread, noise, cross, (12.0 * sy, 12.0 * sx), n)


def _sampling_covariance(
    spread: FloatArray,
    centroid: FloatArray,
    cross: tuple[float, float, float],
    sides: tuple[float, float],
    n: int,
) -> FloatArray:
    """(9, 9) of n points: variances of one point's part in centroid, cross moments and sides."""
    x, y, z = spread
    gaps = np.array([y - z, x - z, max(y - x, 1e-9 * y)])
    return np.diag([*(centroid / n), *(np.array(cross) / (n * gaps**2)), *(np.array(sides) / n), 0])


def _mean_footprint(
    camera: PinholeCamera, fit: PlaneFit, points: FloatArray, weights: FloatArray
) -> FloatArray:
    """(3, 3) weighted mean second moment of the pixels' footprints on the plane, m^2.

    Where the next pixel's ray differs by d, the point where it meets the plane differs by
    ``z (d - ray (n . d) / (n . ray))``; a square pixel of side 1 has second moment 1 / 12.
    """
    ray = points / points[:, 2:]
    incidence = ray @ fit.m
    steps = ray_steps(camera, ray)
    total = np.zeros((3, 3))
    for axis, focal in ((0, camera.fx), (1, camera.fy)):
        step = -ray * (steps[:, axis] @ fit.m[:2] / incidence)[:, None]
        step[:, :2] += steps[:, axis]
        step *= points[:, 2:] / focal
        total += (step * weights[:, None]).T @ step
    return np.asarray(total / (12.0 * weights.sum()))


def _area_weighted_covariance(
    camera: PinholeCamera, fit: PlaneFit, shape: SegmentShape, weights: FloatArray
) -> FloatArray:
    """(9, 9) covariance from the two things that go wrong: the plane's fit, the sides' pixels."""
    by_plane = _by_plane(fit, shape.moments, shape.points, weights)
    length, width = max(shape.length_m, 1e-6), max(shape.width_m, 1e-6)
    sides = moment_covariance(camera, shape.T_cam_rect, width, length)
    by_sides = _by_moments(shape.moments, length, width)
    return np.asarray(by_plane @ fit.covariance @ by_plane.T + by_sides @ sides @ by_sides.T)


def _by_plane(
    fit: PlaneFit, moments: Moments, points: FloatArray, weights: FloatArray
) -> FloatArray:
    """(9, 3) derivative of the observation by the plane m.

    With range ``r = 1 / (m . u)``: a point moves by ``-r^2 u (u . dm)`` and its weight by the
    relative ``-3 r (u . dm) + m . dm / |m|^2``. Sums over the points of the moved and reweighted
    moments give the rest; the normal is ``-m / |m|``.
    """
    R = moments.R_cam_rect
    distance = np.linalg.norm(points, axis=1)
    rays = points / distance[:, None]
    q = (points - moments.centroid) @ R
    moved = -(distance**2)[:, None] * (rays @ R)  # per unit of (u . dm), rectangle axes
    reweighted = -3.0 * distance
    mean = rays * (weights / weights.sum())[:, None]
    jacobian = np.zeros((9, 3))
    for axis in (X, Y, Z):
        jacobian[axis] = (moved[:, axis] + q[:, axis] * reweighted) @ mean
    norm = np.linalg.norm(fit.m)
    tilt = -R.T / norm  # derivative of the normal in rectangle axes; its z part is not a rotation
    jacobian[TILT_X], jacobian[TILT_Y] = -tilt[1], tilt[0]
    x, y = q[:, 0], q[:, 1]
    lx, ly = moments.eigenvalues[:2]
    cross = (moved[:, 0] * y + moved[:, 1] * x + x * y * reweighted) @ mean
    jacobian[YAW] = cross / min(lx - ly, -_MIN_GAP * ly)
    by_ly = (2.0 * y * moved[:, 1] + (y * y - ly) * reweighted) @ mean
    by_lx = (2.0 * x * moved[:, 0] + (x * x - lx) * reweighted) @ mean
    jacobian[LENGTH], jacobian[WIDTH] = by_ly * np.sqrt(3.0 / ly), by_lx * np.sqrt(3.0 / lx)
    area = 12.0 * np.sqrt(lx * ly)
    jacobian[AREA] = area * (reweighted @ mean + fit.m / norm**2)
    return jacobian


def _by_moments(moments: Moments, length: float, width: float) -> FloatArray:
    """(9, 6) derivative of the observation by relative errors of moments 1, x, y, xx, yy, xy."""
    lx, ly = moments.eigenvalues[:2]
    jacobian = np.zeros((9, 6))
    jacobian[X, 1] = jacobian[Y, 2] = 1.0
    # First-order perturbation of the eigenvectors: those of a square are not determined.
    jacobian[YAW, 5] = 1.0 / min(lx - ly, -_MIN_GAP * ly)
    jacobian[LENGTH, 4], jacobian[LENGTH, 0] = 6.0 / length, -6.0 / length * ly
    jacobian[WIDTH, 3], jacobian[WIDTH, 0] = 6.0 / width, -6.0 / width * lx
    jacobian[AREA, 0] = length * width
    return jacobian


def _rim(camera: PinholeCamera, centroid: FloatArray, sigma_m: float) -> float:
    """One pixel across, or two standard deviations deep, whichever is more."""
    return float(max(centroid[2] / min(camera.fx, camera.fy), 2.0 * sigma_m))


def _cut_sides(
    window: Window, segment: Segment, shape: SegmentShape
) -> tuple[bool, bool, bool, bool]:
    """Which sides (-x, +x, -y, +y) the hidden part of the outline lies at."""
    hidden = len(segment.cut_pixels)
    if hidden < max(_MIN_CUT_PX, _MAX_CUT * segment.n_outline) or shape.width_m <= 0.0:
        return (False, False, False, False)
    rays = window.rays[segment.cut_pixels]
    points = rays * plane_range(segment.fit.m, rays)[:, None]
    in_plane = (points - shape.moments.centroid) @ shape.moments.R_cam_rect[:, :2]
    q = in_plane / [shape.width_m, shape.length_m]
    across = np.abs(q[:, 0]) > np.abs(q[:, 1])
    at: list[BoolArray] = [
        across & (q[:, 0] < 0),
        across & (q[:, 0] >= 0),
        ~across & (q[:, 1] < 0),
        ~across & (q[:, 1] >= 0),
    ]
    return (bool(at[0].any()), bool(at[1].any()), bool(at[2].any()), bool(at[3].any()))
