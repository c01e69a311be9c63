"""How far the outline of each part is seen off its place, by how it contradicts itself and ranges.

One pose, and what all stretches share, displaces them; what is left has a spread that the pixel
grid does not explain. Levels of it on a grid are weighed by the likelihood of all stretches of a
frame together, the pose being what the ranges leave it (restricted maximum likelihood). Where
outline and ranges contradict each other it is the outline that errs: what a pixel at a rim shows
depends on more than where the rim is, and errors of faces show without it.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import logsumexp

from pcnav.core.arrays import FloatArray
from pcnav.perception.contour import ContourRuns
from pcnav.perception.face_errors import known_beforehand
from pcnav.perception.modality import Evidence
from pcnav.perception.sensor_noise import SensorNoise

_LEVELS_PX = np.concatenate([[0.0], np.geomspace(0.03, 3.0, 12)])
_PRIOR_ODDS = np.log(1.0 / 30.0)
"""Most outlines lie where pixels are covered."""
_FRAMES_ALIKE = 2.0
"""Errors of successive frames are alike: two tell as much as one."""
_MEMORY = 0.98


@dataclass(frozen=True)
class OutlineScatter:
    """What frames tell of it."""

    lever_m: float
    """Half the target's diameter."""
    log_likelihood: FloatArray = field(default_factory=lambda: np.zeros(len(_LEVELS_PX)))
    """By level."""

    def with_frame(
        self, runs: ContourRuns, noise: SensorNoise, ranges: Evidence, facets_px2: float = 0.0
    ) -> "OutlineScatter":
        """Take in the outline of a frame, measured under a noise, beside what its ranges say.

        ``facets_px2``: variance by the facets of a round mesh, which is not the sensor's.
        """
        H, size = runs.by_pose_and_shared(noise), len(ranges.vector)
        if len(runs) <= size:
            return self
        known = ranges.information + np.diag(known_beforehand(size, self.lever_m, noise))
        levels_px2 = _LEVELS_PX[:, None] ** 2 + facets_px2
        weight = 1.0 / (runs.own_variance + levels_px2 * runs.by_scatter)
        products = np.einsum("ni,nj->nij", H, H).reshape(-1, size * size)
        information = (weight @ products).reshape(-1, size, size) + known
        vector = weight @ (H * runs.value[:, None]) + ranges.vector
        solved = np.linalg.solve(information, vector[..., None])[..., 0]
        squares = weight @ runs.value**2 - np.sum(vector * solved, axis=1)
        log_det = np.linalg.slogdet(information)[1] - np.sum(np.log(weight), axis=1)
        total = _MEMORY * self.log_likelihood - 0.5 * (squares + log_det) / _FRAMES_ALIKE
        return replace(self, log_likelihood=total - total.max())

    def applied(self, noise: SensorNoise) -> SensorNoise:
        """The noise with what is believed of the outline."""
        some = self.log_likelihood[1:] - np.log(len(_LEVELS_PX) - 1)
        total = float(logsumexp(some))
        if total + _PRIOR_ODDS < self.log_likelihood[0]:
            return replace(noise, outline_sd_px=0.0)
        middle = np.exp(np.exp(some - total) @ np.log(_LEVELS_PX[1:]))
        return replace(noise, outline_sd_px=float(middle))
