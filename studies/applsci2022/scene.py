"""The nutating satellite: its true rotation, points on its hull, their tracks and drawings."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import make_transform
from pcnav.dynamics.blocks import POSE_LAYOUT
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.tracks import MonocularTracks
from pcnav.report.figures import LINE, new_figure, style_axes
from pcnav.simulation.images import ImageMotion, TrackFaults, monocular_tracks
from pcnav.simulation.motion import rotate_torque_free

from ..folder import StudyFigure
from . import paper

POINT_COLOUR = "#ca8a04"
"""Colour of a point."""
_SUN = (0.0, 0.0, -1.0)


@dataclass(frozen=True)
class Truth:
    """The motion behind the tracks; camera and world axes are the same."""

    times_s: FloatArray
    """(n,)"""
    R_world_body: FloatArray
    """(n, 3, 3), I at the start."""
    omega_body: FloatArray
    """(n, 3) rad/s."""
    points: FloatArray
    """(N, 3) body axes from the mass centre, m."""
    normals: FloatArray
    """(N, 3) outward."""

    @property
    def motion(self) -> ImageMotion:
        """For a camera at rest that looks along z."""
        n = len(self.times_s)
        T = make_transform(self.R_world_body, np.tile(paper.PLACE_M, (n, 1)))
        poses = Trajectory(self.times_s, POSE_LAYOUT, T_cam_target=T)
        return ImageMotion(poses, np.tile(np.eye(3), (n, 1, 1)), np.array(_SUN))


def nutation(duration_s: float, interval_s: float, seed: int, points: int = paper.POINTS) -> Truth:
    """The printed motion, with points drawn evenly over the hull."""
    times_s = paper.frame_times(duration_s, interval_s)
    rate = np.radians(paper.RATE_DEG_S)
    R, omega = rotate_torque_free(np.eye(3), rate, paper.INERTIA_KG_M2, times_s)
    places, normals = hull_points(points, np.random.default_rng(seed))
    return Truth(times_s, R, omega, places, normals)


def hull_points(count: int, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Places and outward normals (count, 3), body axes, on the box of the printed inertia."""
    half, R_body_hull = paper.hull_half_sides_m()
    area = np.prod(half) / half
    face = rng.choice(3, count, p=area / area.sum())
    side = rng.choice([-1.0, 1.0], count)
    places, normals = rng.uniform(-1.0, 1.0, (count, 3)) * half, np.zeros((count, 3))
    rows = np.arange(count)
    places[rows, face], normals[rows, face] = side * half[face], side
    return places @ R_body_hull.T, normals @ R_body_hull.T


def tracks_of(truth: Truth, faults: TrackFaults, seed: int) -> MonocularTracks:
    """What the paper's camera sees."""
    rng = np.random.default_rng([seed, 1])
    points = (truth.points, truth.normals)
    return monocular_tracks(paper.CAMERA, truth.motion, points, faults, rng)


def path_figure(truth: Truth) -> StudyFigure:
    """Fig. 6: the paths of the points in space."""
    figure = new_figure(3.2)
    p = truth.points[:12] @ np.swapaxes(truth.R_world_body, 1, 2)
    for axes, (i, j) in zip(figure.subplots(1, 2), ((0, 1), (0, 2)), strict=True):
        _draw(axes, np.swapaxes(p[..., [i, j]], 0, 1), (f"{'xyz'[i]}, m", f"{'xyz'[j]}, m"))
        axes.set_aspect("equal", adjustable="datalim")
    return StudyFigure("fig_6", figure)


def track_figure(tracks: MonocularTracks) -> StudyFigure:
    """Fig. 7: the paths of the points in the image."""
    by_feature: dict[int, list[FloatArray]] = {}
    for frame in tracks.frames:
        for feature, pixels in zip(frame.features.tolist(), frame.pixels, strict=True):
            by_feature.setdefault(feature, []).append(pixels)
    paths = [np.array(path) for path in by_feature.values()]
    figure = new_figure(4.2)
    axes = figure.add_subplot()
    _draw(axes, paths, ("u, px", "v, px"))
    middle = np.array([paper.CAMERA.cx, paper.CAMERA.cy])
    half = 1.1 * float(np.abs(np.concatenate(paths) - middle).max())
    axes.set_xlim(middle[0] - half, middle[0] + half)
    # Image rows count downwards.
    axes.set_ylim(middle[1] + half, middle[1] - half)
    axes.set_aspect("equal")
    return StudyFigure("fig_7", figure)


def _draw(axes: Axes, paths: Sequence[FloatArray] | FloatArray, labels: tuple[str, str]) -> None:
    """Paths (n, 2), each with a dot at its end."""
    style_axes(axes)
    for path in paths:
        axes.plot(path[:, 0], path[:, 1], color=LINE, linewidth=0.8)
        axes.plot(path[-1, 0], path[-1, 1], "o", color=POINT_COLOUR, markersize=3)
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
