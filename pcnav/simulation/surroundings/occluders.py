"""What stands before a simulated target: a hand that holds it, a robot arm, a part of the servicer.

Hand and beam are pushed over the target until they cover the share asked for.
"""

from collections.abc import Callable, Mapping
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh

from pcnav.config.surroundings import OccluderKind, OccluderTable
from pcnav.core.arrays import FloatArray
from pcnav.core.camera import PinholeCamera
from pcnav.core.errors import InputError
from pcnav.core.spatial import exp_rotation, make_transform, transform_points
from pcnav.simulation.surroundings.part import Part, Stage, ball, box, joined, rod
from pcnav.target.rendering import DepthRenderer

_RADIUS_DIAMETERS = 0.06
_STEPS, _BISECTIONS = 31, 10
_SHARE_TOLERANCE = 0.02
_FAR = 8.0
"""Length of forearm and beam in diameters of the target: they reach out of the image."""
_SWING_RAD = float(np.deg2rad(50.0))
"""On either side of the target's place, between which the arm swings."""


def occluders(
    table: OccluderTable,
    stage: Stage,
    camera: PinholeCamera,
    rng: np.random.Generator,
    source: Path | str = "pipeline",
) -> list[Part]:
    """The parts of an occluder; none where there is none.

    Raises `InputError`, which names the source, for a share that cannot be covered.
    """
    if table.kind is OccluderKind.NONE:
        return []
    if table.kind is OccluderKind.ARM:
        return [_arm(table, stage, rng)]
    angle = rng.uniform(0.0, 2.0 * np.pi)
    mesh = _SHAPED[table.kind](table, stage)
    # Given as if it came from the image's right.
    turned = exp_rotation(np.array([0.0, 0.0, angle]))
    nearest, middle = _nearest_m(stage), stage.middle_cam
    held = table.kind is OccluderKind.HAND
    # The hand touches the target's nearest point; the servicer's part is halfway to it.
    depth = nearest - float(mesh.bounds[1, 2]) if held else 0.5 * nearest
    # A point nearer to the camera lies on the ray to the target's middle.
    mesh.apply_transform(make_transform(turned, middle * depth / middle[2]))
    towards = turned @ np.array([-1.0, 0.0, 0.0])
    shift = _covering(mesh, towards, stage, camera, table.share_fraction, source)
    mesh.apply_translation(shift)
    if held:
        return [Part(mesh, stage.with_target() if table.turns else stage.with_middle())]
    return [Part(mesh, np.broadcast_to(np.eye(4), stage.T_cam_model.shape))]


def _nearest_m(stage: Stage) -> float:
    """Depth of the target's nearest vertex in the first frame."""
    p_cam = transform_points(stage.T_cam_model[0], np.asarray(stage.mesh.vertices))
    return float(p_cam[:, 2].min())


def _radius(table: OccluderTable, stage: Stage) -> float:
    return _RADIUS_DIAMETERS * stage.diameter_m if table.radius_m is None else table.radius_m


def _hand(_: OccluderTable, stage: Stage) -> trimesh.Trimesh:
    """Fingers towards -x, the forearm towards +x, the palm's side at +z; tips at the origin."""
    size = 0.5 * stage.diameter_m
    thick = 0.09 * size

    def at(x: float, y: float, z: float = 0.0) -> FloatArray:
        return size * np.array([x, y, z])

    fingers = [
        # Length, place across the palm, spread of the tip.
        *((0.85, -0.36, -0.46), (1.0, -0.12, -0.15)),
        *((0.95, 0.12, 0.15), (0.75, 0.36, 0.44)),
    ]
    shapes = []
    for length, across, tip in fingers:
        root, knuckle = at(1.0, across), at(1.0 - 0.55 * length, 0.5 * (across + tip), -0.1)
        shapes += [rod(root, knuckle, thick), rod(knuckle, at(1.0 - length, tip), 0.9 * thick)]
    palm = trimesh.creation.icosphere(3, 1.0)
    palm.apply_transform(np.diag([0.55 * size, 0.5 * size, 0.16 * size, 1.0]))
    palm.apply_translation(at(1.4, 0.0))
    thumb = [rod(at(1.5, 0.45), at(0.95, 0.85), 1.1 * thick)]
    thumb += [rod(at(0.95, 0.85), at(0.55, 0.8), thick)]
    forearm = rod(at(1.8, 0.0), at(1.8 + 2.0 * _FAR, 0.0, -0.8), 0.3 * size)
    return joined([*shapes, palm, *thumb, forearm])


