"""What a run knows beyond its prior: closed forms, the real motion model, and the stored table."""

import csv
import io
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT
from pcnav.dynamics.inertia_parameters import parameter_covariance
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.mass_prior import PriorMass
from pcnav.dynamics.rigid_body import ratios_from_inertia
from pcnav.dynamics.state import (
    COM_MODEL,
    INERTIA_RATIOS,
    OMEGA_BODY,
    R_HILL,
    STATE_SIZE,
    THETA_BODY,
    V_HILL,
    NavigationState,
    ratio_covariance,
)
from pcnav.dynamics.trajectory import Trajectory
from pcnav.estimators.depth.first_state import start_covariance
from pcnav.estimators.depth.mass_centre import MassCentreModel, RectangleMeasurement
from pcnav.evaluation.answer.model import Verdict
from pcnav.evaluation.answer.telling import About, final_estimate
from pcnav.evaluation.information_gain import (
    FROM_DATA,
    PRIOR_ONLY,
    InformationGain,
    StateGain,
    gain_csv,
    gain_of_run,
    in_words,
    independent_combinations,
    information_gain,
)
from pcnav.report.summary import gain_text
from pcnav.runs.run import Run

PRIOR = PriorMass(0.15**2 * np.eye(3), 0.01 * np.eye(5))
STILL = np.zeros(3)


def judged(prior: PriorMass, covariance: FloatArray) -> InformationGain:
    """Of a target that does not turn."""
    return information_gain(prior, covariance, np.eye(3), STILL)


def with_data(prior: PriorMass, data: FloatArray, prior_scale: float = 1.0) -> FloatArray:
    """Posterior covariance of a linear model: the information of data and prior added up."""
    information = data.copy()
    for block, own in (
        (COM_MODEL, prior.com_covariance_m2),
        (INERTIA_RATIOS, prior.ratio_covariance),
    ):
        information[block, block] += prior_scale * np.linalg.inv(own)
    return np.asarray(np.linalg.inv(information))


def random_data(seed: int) -> FloatArray:
    """Information with strong correlations between all states."""
    root = np.random.default_rng(seed).normal(size=(STATE_SIZE, STATE_SIZE))
    return np.asarray(30.0 * root @ root.T)


def random_prior(seed: int) -> PriorMass:
    """A prior whose axes are not those of the model."""
    generator = np.random.default_rng(seed)
    com, ratios = generator.normal(size=(3, 3)), generator.normal(size=(5, 5))
    return PriorMass(
        0.02 * com @ com.T + 1e-3 * np.eye(3), 0.01 * ratios @ ratios.T + 1e-3 * np.eye(5)
    )


# One motion through the filter's own model.


def covariance_after(
    rate_rad_s: FloatArray, inertia: FloatArray, prior: PriorMass, frames: int = 80
) -> tuple[NavigationState, FloatArray]:
    """Final state and its covariance (20, 20), the last five by the ratios, of a filter that sees
    the pose of one face to 1 mm and 0.03 degrees twice a second from a camera at rest."""
    model = MassCentreModel(0.0, 1e-14, 1e-16)
    state = NavigationState(
        r_hill=np.array([18.0, 0.5, -0.3]),
        v_hill=np.array([0.005, -0.002, 0.001]),
        com_model=np.array([0.1, -0.05, 0.08]),
        R_world_body=exp_rotation(np.array([0.3, -0.2, 0.5])),
        omega_body=rate_rad_s,
        inertia_ratios=ratios_from_inertia(inertia),
    )
    ratio_sd = np.sqrt(np.diag(prior.ratio_covariance))
    P = start_covariance(
        rate_rad_s,
        prior.com_covariance_m2,
        parameter_covariance(state.inertia_ratios, ratio_sd),
    )
    for frame in range(frames):
        if frame:
            state, transition, noise = model.propagate(state, 0.0, 0.5)
            P = transition @ P @ transition.T + noise
        seen = RectangleMeasurement(
            T_model_rect=np.eye(4),
            T_cam_rect=state.T_cam_model(np.eye(4), np.eye(3)),
            known=np.ones(6, dtype=np.bool_),
            full_covariance=np.diag(np.repeat([1e-3, 5e-4], 3) ** 2),
            T_cam_hill=np.eye(4),
            R_hill_world=np.eye(3),
        )
        H, R = seen.jacobian(state), seen.covariance
        gain = np.linalg.solve(H @ P @ H.T + R, H @ P).T
        left = np.eye(STATE_SIZE) - gain @ H
        P = left @ P @ left.T + gain @ R @ gain.T
    return state, ratio_covariance(state, P)


