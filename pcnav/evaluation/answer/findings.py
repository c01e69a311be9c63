"""The quantities of a final estimate, whatever blocks its state has."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import xyzw_from_rotation
from pcnav.dynamics.blocks import (
    ATTITUDE,
    CENTRE,
    POSITION,
    RATE,
    RATIOS,
    VELOCITY,
    Block,
    Layout,
)
from pcnav.evaluation.answer.derived import (
    Kind,
    Values,
    derived,
    momentum_direction,
    principal_axis,
    principal_moments,
)
from pcnav.evaluation.answer.model import Finding, Verdict
from pcnav.evaluation.answer.sources import MAX_ANGLE_SD_RAD, MAX_RATIO_SD, Sources

_TO_DEG = 180.0 / np.pi
_ORDINALS = ("largest", "middle", "smallest")
_KEYS = {
    VELOCITY: "velocity_hill_m_s",
    RATE: "rate_body_deg_s",
    CENTRE: "mass_centre_model_m",
    RATIOS: "inertia_ratios",
}
_FRAMES = {
    VELOCITY: "hill: of the mass centre, as seen in the turning frame",
    RATE: "body: inertial",
    CENTRE: "model",
    RATIOS: "body: entries of the inertia matrix over Ixx",
}


@dataclass(frozen=True)
class Found:
    """One estimate of a run."""

    values: Values
    layout: Layout
    """The blocks with deviations."""
    sources: Sources
    T_cam_target: FloatArray | None = None
    """(4, 4)"""
    R_hill_world: FloatArray | None = None
    """(3, 3) at its time; None where there is no Hill frame."""
    budget: Mapping[str, FloatArray] = field(default_factory=dict)
    """(n, n) parts of the covariance, by what makes them."""

    def has(self, *blocks: Block) -> bool:
        """Whether all of these are estimated, with deviations."""
        return all(block in self.layout for block in blocks)


def findings(found: Found) -> dict[str, Finding]:
    """By name, in the order in which they are told."""
    told: dict[str, Finding] = {}
    if found.T_cam_target is not None:
        told |= _pose(found, found.T_cam_target)
    elif found.has(ATTITUDE):
        told["attitude_world_xyzw"] = _attitude(found, found.values[ATTITUDE.name], "world")
    for block in (RATE, VELOCITY):
        told |= _block(found, block)
    turns = RATE.name in found.values and bool(np.any(found.values[RATE.name]))
    if turns:
        told["rate_magnitude_deg_s"] = _rate_magnitude(found)
    if turns and found.has(ATTITUDE, RATE, RATIOS):
        told["momentum_direction_world"] = _direction(
            found, momentum_direction, Kind.DIRECTION, "direction of momentum", "world"
        )
    for block in (CENTRE, RATIOS):
        told |= _block(found, block)
    if found.has(RATIOS):
        told["principal_moments"] = _principal_moments(found)
        for k, ordinal in enumerate(_ORDINALS):
            title = f"principal axis, {ordinal} moment"
            told[f"principal_axis_{k + 1}_body"] = _direction(
                found, principal_axis(k), Kind.AXIS, title, "body"
            )
    return told


def _pose(found: Found, T_cam_target: FloatArray) -> dict[str, Finding]:
    origin = "origin of the model" if CENTRE.name in found.values else "mass centre"
    p_cam = T_cam_target[:3, 3]
    if not found.layout.blocks:
        origin = "origin of the target"
    told = {}
    if found.has(POSITION):
        told["range_m"] = _vector(
            found,
            lambda values: np.linalg.norm(values[POSITION.name], axis=0, keepdims=True),
            ("range to the mass centre", "from the chaser's mass centre", "m", ("range",)),
        )
    else:
        title = f"range to the {origin}"
        distance = np.linalg.norm(p_cam, axis=0, keepdims=True)
        told["range_m"] = _bare(found, (title, "from the camera", "m", ("range",)), distance)
    name = (origin, "cam: x right, y down, z forward", "m", ("x", "y", "z"))
    if found.has(POSITION, ATTITUDE) and found.R_hill_world is not None:
        position = _vector(found, _position_cam(found, T_cam_target), name)
        # Of a frame that was shown again it is the frame's own.
        told["position_cam_m"] = position.model_copy(update={"value": _floats(p_cam)})
    else:
        told["position_cam_m"] = _bare(found, name, p_cam)
    told["attitude_cam_xyzw"] = _attitude(found, T_cam_target[:3, :3], "cam")
    return told


def _position_cam(found: Found, T_cam_target: FloatArray) -> Callable[[Values], FloatArray]:
    assert found.R_hill_world is not None
    R_world_hill = found.R_hill_world.T
    R_cam_world = T_cam_target[:3, :3] @ found.values[ATTITUDE.name].T

    def of(values: Values) -> FloatArray:
        p_world = R_world_hill @ values[POSITION.name]
        if CENTRE.name in values:
            p_world = p_world - values[ATTITUDE.name] @ values[CENTRE.name]
        return np.asarray(R_cam_world @ p_world)

    return of


def _attitude(found: Found, R: FloatArray, frame: str) -> Finding:
    """As a quaternion, with deviations about the axes of the body."""
    axes = f"R_{frame}_body as a quaternion, scalar last"
    name = ("attitude of the target", axes, "1", ATTITUDE.columns)
    bare = _bare(found, name, xyzw_from_rotation(R))
    if not found.has(ATTITUDE):
        return bare
    rows = np.eye(found.layout.size)[found.layout.slice_of(ATTITUDE)]
    verdicts = tuple(found.sources.verdict(row, MAX_ANGLE_SD_RAD) for row in rows)
    stated = {"sd_unit": "deg", "sd": _sds(found, rows, _TO_DEG), "verdicts": verdicts}
    return bare.model_copy(update={**stated, "budget": _budget(found, rows, _TO_DEG)})


def _block(found: Found, block: Block) -> dict[str, Finding]:
    if block.name not in found.values:
        return {}
    name = (block.title, _FRAMES[block], block.shown_unit, block.components)
    scale = block.to_shown
    if block not in found.layout:
        return {_KEYS[block]: _bare(found, name, scale * found.values[block.name])}
    max_sd = MAX_RATIO_SD if block is RATIOS else np.inf
    return {
        _KEYS[block]: _vector(
            found, lambda values: scale * values[block.name], name, max_sd=scale * max_sd
        )
    }


def _rate_magnitude(found: Found) -> Finding:
    name = ("magnitude of the angular rate", "inertial", "deg/s", ("rate",))

    def of(values: Values) -> FloatArray:
        return np.asarray(np.linalg.norm(_TO_DEG * values[RATE.name], axis=0, keepdims=True))

    return _vector(found, of, name) if found.has(RATE) else _bare(found, name, of(found.values))


def _principal_moments(found: Found) -> Finding:
    name = ("principal moments over the largest", "body", "1", ("middle", "smallest"))
    return _vector(found, principal_moments, name, max_sd=MAX_RATIO_SD)


def _direction(
    found: Found, of: Callable[[Values], FloatArray], kind: Kind, title: str, frame: str
) -> Finding:
    at = derived(of, kind, found.values, found.layout)
    P = found.sources.covariance
    assert P is not None, "a layout has a covariance"
    variances, axes = np.linalg.eigh(at.jacobian @ P @ at.jacobian.T)
    weights = at.jacobian.T @ axes[:, -1]
    sd = min(float(np.sqrt(max(variances[-1], 0.0))), np.pi / 2.0)
    return Finding(
        title=title,
        frame=frame,
        unit="1",
        components=("x", "y", "z"),
        value=_floats(at.value),
        sd_unit="deg",
        sd=(sd * _TO_DEG,),
        verdicts=(found.sources.verdict(weights, MAX_ANGLE_SD_RAD),),
        budget=_budget(found, weights[None], _TO_DEG),
    )


_Name = tuple[str, str, str, tuple[str, ...]]
"""Title, frame, unit and components."""


def _vector(
    found: Found, of: Callable[[Values], FloatArray], name: _Name, *, max_sd: float = np.inf
) -> Finding:
    at = derived(of, Kind.VECTOR, found.values, found.layout)
    title, frame, unit, components = name
    return Finding(
        title=title,
        frame=frame,
        unit=unit,
        components=components,
        value=_floats(at.value),
        sd_unit=unit,
        sd=_sds(found, at.jacobian),
        verdicts=tuple(found.sources.verdict(row, max_sd) for row in at.jacobian),
        budget=_budget(found, at.jacobian),
    )


def _bare(found: Found, name: _Name, value: FloatArray) -> Finding:
    """Of what has no deviations."""
    title, frame, unit, components = name
    verdict = Verdict.DATA if found.sources.is_claimed else Verdict.NOT
    return Finding(
        title=title,
        frame=frame,
        unit=unit,
        components=components,
        value=_floats(value),
        sd_unit=unit,
        sd=None,
        verdicts=(verdict,),
    )


def _sds(found: Found, rows: FloatArray, scale: float = 1.0) -> tuple[float, ...] | None:
    P = found.sources.covariance
    return None if P is None else _deviations(P, rows, scale)


def _budget(
    found: Found, rows: FloatArray, scale: float = 1.0
) -> dict[str, tuple[float, ...]] | None:
    parts = {name: _deviations(part, rows, scale) for name, part in found.budget.items()}
    return {name: sd for name, sd in parts.items() if any(sd)} or None


def _deviations(P: FloatArray, rows: FloatArray, scale: float) -> tuple[float, ...]:
    variances = np.einsum("ij,jk,ik->i", rows, P, rows)
    return _floats(scale * np.sqrt(np.maximum(variances, 0.0)))


def _floats(values: FloatArray) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
