"""The answer of a run: its deviations against sampled states, its verdicts, its file."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import exp_rotation, log_rotation, rotation_from_xyzw
from pcnav.dynamics.blocks import ATTITUDE, CENTRE, MASS_CENTRE_LAYOUT, POSITION, RATE, RATIOS
from pcnav.dynamics.kepler import KeplerOrbit
from pcnav.dynamics.mass_prior import PriorMass
from pcnav.evaluation.answer.findings import Found, findings
from pcnav.evaluation.answer.model import Answer, FinalEstimate, Finding, Verdict
from pcnav.evaluation.answer.sources import Sources
from pcnav.evaluation.answer.stated_priors import stated_prior_sd
from pcnav.evaluation.answer.telling import About, answer_of
from pcnav.evaluation.metrics import run_metrics
from tests.made_runs import KINDS, made_run

N_DRAWS = 4000
HILL = exp_rotation(np.array([0.0, 0.4, 0.0]))
STATE = {
    "r_hill": np.array([18.0, -3.0, 2.0]),
    "v_hill": np.array([0.01, -0.02, 0.005]),
    "com_model": np.array([0.3, -0.2, 0.5]),
    "theta_body": exp_rotation(np.array([0.4, -1.1, 0.7])),
    "omega_body": np.array([0.05, -0.12, 0.08]),
    "inertia_ratios": np.array([0.8, 1.3, 0.05, -0.04, 0.02]),
}
SD = np.repeat([0.003, 1e-4, 0.002, 0.004, 1e-3, 0.006], [3, 3, 3, 3, 3, 5])
PRIOR = PriorMass(0.15**2 * np.eye(3), 0.2**2 * np.eye(5))


def covariance() -> FloatArray:
    factor = np.random.default_rng(1).standard_normal((20, 20)) + 2.0 * np.eye(20)
    correlation = factor @ factor.T
    scale = SD / np.sqrt(np.diagonal(correlation))
    return np.asarray(correlation * scale[:, None] * scale)


def found_of(P: FloatArray, prior: PriorMass | None = None, claimed: bool = True) -> Found:
    sources = Sources.of(STATE, P, prior, HILL, claimed)
    p_cam = HILL.T @ STATE["r_hill"] - STATE["theta_body"] @ STATE["com_model"]
    T_cam_target = np.eye(4)
    T_cam_target[:3, :3], T_cam_target[:3, 3] = STATE["theta_body"], p_cam
    return Found(STATE, MASS_CENTRE_LAYOUT, sources, T_cam_target, HILL)


def drawn(P: FloatArray) -> list[dict[str, FloatArray]]:
    """States about the estimate, as its covariance has them."""
    errors = np.random.default_rng(2).multivariate_normal(np.zeros(20), P, N_DRAWS)
    states = []
    for error in errors:
        state = {}
        for block in MASS_CENTRE_LAYOUT.blocks:
            part, value = error[MASS_CENTRE_LAYOUT.slice_of(block)], STATE[block.name]
            state[block.name] = value @ exp_rotation(part) if block is ATTITUDE else value + part
        states.append(state)
    return states


def inertia(ratios: FloatArray) -> FloatArray:
    yy, zz, xy, xz, yz = ratios
    return np.array([[1.0, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def widest_deg(directions: FloatArray, about: FloatArray) -> float:
    """Largest deviation of unit vectors (n, 3), whose sign means nothing, from one."""
    signed = directions * np.sign(directions @ about)[:, None]
    across = signed - np.outer(signed @ about, about)
    return float(np.rad2deg(np.sqrt(np.linalg.eigvalsh(across.T @ across / len(across))[-1])))


def test_deviations_are_those_of_sampled_states() -> None:
    P = covariance()
    told = findings(found_of(P))
    states = drawn(P)
    r = np.array([state[POSITION.name] for state in states])
    R = np.array([state[ATTITUDE.name] for state in states])
    com = np.array([state[CENTRE.name] for state in states])
    rate = np.array([state[RATE.name] for state in states])
    bodies = np.array([inertia(state[RATIOS.name]) for state in states])
    p_cam = r @ HILL - np.einsum("nij,nj->ni", R, com)
    moments, axes = np.linalg.eigh(bodies)
    momentum = np.einsum("nij,njk,nk->ni", R, bodies, rate)
    momentum /= np.linalg.norm(momentum, axis=1)[:, None]
    sampled = {
        "range_m": np.std(np.linalg.norm(r, axis=1)),
        "position_cam_m": np.std(p_cam, axis=0),
        "rate_magnitude_deg_s": np.rad2deg(np.std(np.linalg.norm(rate, axis=1))),
        "principal_moments": np.std(moments[:, [1, 0]] / moments[:, 2:], axis=0),
    }
    for k in range(3):
        key = f"principal_axis_{k + 1}_body"
        sampled[key] = widest_deg(axes[:, :, 2 - k], np.array(told[key].value))
    direction = told["momentum_direction_world"]
    sampled["momentum_direction_world"] = widest_deg(momentum, np.array(direction.value))
    for key, sd in sampled.items():
        np.testing.assert_allclose(
            np.array(told[key].sd), np.atleast_1d(sd), rtol=0.06, err_msg=key
        )
    attitude = told["attitude_cam_xyzw"]
    R_told = rotation_from_xyzw(np.array(attitude.value))
    assert np.linalg.norm(log_rotation(R_told.T @ STATE["theta_body"])) < 1e-9
    np.testing.assert_allclose(np.array(attitude.sd), np.rad2deg(np.sqrt(np.diagonal(P)[9:12])))


def test_a_number_that_only_repeats_the_prior_is_called_so() -> None:
    P = np.diag(SD**2)
    assert {v for each in findings(found_of(P, PRIOR)).values() for v in each.verdicts} == {
        Verdict.DATA
    }
    # The ratios as they were believed, and the mass centre along y.
    P[15:, 15:] = PRIOR.ratio_covariance
    P[7, 7] = PRIOR.com_covariance_m2[1, 1]
    told = findings(found_of(P, PRIOR))
    assert told["mass_centre_model_m"].verdicts == (Verdict.DATA, Verdict.PRIOR, Verdict.DATA)
    for key in ("inertia_ratios", "principal_moments", "momentum_direction_world"):
        assert told[key].verdict is Verdict.PRIOR, key
    # A wide prior says nothing of the axes of a body whose moments are not far apart.
    assert told["principal_axis_1_body"].verdict is Verdict.NOT
    assert told["rate_body_deg_s"].verdict is told["attitude_cam_xyzw"].verdict is Verdict.DATA


def test_what_a_bank_of_filters_was_told_is_no_finding() -> None:
    """Segal 2011's filters begin about an attitude, which features do not show without a model."""
    told = stated_prior_sd("inertia_bank", None, MASS_CENTRE_LAYOUT)
    assert np.isinf(told[6:9]).all() and np.isfinite(np.delete(told, [6, 7, 8])).all()
    P = np.diag(SD**2)
    P[9:12, 9:12] = np.deg2rad(4.9) ** 2 * np.eye(3)
    sources = Sources.of(STATE, P, None, HILL, True, told)
    found = findings(replace(found_of(P), sources=sources))
    assert found["attitude_cam_xyzw"].verdict is Verdict.PRIOR
    assert found["rate_body_deg_s"].verdict is Verdict.DATA
    assert np.isinf(stated_prior_sd("principal_axes", None, MASS_CENTRE_LAYOUT)).all()


