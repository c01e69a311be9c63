"""Smoothing about a trajectory against all states solved for at once."""

from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.estimators.principal_axes.linearised import Leg, deviations

SIZE, TIMES = 5, 6


@dataclass(frozen=True)
class LinearView:
    """Two features of two components, whatever the state."""

    offset: FloatArray
    H: FloatArray
    covariance: FloatArray

    def at(self, _: object) -> tuple[FloatArray, FloatArray]:
        return self.offset, self.H


def test_deviations_are_those_of_the_whole_least_squares_problem() -> None:
    rng = np.random.default_rng(5)
    mean, root = rng.normal(size=SIZE), rng.normal(size=(SIZE, SIZE))
    prior = root @ root.T + np.eye(SIZE)
    legs, views = [], list[LinearView | None]()
    for k in range(TIMES):
        noise = rng.normal(size=(SIZE, SIZE))
        transition = np.eye(SIZE) + 0.3 * rng.normal(size=(SIZE, SIZE))
        legs.append(Leg(transition, 0.1 * noise @ noise.T, rng.normal(size=SIZE)))
        view = LinearView(rng.normal(size=(2, 2)), rng.normal(size=(2, 2, SIZE)), 0.2 * np.eye(2))
        # In between nothing is seen.
        views.append(None if k in (2, 3) else view)
    found = deviations(
        cast(Any, [None] * TIMES), legs[:-1], cast(Any, views), (mean, prior), 1.0 - 1e-15
    )
    rows, right = [np.eye(SIZE, SIZE * TIMES)], [mean]
    weights = [np.linalg.inv(prior)]
    for k in range(TIMES):
        here = slice(SIZE * k, SIZE * (k + 1))
        if k > 0:
            row = np.zeros((SIZE, SIZE * TIMES))
            row[:, here] = np.eye(SIZE)
            row[:, SIZE * (k - 1) : SIZE * k] = -legs[k - 1].transition
            rows.append(row)
            right.append(legs[k - 1].defect)
            weights.append(np.linalg.inv(legs[k - 1].noise))
        seen = views[k]
        if seen is not None:
            row = np.zeros((4, SIZE * TIMES))
            row[:, here] = seen.H.reshape(4, SIZE)
            rows.append(row)
            right.append(seen.offset.ravel())
            weights.append(np.eye(4) / 0.2)
    normal = sum(row.T @ weight @ row for row, weight in zip(rows, weights, strict=True))
    gradient = sum(
        row.T @ weight @ value for row, weight, value in zip(rows, weights, right, strict=True)
    )
    expected = np.linalg.solve(normal, gradient).reshape(TIMES, SIZE)
    np.testing.assert_allclose(found.errors, expected, atol=1e-8)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(normal)[-SIZE:, -SIZE:], atol=1e-9)
