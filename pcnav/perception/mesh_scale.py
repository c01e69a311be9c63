"""Whether the target is larger or smaller than its mesh, told from frames.

A mesh that is one per cent too large has its outline where a nearer target would have it, and its
faces at other distances from each other: ranges and outline then contradict each other by far more
than either errs, in all frames alike. Poses that fit both halfway are wrong by both.
"""

from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.camera import pixel_rays
from pcnav.perception.modality import POSE_SIZE, SeenFrame
from pcnav.perception.sensor_noise import OUTLINE_PRIOR_SD_PX

_N_OFFSETS = 4
_LOOSE = 0.05
"""A pose found is off by less than this share of the target, or rad."""
_FRAMES_ALIKE = 2.0
"""Errors of successive frames are alike: two tell as much as one."""
_MIN_FRAMES, _MAX_COMMON = 6, 20
"""A model that is wrong is so in all frames: so many together are no surer of it than one."""
_EXACT = 3e-4
"""A mesh is right to this share of itself."""
_CLEAR_ODDS = 9.0
"""Logarithm of the odds for another scale at which it is taken: 8,000 to one."""


@dataclass(frozen=True)
class ScaleBelief:
    """What the frames so far tell of the offsets of the outline, which look alike, and of the
    scale."""

    sd: float
    """How far the scale may be off, one standard deviation; 0 for a mesh that is right."""
    information: FloatArray = field(default_factory=lambda: np.zeros((5, 5)))
    """(5, 5) of the offsets in units of their prior deviation and of the scale, without priors."""
    vector: FloatArray = field(default_factory=lambda: np.zeros(5))
    frames: int = 0

    def with_frame(self, seen: SeenFrame, faces: Collection[int], lever_m: float) -> "ScaleBelief":
        """Take in a frame that was compared with the target as its mesh has it.

        Args:
            seen: frame and view.
            faces: places in the catalogue of the faces that were used.
            lever_m: half the target's diameter.
        """
        told = _of_ranges(seen, faces) + _of_outline(seen)
        loose = np.repeat([lever_m, 1.0], 3) * _LOOSE
        inner = told[:POSE_SIZE, :POSE_SIZE] + np.diag(1.0 / loose**2)
        cross = told[:POSE_SIZE, POSE_SIZE:]
        kept = told[POSE_SIZE:, POSE_SIZE:] - cross.T @ np.linalg.solve(inner, cross)
        return replace(
            self,
            information=self.information + kept[:-1, :-1] / _FRAMES_ALIKE,
            vector=self.vector + kept[:-1, -1] / _FRAMES_ALIKE,
            frames=self.frames + 1,
        )

    @property
    def factor(self) -> float:
        """By which the mesh is to be enlarged; 1 while that is not clear."""
        if self.frames < _MIN_FRAMES or self.sd == 0.0:
            return 1.0
        prior = np.append(np.ones(_N_OFFSETS), 1.0 / self.sd**2)
        covariance = np.linalg.inv(self.information + np.diag(prior))
        scale = float((covariance @ self.vector)[-1])
        # What the frames alone say, so that it can be told which prior it suits.
        told = 1.0 / max(1.0 / float(covariance[-1, -1]) - prior[-1], 1e-12)
        told_scale = scale * told / float(covariance[-1, -1])
        told *= min(self.frames, _MAX_COMMON)
        none, some = told + _EXACT**2, told + self.sd**2
        odds = 0.5 * (told_scale**2 * (1.0 / none - 1.0 / some) - np.log(some / none))
        return 1.0 + scale if odds > _CLEAR_ODDS else 1.0


def _of_ranges(seen: SeenFrame, faces: Collection[int]) -> FloatArray:
    """(12, 12) products of what ranges say by pose, offsets, scale, and their residuals."""
    residuals, rendered = seen.residuals, seen.rendered
    chosen = residuals.agrees & np.isin(residuals.face, list(faces))
    window, inside = rendered.window, residuals.inside
    rays = pixel_rays(rendered.camera)[window][inside][chosen]
    p_cam = rays * rendered.depth_m[window][inside][chosen].astype(np.float64)[:, None]
    jacobian = residuals.jacobian[chosen]
    sigma_m = np.broadcast_to(residuals.sigma_m, residuals.agrees.shape)[chosen]
    misfit = {face: max(fit.chi_square_per_dof, 1.0) for face, fit in seen.ranges.items()}
    loosened = np.array([misfit.get(face, 1.0) for face in residuals.face[chosen].tolist()])
    rows = np.column_stack(
        [
            jacobian,
            np.zeros((len(jacobian), _N_OFFSETS)),
            seen.doubt.by_scale(jacobian, p_cam),
            residuals.residual_m[chosen],
        ]
    )
    weighted = rows / (sigma_m**2 * loosened)[:, None]
    return np.asarray(rows.T @ weighted)


def _of_outline(seen: SeenFrame) -> FloatArray:
    """(12, 12) the same of the outline."""
    runs = seen.contour
    value = runs.value + runs.shared @ np.array(seen.noise.outline_offset_px)
    shared = runs.shared * OUTLINE_PRIOR_SD_PX
    rows = np.column_stack([runs.jacobian, shared, runs.by_scale, value])
    return np.asarray(rows.T @ (rows / runs.variance[:, None]))
