"""The turns that a start has to rule out for any target: those that nearly keep its surface.

`self_matches` finds all of them, in seconds. A start that is to take no longer than a few frames
asks for turns about axes alone: half turns about the principal ones of the surface, whatever they
change, and those twelfths, about these and about the axes of the mesh file (a square body has no
principal ones), that leave the surface where it is on a coarse map. Where just each of them
explains a frame best, the frame says.
"""

import numpy as np
import trimesh

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, rotation_angle, transform_points
from pcnav.target.self_matches import turns_about_point
from pcnav.target.surface_samples import SurfaceSamples, visible_probes

_TURNS = 12
_POINTS = 120
_REACH_FRACTION = 0.1
"""Points further from the surface than this share of the diameter count as so far."""
_NEAR_FRACTION = 0.03
"""Mean distance from the surface, over the diameter, after a turn that is a rival."""
_MAX_RIVALS = 8
_SAME_RAD = 0.2
"""Turns closer than this are one: what is compared with the frame is fitted to it."""


def rival_turns(mesh: trimesh.Trimesh, half_turns: FloatArray) -> FloatArray:
    """(n, 4, 4) motions of the model frame, model to model, that take a mesh nearly onto itself.

    Args:
        mesh: in metres.
        half_turns: (3, 4, 4) about its principal axes; they come first.
    """
    samples, probes = SurfaceSamples(mesh), visible_probes(mesh)
    angles = 2.0 * np.pi * np.arange(1, _TURNS) / _TURNS
    axes = np.vstack([probes.axes.T, np.eye(3)])
    R = np.stack([exp_rotation(angle * axis) for axis in axes for angle in angles])
    turns = turns_about_point(probes.centre, R)
    moved = transform_points(turns, probes.some(_POINTS))
    apart = np.linalg.norm(moved - samples.nearest(moved), axis=-1)
    away = np.minimum(apart / samples.diameter_m, _REACH_FRACTION).mean(axis=1)
    kept = list(half_turns)
    for k in np.argsort(away, kind="stable")[: np.count_nonzero(away < _NEAR_FRACTION)].tolist():
        apart_rad = rotation_angle(np.stack(kept)[:, :3, :3] @ R[k].T)
        if np.min(apart_rad) > _SAME_RAD and len(kept) < len(half_turns) + _MAX_RIVALS:
            kept.append(turns[k])
    return np.stack(kept)
