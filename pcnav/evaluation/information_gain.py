"""What a run learned of every state, and what it only repeats from its prior.

A filter starts with a prior of the target's mass properties and, in effect, with none of its
motion. But a camera sees the model's origin, not the mass centre: ``r = p + R com`` and, for the
rates, ``v = p' + R (omega x com)``. Position and velocity are therefore judged by what the prior
alone leaves of them once the motion of the origin is seen; attitude and rate are seen as they are.

With the information ``L0`` of the prior, zero outside the mass properties, the final covariance P
splits into what an error of the prior and what the noise of the data put into it:
``P = P L0 P + P (P^-1 - L0) P``. The first part's share of a variance is the prior's share.
"""

import csv
import io
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.spatial import skew
from pcnav.dynamics.blocks import ATTITUDE, MASS_CENTRE_LAYOUT, RATE
from pcnav.dynamics.mass_prior import PriorMass
from pcnav.dynamics.orbit import R_hill_world
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    R_HILL,
    STATE_SIZE,
    V_HILL,
)
from pcnav.runs.run import Run

FROM_DATA = "known from data"
PRIOR_ONLY = "prior only"

MAX_PRIOR_SHARE = 0.25
"""A state is known from data when the prior has no larger share of its final variance.

The data have then at least halved the standard deviation of a mass property, since its share is
never below the ratio of final to prior variance; for a state by itself it is that ratio, and the
prior's weight in the estimate.
"""
ENOUGH_BITS = 2.0
"""... or when it gained so much that it does not matter whose the rest is.

Not less: a motion may leave one combination of all five inertia ratios wholly unknown, and each of
them, with an even part in it, has still gained log2(sqrt(5)) = 1.16 bits.
"""

KNOWN_RULE = (
    f"Known from data: the prior's share is at most {MAX_PRIOR_SHARE:.0%}, or the standard "
    f"deviation has fallen to 1/{2**ENOUGH_BITS:g} or less; else prior only, whatever was gained."
)

_COM_TERMS = ("com_x", "com_y", "com_z")
_RATIO_TERMS = ("Iyy", "Izz", "Ixy", "Ixz", "Iyz")
_MIN_TERM = 0.05
"""Coefficients of a unit combination below this are left out of its name."""
_SAME_BITS = 0.1
"""Combinations that gained the same to within this many bits could be any mixture of each other."""


@dataclass(frozen=True)
class StateGain:
    """What became of the uncertainty of one state, or of one combination of states."""

    name: str
    """Column of states.csv, or the combination in words."""
    unit: str
    prior_sd: float
    """What the prior of the mass properties alone leaves; infinite where it says nothing."""
    posterior_sd: float
    prior_share: float
    """Share of the posterior variance that stems from the prior of the mass properties, 0 to 1."""

    @property
    def bits(self) -> float:
        """Information gained, ``log2(prior sd / posterior sd)``: one bit halves the sd.

        Not below zero: a velocity that the prior leaves next to no doubt of is as uncertain as the
        origin's, which the data gave.
        """
        return float(np.log2(max(self.prior_sd / self.posterior_sd, 1.0)))

    @property
    def known(self) -> bool:
        """Whether it is known from data: see `MAX_PRIOR_SHARE` and `ENOUGH_BITS`."""
        return self.prior_share <= MAX_PRIOR_SHARE or self.bits >= ENOUGH_BITS

    @property
    def verdict(self) -> str:
        """`FROM_DATA` or `PRIOR_ONLY`."""
        return FROM_DATA if self.known else PRIOR_ONLY


@dataclass(frozen=True)
class InformationGain:
    """What is known of the states at the end of a run."""

    states: tuple[StateGain, ...]
    """20, in error-state order."""
    com_combinations: tuple[StateGain, ...]
    """3 independent combinations of the mass centre's components, least known first."""
    ratio_combinations: tuple[StateGain, ...]
    """5 independent combinations of the inertia ratios, least known first."""

    @property
    def prior_only(self) -> tuple[str, ...]:
        """Names of the states that are not known from data."""
        return tuple(state.name for state in self.states if not state.known)


def information_gain(
    prior: PriorMass, covariance: FloatArray, R_hill_body: FloatArray, omega_body: FloatArray
) -> InformationGain:
    """Compare the final covariance (20, 20) of a run with the prior of its mass properties.

    ``R_hill_body`` (3, 3) and ``omega_body`` (3,), rad/s, are the final estimate's. The
    combinations solve ``P v = lambda P0 v`` on the mass centre and on the ratios: under a pure
    spin the data say nothing about some of them even where the standard deviation of every single
    state shrinks.
    """
    prior_covariance = np.diag(np.full(STATE_SIZE, np.inf))
    prior_covariance[COM_MODEL, COM_MODEL] = prior.com_covariance_m2
    prior_covariance[INERTIA_RATIOS, INERTIA_RATIOS] = prior.ratio_covariance
    # The Hill frame's own turn is far slower than any rate that matters here.
    for block, by_com in ((R_HILL, R_hill_body), (V_HILL, R_hill_body @ skew(omega_body))):
        prior_covariance[block, block] = by_com @ prior.com_covariance_m2 @ by_com.T
    judged = _Judge(prior_covariance, covariance, part_of_prior(prior, covariance))
    return InformationGain(
        states=judged.states(),
        com_combinations=judged.combinations(COM_MODEL, _COM_TERMS, "m"),
        ratio_combinations=judged.combinations(INERTIA_RATIOS, _RATIO_TERMS, "1"),
    )


