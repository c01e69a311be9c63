"""What a shape says of the mass within it: nothing of its density, so any that it can hold.

A mesh shows where mass can be, not where it is: tanks, batteries and empty panels look alike. So
densities are drawn, each a mixture of

- a share that is spread evenly over the whole shape, and one over its solid part,
- lumps in places of their own,

with all weights uniform on their simplex, and mass centre and inertia are those of the mixtures.
Half of the inertias are those of any body at all, whatever the shape: the principal axes point
anywhere, and their shares in the second moments are uniform on their simplex. Lumps seldom leave
the shape's own axes; a real satellite's harness and fuel do.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import trimesh
from scipy import ndimage
from scipy.spatial.transform import Rotation

from pcnav.core.arrays import BoolArray, FloatArray
from pcnav.dynamics.inertia_parameters import parameters_of, ratios_from_parameters
from pcnav.dynamics.mass_prior import MassBelief

_CELLS = 32
"""Along the longest side: what is thinner than a cell is a panel, a boom or a skin."""
_SURFACE_POINTS = 40_000
"""Enough that no cell of a closed surface is left out, and a fill would leak through it."""
_DENSITIES, _LUMPS = 4000, 4
_SOLID_LUMPS = 0.8
"""Share of the lumps that lie in the solid part: equipment is rather in a bus than in a panel."""
_SEED = 1
_STEPS = 0.7548776662466927, 0.5698402909980532
"""Of the additive recurrence that fills a square most evenly (Roberts 2018, R2)."""


def unknown_density(mesh: trimesh.Trimesh) -> MassBelief:
    """Mass centre and inertia of the densities that fit into a mesh: their mean and spread.

    The same numbers for the same mesh, in tens of milliseconds however many faces it has.
    """
    places = _places(mesh)
    generator = np.random.default_rng(_SEED)
    weights = generator.dirichlet(np.ones(2 + _LUMPS), _DENSITIES)
    lumps = _lumps(places, generator)
    com = weights[:, :1] * places.whole.mean(axis=0) + weights[:, 1:2] * places.solid.mean(axis=0)
    com = com + np.einsum("nk,nkc->nc", weights[:, 2:], lumps)
    second = weights[:, 0, None, None] * _second_moment(places.whole)
    second = second + weights[:, 1, None, None] * _second_moment(places.solid)
    second = second + np.einsum("nk,nkc,nkd->ncd", weights[:, 2:], lumps, lumps)
    second = second - com[:, :, None] * com[:, None]
    drawn = np.vstack([_inertia_parameters(second), _of_any_body()])
    return MassBelief(
        com_model=com.mean(axis=0),
        com_covariance_m2=np.cov(com.T),
        inertia_ratios=ratios_from_parameters(drawn.mean(axis=0)),
        parameter_covariance=np.cov(drawn.T),
    )


@dataclass(frozen=True)
class _Places:
    """Middles of cells, m, model frame."""

    whole: FloatArray
    """(n, 3) of the shape."""
    solid: FloatArray
    """(m, 3) of that part of it which encloses something; the whole where nothing does."""


def _places(mesh: trimesh.Trimesh) -> _Places:
    points = _surface_points(mesh)
    low = points.min(axis=0)
    side = max(float(np.max(np.ptp(points, axis=0))) / _CELLS, np.finfo(np.float64).tiny)
    cells = np.minimum(((points - low) / side).astype(np.intp), _CELLS - 1)
    skin = np.zeros(cells.max(axis=0) + 1, dtype=np.bool_)
    skin[tuple(cells.T)] = True
    whole = ndimage.binary_fill_holes(skin)
    solid = ndimage.binary_dilation(whole & ~skin, np.ones((3, 3, 3), dtype=np.bool_)) & whole

    def middles(of: BoolArray) -> FloatArray:
        return np.asarray(low + side * (np.argwhere(of) + 0.5))

    return _Places(middles(whole), middles(solid if solid.any() else whole))


def _surface_points(mesh: trimesh.Trimesh) -> FloatArray:
    """(n, 3) points that cover the surface evenly."""
    area = np.cumsum(mesh.area_faces)
    k = np.arange(_SURFACE_POINTS)
    faces = np.searchsorted(area, (k + 0.5) / _SURFACE_POINTS * area[-1])
    first, second = ((k * step) % 1.0 for step in _STEPS)
    root = np.sqrt(first)
    weights = np.stack([1.0 - root, root * (1.0 - second), root * second], axis=1)
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.faces)[faces]]
    return np.asarray(np.einsum("nk,nkc->nc", weights, corners))


def _lumps(places: _Places, generator: np.random.Generator) -> FloatArray:
    """(n, k, 3) places of the lumps of each density."""
    size = (_DENSITIES, _LUMPS)
    within = generator.random(size) < _SOLID_LUMPS
    somewhere, in_solid = (
        each[generator.integers(len(each), size=size)] for each in (places.whole, places.solid)
    )
    return np.where(within[..., None], in_solid, somewhere)


def _second_moment(points: FloatArray) -> FloatArray:
    """(3, 3) about the model's origin, over the mass."""
    return np.asarray(points.T @ points / len(points))


def _inertia_parameters(second: FloatArray) -> FloatArray:
    """(n, 5) of second moments (n, 3, 3) about the mass centre."""
    trace = np.trace(second, axis1=1, axis2=2)[:, None, None]
    return parameters_of(trace * np.eye(3) - second)


@lru_cache(maxsize=1)
def _of_any_body() -> FloatArray:
    """(n, 5) inertias that a body can have, whatever its shape."""
    generator = np.random.default_rng(_SEED)
    axes = Rotation.random(_DENSITIES, rng=generator).as_matrix()
    shares = generator.dirichlet(np.ones(3), _DENSITIES)
    return _inertia_parameters(np.einsum("nij,nj,nkj->nik", axes, shares, axes))
