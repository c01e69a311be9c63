"""The mass that a shape leaves open: wide enough for real satellites, the same every time."""

import time

import numpy as np
import pytest
import trimesh
from scipy.stats import chi2

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.inertia_parameters import parameters_from_ratios, shares
from pcnav.dynamics.mass_prior import MassBelief
from pcnav.target.unknown_density import unknown_density


def box_with_panels() -> trimesh.Trimesh:
    """A bus of 1.6 x 1.8 x 2.2 m between two panels, along y, of 4 m each."""
    parts = [trimesh.creation.box((1.6, 1.8, 2.2))]
    for side in (3.2, -3.2):
        panel = trimesh.creation.box((0.04, 4.0, 1.5))
        parts.append(panel.apply_translation((0.0, side, 0.2)))
    joined = trimesh.util.concatenate(parts)
    assert isinstance(joined, trimesh.Trimesh)
    return joined


def squared(belief: MassBelief, ratios: FloatArray) -> float:
    off = parameters_from_ratios(ratios) - parameters_from_ratios(belief.inertia_ratios)
    return float(off @ np.linalg.solve(belief.parameter_covariance, off))


def test_any_inertia_of_a_real_satellite_lies_well_inside() -> None:
    belief = unknown_density(box_with_panels())
    # A heavy bus without its panels, panels without a bus, and equipment at two of the corners.
    bus = np.array([0.81 + 0.64, 0.64 + 1.21, 1.21 + 0.81])[[1, 0, 2]]
    for ratios in (
        (0.5, 0.67, 0.0, 0.0, 0.0),
        (1.8, 1.5, 0.0, 0.0, 0.0),
        (0.08, 0.95, 0.0, 0.0, 0.02),
        (*(bus[1:] / bus[0]), 0.0, 0.0, 0.0),
        (0.8, 0.9, 0.3, -0.2, 0.25),
    ):
        assert squared(belief, np.array(ratios)) < chi2.ppf(0.99, 5), ratios
    # The mass centre anywhere within a third of the bus.
    sd = np.sqrt(np.diag(belief.com_covariance_m2))
    assert np.all(np.array([1.6, 1.8, 2.2]) / 3.0 < 3.0 * sd)
    assert np.all(sd < 0.25 * np.array([1.6, 9.0, 2.2]))
    assert shares(parameters_from_ratios(belief.inertia_ratios))[0][0] > 0.1


def test_a_shape_says_what_it_can() -> None:
    """A rod is lighter about its own axis, and says where along it the mass may be."""
    rod = trimesh.creation.box((8.0, 0.5, 0.5)).apply_translation((3.0, 0.0, 0.0))
    belief = unknown_density(rod)
    assert belief.com_model == pytest.approx([3.0, 0.0, 0.0], abs=0.15)
    sd = np.sqrt(np.diag(belief.com_covariance_m2))
    assert sd[0] > 10.0 * sd[1] and sd[0] > 0.9
    assert np.all(belief.inertia_ratios[:2] > 1.3)


def test_scale_and_place_of_a_mesh_do_not_matter() -> None:
    mesh = box_with_panels()
    moved = mesh.copy().apply_scale(0.01).apply_translation((5.0, -3.0, 1.0))
    here, there = unknown_density(mesh), unknown_density(moved)
    np.testing.assert_allclose(there.inertia_ratios, here.inertia_ratios, rtol=0.02)
    shift = there.com_model - 0.01 * here.com_model
    np.testing.assert_allclose(shift, [5.0, -3.0, 1.0], atol=1e-3)
    assert np.array_equal(unknown_density(mesh).com_covariance_m2, here.com_covariance_m2)


def test_an_open_sheet_and_a_fine_mesh_are_quick() -> None:
    square = trimesh.Trimesh([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], [(0, 1, 2), (0, 2, 3)])
    sheet = unknown_density(square)
    assert np.all(np.linalg.eigvalsh(sheet.parameter_covariance) > 0.0)
    fine = trimesh.creation.icosphere(7)
    assert len(fine.faces) > 300_000 and fine.area_faces.all()
    started = time.process_time()
    unknown_density(fine)
    # Measured: 0.07 s.
    assert time.process_time() - started < 0.7