def known_after(rate_rad_s: FloatArray, inertia: FloatArray) -> InformationGain:
    state, P = covariance_after(rate_rad_s, inertia, PRIOR)
    return information_gain(PRIOR, P, state.R_world_body, state.omega_body)


def test_a_tumble_tells_everything() -> None:
    inertia = np.array([[1.0, 0.02, -0.01], [0.02, 1.3, 0.03], [-0.01, 0.03, 0.8]])
    gain = known_after(np.array([0.1, 0.07, 0.12]), inertia)
    assert gain.prior_only == ()
    assert all(each.known for each in gain.ratio_combinations + gain.com_combinations)
    assert gain_text(gain) == "20 of 20 states"


def test_a_spin_about_a_principal_axis_leaves_combinations_to_the_prior() -> None:
    """A steady spin about z says that Ixz and Iyz vanish, and nothing of the other three; nor where
    on the axis the mass centre lies."""
    gain = known_after(np.array([0.0, 0.0, 0.15]), np.diag([1.0, 1.3, 0.8]))
    unknown = {each.name for each in gain.ratio_combinations if not each.known}
    assert unknown == {"Iyy", "Izz", "Ixy"}
    assert [each.bits < 0.01 for each in gain.ratio_combinations] == [True] * 3 + [False] * 2
    assert [each.known for each in gain.com_combinations] == [False, True, True]
    assert gain.com_combinations[0].name == "com_z"
    mass_states = ("com_z_m", "i_yy", "i_zz", "i_xy")
    assert set(gain.prior_only) - {"r_x_m", "r_y_m", "r_z_m"} == set(mass_states)
    # The axis points mostly along the Hill z axis, so that is where the position is not known.
    assert "r_z_m" in gain.prior_only
    assert {each.verdict for each in gain.states[V_HILL]} == {FROM_DATA}
    assert gain_text(gain).endswith("com_z_m, i_yy, i_zz, i_xy")


def test_a_spin_about_an_oblique_principal_axis_is_told_by_its_combination() -> None:
    """Every component of the mass centre gains, the position along the spin axis does not."""
    R = exp_rotation(np.array([0.5, -0.6, 0.2]))
    axis = R[:, 2]
    gain = known_after(0.15 * axis, R @ np.diag([1.0, 1.3, 0.8]) @ R.T)
    weakest = gain.com_combinations[0]
    assert weakest.verdict == PRIOR_ONLY
    assert weakest.bits < 0.05
    terms = ("com_x", "com_y", "com_z")
    assert weakest.name == in_words(axis, terms)
    assert all(state.bits > 0.1 for state in gain.states[COM_MODEL])
    # Each by the share of the unknown direction in it.
    for state, cosine in zip(gain.states[COM_MODEL], axis, strict=True):
        assert state.posterior_sd == pytest.approx(abs(cosine) * weakest.posterior_sd, rel=0.01)
    assert sum(not each.known for each in gain.ratio_combinations) == 3


# Closed forms.


@pytest.mark.parametrize(("data_over_prior", "known"), [(0.0, False), (2.9, False), (3.1, True)])
def test_a_single_state_is_known_once_the_data_halve_its_sd(
    data_over_prior: float, known: bool
) -> None:
    data = np.eye(STATE_SIZE)
    data[6, 6] = data_over_prior / 0.15**2
    com_x = judged(PRIOR, with_data(PRIOR, data)).states[6]
    assert com_x.name == "com_x_m"
    assert com_x.unit == "m"
    assert com_x.prior_sd == pytest.approx(0.15)
    assert com_x.bits == pytest.approx(0.5 * np.log2(1.0 + data_over_prior), abs=1e-12)
    assert com_x.prior_share == pytest.approx(1.0 / (1.0 + data_over_prior))
    assert com_x.verdict == (FROM_DATA if known else PRIOR_ONLY)


def test_what_no_single_state_shows_is_prior_only() -> None:
    """The data tell every difference of the ratios well and nothing of their sum."""
    even = np.full(5, 1.0 / np.sqrt(5.0))
    data = np.eye(STATE_SIZE)
    data[INERTIA_RATIOS, INERTIA_RATIOS] = 1e8 * (np.eye(5) - np.outer(even, even))
    gain = judged(PRIOR, with_data(PRIOR, data))
    for state in gain.states[INERTIA_RATIOS]:
        assert state.bits == pytest.approx(0.5 * np.log2(5.0), abs=1e-5)
        assert state.verdict == PRIOR_ONLY
    weakest, *others = gain.ratio_combinations
    assert weakest.name == "0.45 Iyy + 0.45 Izz + 0.45 Ixy + 0.45 Ixz + 0.45 Iyz"
    assert weakest.bits == pytest.approx(0.0, abs=1e-5)
    assert all(each.bits > 8.0 for each in others)


