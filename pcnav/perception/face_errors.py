"""How far the faces of a frame are off their places, by how they contradict each other.

Each face shows its offset and its tilts in the image, to its white noise. One pose displaces them
all; what is left has a spread that the white noise does not explain. Levels of it on a grid are
weighed by the likelihood of all faces together, the pose and the offsets that they share being
anything (restricted maximum likelihood, Patterson and Thompson 1971): neither an error of the pose
nor one of the filter or the outline is taken for one of the faces.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from scipy.special import logsumexp

from pcnav.core.arrays import FloatArray
from pcnav.perception.correlated_ranges import face_field, steepness_of
from pcnav.perception.modality import POSE_SIZE, Evidence, SeenFrame
from pcnav.perception.sensor_noise import SensorNoise

_LEVELS = np.concatenate([[0.0], np.geomspace(3e-5, 0.1, 13)])
"""Deviations of offset and tilt, over half the target's diameter."""
_LOOSE = 0.05
"""A pose found is off by less than this share of the target, or rad."""
_PRIOR_ODDS = np.log(1.0 / 30.0)
"""Most faces are as the model has them."""
_FRAMES_ALIKE = 2.0
"""Errors of successive frames are alike: two tell as much as one."""
_MEMORY = 0.98
_TERMS = 3


@dataclass(frozen=True)
class FaceErrors:
    """What frames tell of the offsets and tilts of faces."""

    lever_m: float
    """Half the target's diameter."""
    log_likelihood: FloatArray = field(default_factory=lambda: np.zeros((len(_LEVELS),) * 2))
    """By the level of the offset, and that of the tilts."""

    def with_frame(self, seen: SeenFrame) -> "FaceErrors":
        """Take in a compared frame."""
        if len(seen.ranges) < 2:
            return self
        H, y, white_m2, steepness = face_terms(seen)
        levels_m2 = (_LEVELS * self.lever_m) ** 2
        offset, tilt = (part.ravel() for part in np.meshgrid(levels_m2, levels_m2, indexing="ij"))
        spread = np.stack([offset, tilt, tilt], axis=1)
        # (levels, faces, terms)
        weight = 1.0 / (white_m2[:, None] + steepness[:, None] ** 2 * spread[:, None])
        size = H.shape[-1]
        products = np.einsum("kti,ktj->ktij", H, H).reshape(-1, size * size)
        flat = weight.reshape(len(weight), -1)
        information = (flat @ products).reshape(-1, size, size)
        information += np.diag(known_beforehand(size, self.lever_m, seen.noise))
        vector = flat @ (H * y[..., None]).reshape(-1, size)
        solved = np.linalg.solve(information, vector[..., None])[..., 0]
        squares = flat @ np.square(y).ravel() - np.sum(vector * solved, axis=1)
        log_det = np.linalg.slogdet(information)[1] - np.sum(np.log(flat), axis=1)
        new = -0.5 * (squares + log_det).reshape(self.log_likelihood.shape) / _FRAMES_ALIKE
        total = _MEMORY * self.log_likelihood + new
        return replace(self, log_likelihood=total - total.max())

    def applied(self, noise: SensorNoise) -> SensorNoise:
        """The noise with what is believed of the faces."""
        log_weights = self.log_likelihood - np.log(self.log_likelihood.size)
        some = log_weights.copy()
        some[0, 0] = -np.inf
        if float(logsumexp(some)) + _PRIOR_ODDS < self.log_likelihood[0, 0]:
            return replace(noise, face_sd_m=0.0, face_tilt_sd_m=0.0)
        weights = np.exp(some - logsumexp(some))
        offset, tilt = (self._level(weights.sum(axis=axis)) for axis in (1, 0))
        return replace(noise, face_sd_m=offset, face_tilt_sd_m=tilt)

    @property
    def possible(self) -> tuple[float, float]:
        """Root mean squares of offset and tilts, m, by all that is believed of them: levels that
        frames make unlikely, but do not rule out, count as far as they are likely."""
        some = self.log_likelihood - np.log(self.log_likelihood.size) + _PRIOR_ODDS
        some[0, 0] = self.log_likelihood[0, 0]
        weights = np.exp(some - logsumexp(some))
        squares = (_LEVELS * self.lever_m) ** 2
        offset, tilt = (float(np.sqrt(weights.sum(axis=axis) @ squares)) for axis in (1, 0))
        return offset, tilt

    def evidence(self, seen: SeenFrame) -> Evidence:
        """What the ranges of a frame say (6 + k), its faces erring as is believed."""
        size = POSE_SIZE + seen.noise.n_shared
        if not seen.ranges:
            return Evidence.together((), seen.noise.n_shared)
        H, y, white_m2, steepness = face_terms(seen)
        own = self.applied(seen.sensor_noise)
        sd = np.array([own.face_sd_m, own.face_tilt_sd_m, own.face_tilt_sd_m])
        variance = white_m2[:, None] + (steepness[:, None] * sd) ** 2
        return Evidence.of(y.ravel(), variance.ravel(), H.reshape(-1, size))

    def _level(self, weights: FloatArray) -> float:
        """The middle of what is likely; none where that is likelier than any."""
        if weights[0] > 0.5:
            return 0.0
        return self.lever_m * float(np.exp(weights[1:] @ np.log(_LEVELS[1:]) / weights[1:].sum()))


# The errors of faces, their memory and the outline beside them all ask for those of one frame.
@lru_cache(maxsize=1)
def face_terms(seen: SeenFrame) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Of the k faces that have ranges: derivatives (k, 3, 6 + s) of their offsets and tilts by the
    pose and the shared errors, what they measure (k, 3), the variance (k,) of each by white noise
    and the facets of a round mesh, and how steep they are."""
    residuals, noise = seen.residuals, seen.noise
    facets_m2 = noise.face_sd_m**2 - seen.sensor_noise.face_sd_m**2
    rows, values, variances, steepness = [], [], [], []
    for face, fit in seen.ranges.items():
        chosen = np.flatnonzero(residuals.agrees & (residuals.face == face))
        basis = face_field(residuals.u[chosen], residuals.v[chosen]).T / fit.n_pixels
        shared = np.zeros((_TERMS, noise.n_shared))
        shared[:1, :1] = noise.frame_unit_m
        rows.append(np.hstack([basis @ residuals.jacobian[chosen], shared]))
        values.append(basis @ residuals.residual_m[chosen])
        steep = steepness_of(residuals.jacobian[chosen])
        variances.append(fit.variance_m2 / fit.n_pixels + facets_m2 * steep**2)
        steepness.append(steep)
    return np.stack(rows), np.stack(values), np.array(variances), np.array(steepness)


def known_beforehand(size: int, lever_m: float, noise: SensorNoise) -> FloatArray:
    """(6 + k) information of a pose that was found and of the errors that are shared.

    The offset of the frame may be anything that an error of the pose may be: whether there is one
    is asked elsewhere, and until it is known none may pass for an error of faces or of the outline.
    """
    known = np.ones(size)
    known[:3], known[3:POSE_SIZE] = (_LOOSE * lever_m) ** -2.0, _LOOSE**-2.0
    known[POSE_SIZE : POSE_SIZE + 1] = (noise.frame_unit_m / (_LOOSE * lever_m)) ** 2
    return known
