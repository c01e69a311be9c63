"""How far a target may have gone that is not where its motion leads, while nobody finds it.

A frame that is seen through where the target is predicted, and in which it is found neither there
nor as near as a jolt may have moved it, says that the motion has failed. What the filter states of
it holds no longer; the target is as uncertain as it may have moved since the frame before.
"""

from dataclasses import dataclass, field

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import R_HILL, STATE_SIZE, THETA_BODY
from pcnav.estimators.depth.kinematic import LINKED, noise_by_density
from pcnav.perception.agreement import Agreement

_SEEN_THROUGH = 0.1
"""Share of the pixels in which a view is predicted or anything returned: what stands before a
target only hides it, and its motion goes on behind."""


@dataclass(frozen=True)
class Astray:
    """What unexplained frames since the last one that was taken in add to a covariance."""

    covariance: FloatArray = field(default_factory=lambda: np.zeros((STATE_SIZE, STATE_SIZE)))
    """(20, 20)"""

    def predicted(self, transition: FloatArray) -> "Astray":
        """After a prediction by (20, 20)."""
        return Astray(transition @ self.covariance @ transition.T)

    def after(
        self,
        agreement: Agreement | None,
        mean_motion_rad_s: float,
        step_s: float,
        diameter_m: float,
    ) -> "Astray":
        """After a frame in which nothing was found: ``agreement`` is that with the prediction, None
        where nothing was compared, and ``step_s`` the time since the frame before."""
        if agreement is None or not _contradicts(agreement) or step_s <= 0.0:
            return self
        by_translation, by_rotation = noise_by_density(mean_motion_rad_s, step_s)
        place, turn = (LINKED[0] * diameter_m) ** 2, LINKED[1] ** 2
        place_density = place / by_translation[R_HILL, R_HILL][0, 0]
        turn_density = turn / by_rotation[THETA_BODY, THETA_BODY][0, 0]
        moved = place_density * by_translation + turn_density * by_rotation
        return Astray(self.covariance + moved)


def _contradicts(agreement: Agreement) -> bool:
    pixels = agreement.agree + agreement.conflict
    return agreement.seen_through > _SEEN_THROUGH * pixels