def part_of_prior(prior: PriorMass, covariance: FloatArray) -> FloatArray:
    """(20, 20) what errors of the prior put into a final covariance (20, 20): ``P L0 P``."""
    part = np.zeros((STATE_SIZE, STATE_SIZE))
    priors = (COM_MODEL, prior.com_covariance_m2), (INERTIA_RATIOS, prior.ratio_covariance)
    for block, of_block in priors:
        columns = covariance[:, block]
        part += columns @ np.linalg.solve(of_block, columns.T)
    return part


def gain_of_run(run: Run, prior: PriorMass, mean_motion_rad_s: float) -> InformationGain | None:
    """What the final estimate of a run gained on its prior; None of a run without an estimate.

    The run is loaded with its covariances.
    """
    last, trajectory = run.final_frame, run.trajectory
    if trajectory.covariance is None or last is None:
        return None
    R_hill_body = R_hill_world(run.time_s[last], mean_motion_rad_s) @ trajectory[ATTITUDE][last]
    return information_gain(prior, trajectory.covariance[last], R_hill_body, trajectory[RATE][last])


def gain_csv(gain: InformationGain) -> str:
    """The content of knowledge.csv: the 20 states, then the combinations, least known first.

    Standard deviations are in the unit of the row; where the prior says nothing its own, and the
    bits gained on it, are ``inf``.
    """
    stream = io.StringIO()
    rows = csv.writer(stream, lineterminator="\n")
    rows.writerow(("state", "unit", "prior_sd", "posterior_sd", "bits", "prior_share", "verdict"))
    for each in (*gain.states, *gain.com_combinations, *gain.ratio_combinations):
        sds = (each.prior_sd, each.posterior_sd)
        rows.writerow((each.name, each.unit, *sds, each.bits, each.prior_share, each.verdict))
    return stream.getvalue()


@dataclass(frozen=True)
class _Judge:
    """Prior and posterior covariance and the prior's part of the latter, each (20, 20)."""

    prior: FloatArray
    posterior: FloatArray
    from_prior: FloatArray

    def states(self) -> tuple[StateGain, ...]:
        named = [
            (n, block.unit) for block in MASS_CENTRE_LAYOUT.blocks for n in block.error_columns
        ]
        return tuple(
            self._one(np.array([k]), np.ones(1), name, unit) for k, (name, unit) in enumerate(named)
        )

    def combinations(
        self, block: slice, terms: tuple[str, ...], unit: str
    ) -> tuple[StateGain, ...]:
        """The independent combinations of a block of the state, least known first."""
        indices = np.arange(block.start, block.stop)
        weights = independent_combinations(self.prior[block, block], self.posterior[block, block])
        found = [self._one(indices, each, in_words(each, terms), unit) for each in weights]
        return tuple(sorted(found, key=lambda each: each.bits))

    def _one(self, indices: IntArray, weights: FloatArray, name: str, unit: str) -> StateGain:
        def variance(matrix: FloatArray) -> float:
            return float(weights @ matrix[np.ix_(indices, indices)] @ weights)

        # What is known to the last digit may come out negative.
        posterior = max(variance(self.posterior), np.finfo(np.float64).tiny)
        # Rounding, and noise a filter adds to its covariance, may leave a part above the whole.
        share = np.clip(variance(self.from_prior) / posterior, 0.0, 1.0)
        prior_sd = float(np.sqrt(variance(self.prior)))
        return StateGain(name, unit, prior_sd, float(np.sqrt(posterior)), float(share))


def independent_combinations(prior: FloatArray, posterior: FloatArray) -> FloatArray:
    """(n, n) unit combinations of n states, one a row, the one the data say least about first.

    They are uncorrelated under the prior (n, n) and the posterior (n, n) alike. Combinations of
    nearly equal gain may be mixed freely; they are chosen to involve few states each.
    """
    variances, axes = np.linalg.eigh(prior)
    whitening = axes / np.sqrt(variances) @ axes.T
    ratios, directions = np.linalg.eigh(whitening @ posterior @ whitening)
    ratios, directions = ratios[::-1], directions[:, ::-1]
    # The smallest ratios of a long run are lost in rounding and may come out negative.
    bits = -0.5 * np.log2(np.maximum(ratios, np.finfo(np.float64).eps ** 2))
    first = 0
    for end in range(1, len(bits) + 1):
        if end == len(bits) or bits[end] - bits[first] > _SAME_BITS:
            directions[:, first:end] = _sparse_basis(directions[:, first:end])
            first = end
    combinations = directions.T @ whitening
    return np.asarray(combinations / np.linalg.norm(combinations, axis=1, keepdims=True))


def _sparse_basis(basis: FloatArray) -> FloatArray:
    """Orthonormal (n, k) of the same span: each the nearest to an axis among what is left."""
    left, chosen = basis.copy(), []
    for _ in range(basis.shape[1]):
        reach = np.linalg.norm(left, axis=1)
        # Rounding must not decide between axes that are equally near.
        axis = int(np.argmax(np.round(reach, 6)))
        direction = left @ left[axis] / reach[axis]
        chosen.append(direction)
        left = left - np.outer(direction, direction @ left)
    return np.column_stack(chosen)


def in_words(weights: FloatArray, terms: tuple[str, ...]) -> str:
    """A combination as people write it, as "0.71 Iyy + 0.70 Izz"; the largest term is positive."""
    weights = weights * np.sign(weights[np.argmax(np.abs(weights))])
    kept = [(w, term) for w, term in zip(weights, terms, strict=True) if abs(w) >= _MIN_TERM]
    if len(kept) == 1:
        return kept[0][1]
    first, *others = kept
    signed = [f"{'-' if w < 0 else '+'} {abs(w):.2f} {term}" for w, term in others]
    return " ".join([f"{first[0]:.2f} {first[1]}", *signed])
