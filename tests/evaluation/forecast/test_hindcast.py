"""A run's own earlier estimates: they foretell its last ones, unless it follows a wrong motion."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT
from pcnav.dynamics.trajectory import Trajectory
from pcnav.evaluation.forecast.hindcast import hindcast
from pcnav.report.forecast import hindcast_sentence
from pcnav.runs.run import Run
from tests.evaluation.forecast.independent import Bodies, moved
from tests.evaluation.forecast.test_forecast import MEAN_MOTION, STATE, bodies, start_of

STEP_S = 0.5
SD = np.repeat([1e-3, 1e-4, 1e-3, 1e-3, 2e-5, 1e-3], [3, 3, 3, 3, 3, 5])


def followed(frames: int, torque_rad_s2: float = 0.0) -> Run:
    """As a free body, with errors as they are stated; a torque turns it by steps of its rate."""
    rng = np.random.default_rng(1)
    rows: dict[str, list[FloatArray]] = {block.name: [] for block in MASS_CENTRE_LAYOUT.blocks}
    body, _ = bodies(np.zeros((1, 20)))
    for _ in range(frames):
        error = rng.standard_normal(20) * SD
        values = {
            "r_hill": body.r[0] + error[:3],
            "v_hill": body.v[0] + error[3:6],
            "com_model": STATE.com_model + error[6:9],
            "theta_body": body.R_world_body[0] @ Rotation.from_rotvec(error[9:12]).as_matrix(),
            "omega_body": body.omega[0] + error[12:15],
            "inertia_ratios": STATE.inertia_ratios + error[15:],
        }
        for name, value in values.items():
            rows[name].append(value)
        body = moved(body, MEAN_MOTION, STEP_S)
        push = torque_rad_s2 * STEP_S * np.array([[1.0, 0.0, -1.0]])
        body = Bodies(body.r, body.v, body.R_world_body, body.omega + push, body.inertia)
    motion = Trajectory(
        STEP_S * np.arange(frames, dtype=np.float64),
        MASS_CENTRE_LAYOUT,
        {name: np.array(values) for name, values in rows.items()},
        covariance=np.tile(np.diag(SD**2), (frames, 1, 1)),
    )
    none = np.zeros(frames)
    status = ("locked",) * frames
    return Run("made", None, "depth", None, motion, status, none, none.astype(np.intp), none)


@pytest.mark.parametrize(("torque", "refuted"), [(0.0, False), (1e-3, True)])
def test_a_motion_that_is_not_as_it_is_followed_is_told(torque: float, refuted: bool) -> None:
    found = hindcast(followed(36, torque), start_of(SD), np.random.default_rng(0))
    assert found is not None and found.forecasts == 8
    assert found.span_s == 6.0
    assert found.is_refuted == refuted
    assert (found.held >= 6) != refuted
    assert hindcast_sentence(found).startswith("warning") == refuted


def test_what_is_short_or_moves_in_any_way_is_not_judged() -> None:
    start, rng = start_of(SD), np.random.default_rng(0)
    assert hindcast(followed(11), start, rng) is None
    run = followed(20)
    assert hindcast(run, replace(start, torque_free=False), rng) is None
    changed = replace(run, words={"motion": ("kinematic",) * 10 + ("torque_free",) * 10})
    assert hindcast(changed, start, rng) is None
