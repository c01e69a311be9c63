"""Which source a prior of the mass is taken from, and its covariances."""

import numpy as np
import pytest

from pcnav.config.depth import FilterTable
from pcnav.dynamics.inertia_parameters import parameters_from_ratios
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    STATE_SIZE,
    NavigationState,
    ratio_covariance,
)
from pcnav.estimators.depth.mass import learnt_belief, prior_belief
from pcnav.recordings.sequence import InitialPrior
from pcnav.target.satellite import Target

COM = np.array([0.1, -0.2, 0.05])
RATIOS = np.array([0.6, 0.8, 0.01, -0.02, 0.03])
STATED = InitialPrior(
    com_model_m=tuple(COM.tolist()),
    com_sd_m=(0.01, 0.02, 0.03),
    inertia_ratios=tuple(RATIOS.tolist()),
    inertia_ratios_sd=(0.004,) * 5,
)


def test_without_a_stated_prior_the_target_is_believed(boxsat: Target) -> None:
    for initial in (None, InitialPrior()):
        belief = prior_belief(boxsat, initial, FilterTable())
        np.testing.assert_array_equal(belief.com_model, boxsat.com_model)
        np.testing.assert_array_equal(belief.inertia_ratios, boxsat.inertia_ratios)
        np.testing.assert_array_equal(belief.com_covariance_m2, boxsat.mass.com_covariance_m2)
        np.testing.assert_array_equal(belief.parameter_covariance, boxsat.mass.parameter_covariance)


def test_what_the_sequence_states_comes_before_the_target(boxsat: Target) -> None:
    belief = prior_belief(boxsat, STATED, FilterTable())
    np.testing.assert_array_equal(belief.com_model, COM)
    np.testing.assert_array_equal(belief.inertia_ratios, RATIOS)
    np.testing.assert_allclose(belief.com_covariance_m2, np.diag([1e-4, 4e-4, 9e-4]))
    np.testing.assert_allclose(belief.prior.com_covariance_m2, belief.com_covariance_m2)
    np.testing.assert_allclose(
        belief.prior.ratio_covariance, 0.004**2 * np.eye(5), atol=1e-16, rtol=1e-9
    )
    # Each field on its own: a stated mass centre says nothing of the inertia.
    part = prior_belief(boxsat, InitialPrior(com_model_m=tuple(COM.tolist())), FilterTable())
    np.testing.assert_array_equal(part.com_model, COM)
    np.testing.assert_array_equal(part.inertia_ratios, boxsat.inertia_ratios)
    # Without a deviation of its own it may err by as much as it differs.
    shift = COM - boxsat.com_model
    expected = boxsat.mass.com_covariance_m2 + np.outer(shift, shift)
    np.testing.assert_allclose(part.com_covariance_m2, expected)


def test_spreads_of_the_pipeline_come_before_both(boxsat: Target) -> None:
    filtering = FilterTable(com_sd_m=0.5, inertia_ratio_sd=0.03)
    for initial in (None, STATED):
        belief = prior_belief(boxsat, initial, filtering)
        np.testing.assert_allclose(belief.com_covariance_m2, 0.25 * np.eye(3))
        np.testing.assert_allclose(belief.prior.ratio_covariance, 9e-4 * np.eye(5), atol=1e-12)
    np.testing.assert_array_equal(belief.com_model, COM)


def test_spreads_are_of_the_filters_parameters(boxsat: Target) -> None:
    # What the ratios' spread does to the parameters, by many draws.
    sharp = STATED.model_copy(update={"inertia_ratios_sd": (1e-5,) * 5})
    small = prior_belief(boxsat, sharp, FilterTable())
    draws = np.random.default_rng(0).normal(0.0, 1e-5, (2000, 5))
    parameters = np.array([parameters_from_ratios(RATIOS + draw) for draw in draws])
    sd = np.sqrt(np.diag(small.parameter_covariance))
    np.testing.assert_allclose(
        np.cov(parameters.T) / np.outer(sd, sd),
        small.parameter_covariance / np.outer(sd, sd),
        atol=0.15,
    )


def test_what_a_filter_has_learnt_is_kept(state: NavigationState) -> None:
    root = np.random.default_rng(1).normal(size=(STATE_SIZE, STATE_SIZE))
    P = 1e-4 * root @ root.T
    belief = learnt_belief(state, P)
    np.testing.assert_array_equal(belief.com_model, state.com_model)
    np.testing.assert_array_equal(belief.inertia_ratios, state.inertia_ratios)
    at_edges = ratio_covariance(state, P)
    np.testing.assert_allclose(belief.com_covariance_m2, P[COM_MODEL, COM_MODEL])
    np.testing.assert_allclose(belief.parameter_covariance, P[INERTIA_RATIOS, INERTIA_RATIOS])
    np.testing.assert_allclose(
        belief.prior.ratio_covariance, at_edges[INERTIA_RATIOS, INERTIA_RATIOS]
    )


def test_ratios_of_no_body_are_refused(boxsat: Target) -> None:
    ratios = {"inertia_ratios": (0.2, 0.2, 0.0, 0.0, 0.0)}
    with pytest.raises(ValueError, match="physical inertia"):
        InitialPrior.model_validate(ratios)
    impossible = STATED.model_copy(update=ratios)
    with pytest.raises(ValueError, match=r"inertia ratios .* expected"):
        prior_belief(boxsat, impossible, FilterTable())