def test_a_precise_state_is_known_though_the_rest_is_the_priors() -> None:
    state = StateGain("i_xz", "1", 0.1, 1e-4, 0.6)
    assert state.verdict == FROM_DATA
    assert StateGain("i_xz", "1", 0.1, 0.04, 0.6).verdict == PRIOR_ONLY


@given(seed=st.integers(0, 2**32 - 1))
def test_the_priors_share_is_the_slope_by_its_information(seed: int) -> None:
    """``P(a) = (data + a prior)^-1`` falls with a at the relative rate of the share."""
    prior, data = random_prior(seed), random_data(seed + 1)
    h = 1e-4
    more, less = (np.diag(with_data(prior, data, 1.0 + sign * h)) for sign in (1, -1))
    slope = -(np.log(more) - np.log(less)) / (2.0 * h)
    gain = judged(prior, with_data(prior, data))
    shares = np.array([state.prior_share for state in gain.states])
    np.testing.assert_allclose(shares, slope, rtol=1e-4, atol=1e-7)


@given(seed=st.integers(0, 2**32 - 1))
def test_a_known_state_has_at_least_halved(seed: int) -> None:
    prior = random_prior(seed)
    scale = 10.0 ** np.random.default_rng(seed).uniform(-3.0, 2.0)
    gain = judged(prior, with_data(prior, scale * random_data(seed + 1)))
    mass = gain.states[COM_MODEL] + gain.states[INERTIA_RATIOS]
    for each in mass + gain.com_combinations + gain.ratio_combinations:
        assert not each.known or each.bits >= 1.0 - 1e-9
        assert each.prior_share >= (each.posterior_sd / each.prior_sd) ** 2 - 1e-9


@given(seed=st.integers(0, 2**32 - 1))
def test_the_combinations_carry_all_the_information(seed: int) -> None:
    """Their bits add up to the gain in the determinant, however prior and data are turned."""
    prior, P = random_prior(seed), with_data(random_prior(seed), random_data(seed + 1))
    gain = judged(prior, P)
    for found, own, block in (
        (gain.com_combinations, prior.com_covariance_m2, COM_MODEL),
        (gain.ratio_combinations, prior.ratio_covariance, INERTIA_RATIOS),
    ):
        gained = np.linalg.slogdet(own)[1] - np.linalg.slogdet(P[block, block])[1]
        bits = [each.bits for each in found]
        # Those within a tenth of a bit may have been mixed.
        assert sum(bits) == pytest.approx(0.5 * gained / np.log(2.0), abs=0.02)
        assert bits == sorted(bits)


@given(seed=st.integers(0, 2**32 - 1))
def test_combinations_are_uncorrelated_before_and_after(seed: int) -> None:
    prior = random_prior(seed).ratio_covariance
    root = np.random.default_rng(seed + 1).normal(size=(5, 5))
    weights = np.diag(np.exp(-np.arange(5.0))) @ root
    information = np.linalg.inv(prior) + 100.0 * weights.T @ weights
    posterior = np.asarray(np.linalg.inv(information), dtype=np.float64)
    combinations = independent_combinations(prior, posterior)
    np.testing.assert_allclose(np.linalg.norm(combinations, axis=1), 1.0)
    for covariance, most in ((prior, 1e-6), (posterior, 0.1)):
        among = combinations @ covariance @ combinations.T
        sd = np.sqrt(np.diag(among))
        assert np.max(np.abs(among / np.outer(sd, sd) - np.eye(5))) < most


def test_equal_combinations_are_the_states_themselves() -> None:
    prior: FloatArray = np.diag([0.04, 0.01, 0.09])
    posterior: FloatArray = np.diag([0.012, 0.003, 0.027])
    combinations = independent_combinations(prior, posterior)
    names = {in_words(each, ("x", "y", "z")) for each in combinations}
    assert names == {"x", "y", "z"}


def test_combinations_read_as_people_write_them() -> None:
    terms = ("Iyy", "Izz", "Ixy")
    assert in_words(np.array([-0.71, -0.70, 0.01]), terms) == "0.71 Iyy + 0.70 Izz"
    assert in_words(np.array([0.2, -0.3, 0.93]), terms) == "0.20 Iyy - 0.30 Izz + 0.93 Ixy"
    assert in_words(np.array([-0.3, 0.0, 0.95]), terms) == "-0.30 Iyy + 0.95 Ixy"
    assert in_words(np.array([0.01, -1.0, 0.02]), terms) == "Izz"