def _beam(table: OccluderTable, stage: Stage) -> trimesh.Trimesh:
    """A square bar along x with a round tip at the origin."""
    radius, length = _radius(table, stage), _FAR * stage.diameter_m
    bar = box(
        np.array([length, 4.0 * radius, 2.0 * radius]),
        make_transform(np.eye(3), np.array([0.5 * length, 0.0, 0.0])),
    )
    cross = rod(np.array([0.0, -2.0 * radius, 0.0]), np.array([0.0, 2.0 * radius, 0.0]), radius)
    return joined([bar, cross])


def _covering(
    mesh: trimesh.Trimesh,
    towards: FloatArray,
    stage: Stage,
    camera: PinholeCamera,
    share: float,
    source: Path | str,
) -> FloatArray:
    """(3,) shift along a direction by which a mesh covers a share of the target's pixels."""
    T = stage.T_cam_model[0]
    seen = DepthRenderer(stage.mesh, camera).render(T).depth_m > 0.0
    renderer, out = DepthRenderer(mesh, camera), 1.5 * stage.diameter_m
    if not seen.any():
        return -out * towards

    def covered(shift: float) -> float:
        before = renderer.render(make_transform(np.eye(3), shift * towards)).depth_m > 0.0
        return float(np.count_nonzero(before & seen) / np.count_nonzero(seen))

    # What goes too far covers less again: the first place counts.
    tried = np.linspace(-out, out, _STEPS)
    enough = next((k for k, shift in enumerate(tried) if covered(shift) >= share), _STEPS - 1)
    low, high = float(tried[max(enough - 1, 0)]), float(tried[enough])
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if covered(middle) < share else (low, middle)
    found = covered(high)
    if abs(found - share) > _SHARE_TOLERANCE:
        most = max(covered(shift) for shift in tried)
        expected = f"expected a share that it can cover of this target, at most {most:.2f}"
        raise InputError(source, "occluder.share_fraction", f"{expected}, got {share:g}")
    return high * towards


def _arm(table: OccluderTable, stage: Stage, rng: np.random.Generator) -> Part:
    """Three rods with joints, which swing about a shoulder outside of the view."""
    radius, size = _radius(table, stage), stage.diameter_m
    middle, nearest = stage.middle_cam, _nearest_m(stage)
    depth = nearest - 0.25 * size - 2.0 * radius
    place = middle * depth / middle[2]
    # Given along +x from the shoulder; the hand reaches beyond the target's place.
    joints = size * np.array(
        [[0.0, 0.0, 0.0], [1.6, 0.25, -0.2], [2.9, -0.15, 0.0], [4.0, 0.1, -0.1]]
    )
    shapes = [rod(a, b, radius) for a, b in pairwise(joints)]
    shapes += [ball(joint, 1.5 * radius) for joint in joints[1:]]
    mesh = joined(shapes)
    angle = rng.uniform(0.0, 2.0 * np.pi)
    inward = exp_rotation(np.array([0.0, 0.0, angle]))
    shoulder = place - inward @ np.array([3.0 * size, 0.0, 0.0])
    span = table.end_s - table.start_s
    share = (stage.time_s - table.start_s) / span
    turn = np.zeros((len(share), 3))
    turn[:, 2] = _SWING_RAD * (2.0 * share - 1.0)
    T = make_transform(inward @ exp_rotation(turn), shoulder)
    T[(share < 0.0) | (share > 1.0)] = np.nan
    return Part(mesh, T)


_SHAPED: Mapping[OccluderKind, Callable[[OccluderTable, Stage], trimesh.Trimesh]] = {
    OccluderKind.HAND: _hand,
    OccluderKind.BEAM: _beam,
}