def test_what_says_nothing_is_not_known() -> None:
    P = np.diag(SD**2)
    P[10, 10] = 1.0
    about_y = findings(found_of(P, PRIOR))["attitude_cam_xyzw"]
    assert about_y.verdicts == (Verdict.DATA, Verdict.NOT, Verdict.DATA)
    unclaimed = findings(found_of(np.diag(SD**2), PRIOR, claimed=False))
    assert {each.verdict for each in unclaimed.values()} == {Verdict.NOT}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("frames", [0, 2, 20])
def test_every_kind_of_run_has_an_answer(kind: str, frames: int, tmp_path: Path) -> None:
    run = made_run(kind, frames).stored(tmp_path / "run")
    # The last frames are coasted: the answer is that of the last one that was claimed.
    status = (*run.status[:-4], *["coasting"] * min(frames, 4))
    run = replace(run, status=status)
    answer = answer_of(run, run_metrics(run), About("made", orbit=KeplerOrbit(1e-3)))
    assert Answer.model_validate_json(answer.model_dump_json()) == answer
    assert answer.found == (frames == 20)
    at = answer.estimate
    assert (at is not None) == (frames == 20)
    if at is None:
        return
    claimed = [k for k, word in enumerate(status) if word == "locked" and run.has_estimate[k]]
    assert (at.frame, at.age_s) == (claimed[-1], run.time_s[-1] - run.time_s[claimed[-1]])
    assert ("range_m" in at.findings) == (run.trajectory.T_cam_target is not None)
    assert ("inertia_ratios" in at.findings) == (RATIOS in run.trajectory)
    # The bank alone was told of the motion, and these made-up deviations are hardly smaller.
    verdicts = {each.verdict for each in at.findings.values()}
    assert verdicts == ({*Verdict} - {Verdict.NOT} if kind == "inertia_bank" else {Verdict.DATA})


def test_the_page_on_the_file_names_every_field(repository: Path) -> None:
    page = (repository / "docs" / "summary.md").read_text(encoding="utf-8")
    told = set(re.findall(r"`([a-zA-Z0-9_]+)`", page))
    for model in (Answer, FinalEstimate, Finding):
        assert set(model.model_fields) <= told, model.__name__
    keys = {key for key in findings(found_of(np.diag(SD**2))) if not key.startswith("principal_a")}
    assert keys <= told


def test_the_squares_of_a_budget_add_up_to_those_of_its_deviation() -> None:
    P = covariance()
    share = np.random.default_rng(3).uniform(0.2, 0.8)
    unseen = np.zeros((20, 20))
    parts = {"noise": share * P, "calibration": (1.0 - share) * P, "mount": unseen}
    told = findings(replace(found_of(P), budget=parts))
    stated = {name: each for name, each in told.items() if each.sd is not None}
    assert "range_m" in stated and "momentum_direction_world" in stated
    for each in stated.values():
        assert each.budget is not None and each.sd is not None
        assert list(each.budget) == ["noise", "calibration"]
        squares = np.sum(np.square(list(each.budget.values())), axis=0)
        assert squares == pytest.approx(np.square(each.sd), rel=1e-9)
    assert findings(found_of(P))["range_m"].budget is None