def test_position_and_velocity_are_judged_by_what_the_mass_centre_leaves_of_them() -> None:
    """A sphere of uncertainty turned about z: the velocity knows nothing of the centre's z."""
    omega = np.array([0.0, 0.0, 0.2])
    gain = information_gain(
        PRIOR, with_data(PRIOR, np.eye(STATE_SIZE)), exp_rotation(np.ones(3)), omega
    )
    assert [each.prior_sd for each in gain.states[R_HILL]] == pytest.approx([0.15] * 3)
    # Turned from body into Hill axes, where it is again a disc of radius 0.15 m x 0.2 rad/s.
    normal = exp_rotation(np.ones(3))[:, 2]
    expected = 0.15 * 0.2 * np.sqrt(1.0 - normal**2)
    assert [each.prior_sd for each in gain.states[V_HILL]] == pytest.approx(expected.tolist())
    for block in (THETA_BODY, OMEGA_BODY):
        assert all(np.isinf([each.prior_sd, each.bits]).all() for each in gain.states[block])


def test_a_target_at_rest_has_a_known_velocity_and_an_unknown_mass_centre() -> None:
    gain = known_after(STILL, np.diag([1.0, 1.3, 0.8]))
    for each in gain.states[V_HILL]:
        assert (each.verdict, each.bits) == (FROM_DATA, 0.0)
    for block in (R_HILL, COM_MODEL, INERTIA_RATIOS):
        assert {each.verdict for each in gain.states[block]} == {PRIOR_ONLY}


# The stored table.


def test_the_table_has_every_state_and_combination() -> None:
    gain = judged(PRIOR, with_data(PRIOR, random_data(3)))
    rows = list(csv.DictReader(io.StringIO(gain_csv(gain))))
    assert len(rows) == STATE_SIZE + 3 + 5
    told = {f"sd_{row['state']}" for row in rows[:STATE_SIZE]}
    assert told == set(MASS_CENTRE_LAYOUT.sd_columns)
    assert [row["state"] for row in rows[:STATE_SIZE]][6:10] == [
        *("com_x_m", "com_y_m", "com_z_m", "theta_x_rad"),
    ]
    for row, each in zip(rows, gain.states + gain.com_combinations, strict=False):
        assert float(row["prior_sd"]) == each.prior_sd
        assert float(row["posterior_sd"]) == each.posterior_sd
        assert float(row["bits"]) == each.bits
        assert row["verdict"] == each.verdict
    assert float(rows[9]["prior_sd"]) == np.inf
    assert {row["unit"] for row in rows} == {"m", "m/s", "rad", "rad/s", "1"}


def test_what_is_known_at_the_end_is_what_is_known_of_the_final_estimate() -> None:
    """Frames that only coast after the last claim, and no longer know much, are not asked."""
    state, P = covariance_after(np.array([0.05, -0.02, 0.04]), np.diag([1.0, 1.3, 0.8]), PRIOR)
    values = {name: np.stack(3 * [value]) for name, value in state.values.items()}
    covariance = np.stack([P, P, 1e6 * P])
    trajectory = Trajectory(
        np.arange(3.0),
        MASS_CENTRE_LAYOUT,
        values,
        sd=np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)),
        covariance=covariance,
        T_cam_target=np.stack(3 * [np.eye(4)]),
    )
    run = Run(
        name="",
        folder=None,
        estimator="depth",
        pipeline=None,
        trajectory=trajectory,
        status=("locked", "locked", "coasting"),
        nis=np.full(3, 6.0),
        nis_dof=np.full(3, 6, np.intp),
        window_nis=np.ones(3),
    )
    assert run.final_frame == 1
    gain = gain_of_run(run, PRIOR, 0.0)
    expected = information_gain(PRIOR, P, state.R_world_body, state.omega_body)
    assert gain is not None
    assert [each.verdict for each in gain.states] == [each.verdict for each in expected.states]
    estimate = final_estimate(run, About(prior=PRIOR, orbit=KeplerOrbit(0.0)))
    assert estimate is not None and estimate.frame == 1
    ratios = estimate.findings["inertia_ratios"].verdicts
    own = [each.known for each in gain.states[INERTIA_RATIOS]]
    assert [verdict is Verdict.DATA for verdict in ratios] == own
    unclaimed = replace(run, status=3 * ("coasting",))
    assert unclaimed.final_frame == 2
