"""Recognition by size against its chi-square in closed form and against rendered faces."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, norm

from pcnav.core.arrays import FloatArray
from pcnav.perception.recognition import recognise
from pcnav.perception.rectangles import RectangleObservation
from pcnav.target.catalogue import Rectangle

SD = np.array([0.03, 0.02, 0.1])


def rectangle(name: str, length: float, width: float) -> Rectangle:
    return Rectangle(name, np.eye(4), length, width, two_sided=False)


def observation(length: float, width: float, area: float, rim: float = 0.0) -> RectangleObservation:
    """Sides and area with independent errors of SD."""
    return RectangleObservation(
        T_cam_rect=np.eye(4),
        length_m=length,
        width_m=width,
        area_m2=area,
        covariance=np.diag([*np.full(6, 1e-6), *SD**2]),
        cut_sides=(False, False, False, False),
        rim_m=rim,
    )


CATALOGUE = (
    rectangle("large", 4.0, 1.5),
    rectangle("twin", 4.0, 1.5),
    rectangle("middle", 3.0, 1.2),
    rectangle("square", 2.0, 2.0),
)


def test_entries_of_the_size_seen_are_found_and_others_are_not() -> None:
    found = recognise(observation(4.02, 1.49, 6.0), CATALOGUE, 4.0)
    assert {r.rectangle.name for r in found} == {"large", "twin"}
    assert [r.rectangle.name for r in recognise(observation(3.0, 1.21, 3.6), CATALOGUE, 4.0)] == [
        "middle"
    ]
    assert recognise(observation(3.5, 1.35, 4.7), CATALOGUE, 4.0) == ()
    assert recognise(observation(4.0, 1.5, 6.0), (), 4.0) == ()


def test_chi_square_is_that_of_independent_differences() -> None:
    seen = observation(4.05, 1.47, 6.2, rim=0.01)
    (found,) = recognise(seen, CATALOGUE[:1], 5.0)
    size = np.array([4.0, 1.5, 6.0])
    variance = SD**2 + (0.01 * size) ** 2 + (0.01 * np.array([1.0, 1.0, 5.5])) ** 2
    assert found.chi_square == pytest.approx(np.sum(np.array([0.05, -0.03, 0.2]) ** 2 / variance))


@pytest.mark.parametrize("gate_sigma", [2.0, 4.0, 6.0])
@pytest.mark.parametrize("with_area", [True, False])
def test_gate_lets_through_what_so_many_sigma_do_in_one_dimension(
    gate_sigma: float, with_area: bool
) -> None:
    size = np.array([4.0, 1.5, 6.0])
    dof = 3 if with_area else 2
    limit = chi2.ppf(2.0 * norm.cdf(gate_sigma) - 1.0, dof)
    step = np.sqrt(limit * (SD[0] ** 2 + 0.04**2))
    for share, expected in ((0.99, 1), (1.01, 0)):
        area = size[2] if with_area else float("nan")
        seen = observation(4.0 + share * step, 1.5, area)
        assert len(recognise(seen, CATALOGUE[:1], gate_sigma)) == expected


def test_best_comes_first() -> None:
    near = (rectangle("a", 4.1, 1.5), rectangle("b", 4.02, 1.5), rectangle("c", 3.95, 1.5))
    found = recognise(observation(4.0, 1.5, 6.0), near, 6.0)
    assert [r.rectangle.name for r in found] == ["b", "c", "a"]
    assert sorted(r.chi_square for r in found) == [r.chi_square for r in found]


def test_share_rejected_at_random_is_that_of_the_gate() -> None:
    rng = np.random.default_rng(0)
    size = np.array([4.0, 1.5, 6.0])
    spread = np.sqrt(SD**2 + (0.01 * size) ** 2)
    draws: FloatArray = size + rng.normal(size=(2000, 3)) * spread
    base = observation(4.0, 1.5, 6.0)
    kept = 0
    for length, width, area in draws.tolist():
        seen = replace(base, length_m=length, width_m=width, area_m2=area)
        kept += len(recognise(seen, CATALOGUE[:1], 2.0))
    share = 2.0 * norm.cdf(2.0) - 1.0
    assert kept / 2000 == pytest.approx(share, abs=4.0 * np.sqrt(share * (1 - share) / 2000))
