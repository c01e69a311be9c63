"""Another CAD: boxsat is not as its mesh says, beside the same frames of a boxsat that is."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import trimesh

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.core.spatial import exp_rotation
from pcnav.files.text_table import TextTable
from pcnav.simulation.depth import Scene
from pcnav.target.parts import parts_of
from pcnav.target.satellite import Target

from ..following import JudgedRun, follow, status_shares
from ..tables import Claim, table_of
from .tumbles import boxsat, tumble

NAME = "another CAD"
FRAMES = 60
_PANEL, _BUS = "panel_long", "bus"
_RATIO_BAR, _NEES_BAR = 2.0, 2.0
_FOIL_M, _CORRELATION_M, _WAVES, _FOIL_SEED = 0.02, 0.25, 40, 1
_LARGER = 1.01

Reshape = Callable[[Target], trimesh.Trimesh]


@dataclass(frozen=True)
class Difference:
    """What the body has that the mesh has not."""

    reshape: Reshape
    part: str | None = None
    """That has to be named; None where none is wrong."""


def turned(angle_deg: float) -> Reshape:
    """The long panel turned about the middle of its long axis."""

    def reshape(target: Target) -> trimesh.Trimesh:
        panel = next(r for r in target.rectangles if r.name.startswith(_PANEL))
        centre, along = panel.T_model_rect[:3, 3], panel.T_model_rect[:3, 1]
        R = exp_rotation(np.deg2rad(angle_deg) * along)
        vertices = np.array(target.mesh.triangles)
        own = _triangles_of(target, _PANEL)
        vertices[own] = (vertices[own] - centre) @ R.T + centre
        return _mesh(vertices)

    return reshape


def without_panel(target: Target) -> trimesh.Trimesh:
    """The long panel missing."""
    return _mesh(np.array(target.mesh.triangles)[~_triangles_of(target, _PANEL)])


def larger(target: Target) -> trimesh.Trimesh:
    """All of it larger by one per cent."""
    return target.scaled(_LARGER).mesh


def foiled(target: Target) -> trimesh.Trimesh:
    """The bus wrinkled: displaced along its normals by a smooth random field."""
    own = _triangles_of(target, _BUS)
    triangles = np.array(target.mesh.triangles)
    skin = _mesh(triangles[own])
    for _ in range(5):
        skin = skin.subdivide()
    rng = np.random.default_rng(_FOIL_SEED)
    waves = rng.normal(0.0, 1.0 / _CORRELATION_M, (_WAVES, 3))
    phases = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
    height = np.sqrt(2.0 / _WAVES) * np.cos(skin.vertices @ waves.T + phases).sum(axis=1)
    skin.vertices = skin.vertices + _FOIL_M * height[:, None] * skin.vertex_normals
    return _mesh(np.concatenate([np.array(skin.triangles), triangles[~own]]))


DIFFERENCES: Mapping[str, Difference] = {
    "panel turned by 3 degrees": Difference(turned(3.0), _PANEL),
    "panel turned by 10 degrees": Difference(turned(10.0), _PANEL),
    "panel turned by 30 degrees": Difference(turned(30.0), _PANEL),
    "panel missing": Difference(without_panel, _PANEL),
    "foil of 2 cm on the bus": Difference(foiled),
    "1 % larger": Difference(larger),
}
CASES = {name: (name,) for name in DIFFERENCES}
QUICK_CASES = {name: (name,) for name in ("panel turned by 10 degrees",)}
"""One of them, for a look at the machinery."""


@dataclass(frozen=True)
class OtherRun:
    """A run of a body that differs, and one of the same truth and noise that does not."""

    difference: str
    seed: int
    run: JudgedRun
    beside: JudgedRun

    @property
    def late(self) -> BoolArray:
        """(n,) frames of the second half of which both claim a pose."""
        later = np.arange(len(self.run)) >= len(self.run) // 2
        return self.run.claims & self.beside.claims & later

    @property
    def is_named(self) -> bool:
        """Whether just the part that differs was found."""
        part = DIFFERENCES[self.difference].part
        return self.run.changed_parts == (() if part is None else (part,))


OtherRuns = Mapping[str, Sequence[OtherRun]]
"""By difference."""


def run_other(difference: str, seed: int, frames: int = FRAMES) -> OtherRun:
    """One track of a body that differs, with the mesh that is known: truth and noise are the
    seed's."""
    truth, target = tumble(seed, frames), boxsat().target
    shown = DIFFERENCES[difference].reshape(target)
    runs = (follow(Scene.of(truth, mesh), target) for mesh in (shown, target.mesh))
    return OtherRun(difference, seed, *runs)


def ratios(own: Sequence[OtherRun]) -> tuple[float, float]:
    """Position and attitude error, root mean square, over that with the right mesh."""
    return _ratio(own, lambda run: run.position_m), _ratio(own, lambda run: run.attitude_rad)


def mean_nees(own: Sequence[OtherRun]) -> float:
    """Of the pose, over its degrees of freedom, in the later half."""
    return float(np.mean(_late(own, lambda each: each.run.pose_nees / 6.0)))


def tables(found: OtherRuns) -> list[TextTable]:
    """All differences."""
    return [
        table_of(
            "another_cad",
            found.values(),
            {
                "difference": lambda own: own[0].difference,
                "status": lambda own: status_shares([each.run.said for each in own]),
                "runs": len,
                "position, mm": lambda own: 1e3 * _rms(own, lambda each: each.run.position_m),
                "attitude, deg": lambda own: np.rad2deg(
                    _rms(own, lambda each: each.run.attitude_rad)
                ),
                "over right": ratios,
                "pose NEES": mean_nees,
                "named": lambda own: sum(each.is_named for each in own),
            },
            text_columns=2,
        )
    ]


def claims(found: OtherRuns) -> list[Claim]:
    """The rest's pose is nearly as good as with the right mesh, its deviation true, the part
    named."""
    bars = []
    for difference, own in found.items():
        ratio, nees = ratios(own), mean_nees(own)
        named = sum(each.is_named for each in own)
        within = max(ratio) <= _RATIO_BAR
        bars += [
            Claim(NAME, f"{difference}: error over right", f"<= {_RATIO_BAR:g}", ratio, within),
            Claim(NAME, f"{difference}: NEES", f"<= {_NEES_BAR:g}", nees, nees <= _NEES_BAR),
        ]
        if DIFFERENCES[difference].part is not None:
            every = named == len(own)
            bars.append(Claim(NAME, f"{difference}: part named", len(own), named, every))
    return bars


def _late(own: Sequence[OtherRun], of: Callable[[OtherRun], FloatArray]) -> FloatArray:
    values = np.concatenate([of(each)[each.late] for each in own])
    return values if len(values) else np.array([np.nan])


def _rms(own: Sequence[OtherRun], of: Callable[[OtherRun], FloatArray]) -> float:
    return float(np.sqrt(np.mean(_late(own, of) ** 2)))


def _ratio(own: Sequence[OtherRun], of: Callable[[JudgedRun], FloatArray]) -> float:
    return _rms(own, lambda each: of(each.run)) / _rms(own, lambda each: of(each.beside))


def _triangles_of(target: Target, name: str) -> BoolArray:
    """(n_faces,) of the part of a name."""
    parts = parts_of(target)
    place = next(k for k, part in enumerate(parts.each) if part.name == name)
    return np.asarray(parts.of_triangle == place)


def _mesh(triangles: FloatArray) -> trimesh.Trimesh:
    corners = triangles.reshape(-1, 3)
    return trimesh.Trimesh(corners, np.arange(len(corners)).reshape(-1, 3), process=True)
