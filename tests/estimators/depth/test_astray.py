"""What unexplained frames add to a covariance."""

import numpy as np
import pytest

from pcnav.dynamics.state import R_HILL, STATE_SIZE, THETA_BODY, V_HILL
from pcnav.estimators.depth.astray import Astray
from pcnav.perception.agreement import Agreement

DIAMETER_M, STEP_S = 10.0, 0.5


def after(astray: Astray, agreement: Agreement | None, step_s: float = STEP_S) -> Astray:
    return astray.after(agreement, 0.0, step_s, DIAMETER_M)


SEEN_THROUGH = Agreement(agree=30, conflict=170, seen_through=60)


def test_a_step_adds_what_poses_are_linked_over() -> None:
    for step_s in (0.1, 2.0):
        P = after(Astray(), SEEN_THROUGH, step_s).covariance
        assert np.sqrt(np.diag(P[R_HILL, R_HILL])) == pytest.approx(3 * [3.0])
        assert np.sqrt(np.diag(P[THETA_BODY, THETA_BODY])) == pytest.approx(3 * [0.5])
        # White acceleration: the speed is by sqrt(3) what the way over the time is.
        assert np.sqrt(np.diag(P[V_HILL, V_HILL])) == pytest.approx(
            3 * [np.sqrt(3.0) * 3.0 / step_s]
        )


def test_it_goes_on_with_the_motion_and_adds_up() -> None:
    once = after(Astray(), SEEN_THROUGH)
    transition = np.eye(STATE_SIZE)
    transition[R_HILL, V_HILL] = STEP_S * np.eye(3)
    later = once.predicted(transition)
    # x + v t of perfectly known moments: the third power of the time, 2^3 for twice as long.
    twice = after(later, SEEN_THROUGH)
    place = np.diag(twice.covariance[R_HILL, R_HILL])
    assert place == pytest.approx(8.0 * np.diag(once.covariance[R_HILL, R_HILL]))


@pytest.mark.parametrize(
    "agreement",
    [
        None,
        # Something stands before the target.
        Agreement(agree=0, conflict=200, hidden=200, seen_through=0),
        # Half of a sensor's returns are false.
        Agreement(agree=100, conflict=100, seen_through=5),
    ],
)
def test_frames_that_say_nothing_against_the_motion_add_nothing(
    agreement: Agreement | None,
) -> None:
    assert not after(Astray(), agreement).covariance.any()
