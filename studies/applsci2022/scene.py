"""The nutating satellite: its true rotation, points on its hull and their tracks."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import make_transform
from pcnav.dynamics.blocks import POSE_LAYOUT
from pcnav.dynamics.trajectory import Trajectory
from pcnav.recordings.tracks import MonocularTracks
from pcnav.simulation.images import ImageMotion, TrackFaults, monocular_tracks
from pcnav.simulation.motion import rotate_torque_free

from . import paper

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
