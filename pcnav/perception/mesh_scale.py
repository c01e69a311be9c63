"""Whether the target is larger or smaller than its mesh, told from frames.

A mesh that is one per cent too large has its outline where a nearer target would have it, and its
faces at other distances from each other: ranges and outline then contradict each other by far more
than either errs, in all frames alike. Poses that fit both halfway are wrong by both.
"""

from collections.abc import Collection
from dataclasses import dataclass, field, replace

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.perception.calibration_doubt import N_OFFSETS, CalibrationDoubt, calibration_doubt
from pcnav.perception.calibration_fields import FIELD_NAMES, by_fields
from pcnav.perception.modality import POSE_SIZE, SeenFrame
from pcnav.perception.sensor_noise import OUTLINE_PRIOR_SD_PX

_N_FIELDS = len(FIELD_NAMES)
_SIZE = N_OFFSETS + _N_FIELDS
_LOOSE = 0.05
"""A pose found is off by less than this share of the target, or rad; the motion during a frame that
takes time, by less than that in a second."""
_FRAMES_ALIKE = 2.0
"""Errors of successive frames are alike: two tell as much as one."""
_MIN_FRAMES, _MAX_COMMON = 6, 20
"""A model that is wrong is so in all frames: so many together are no surer of it than one."""
_EXACT = 3e-4
"""A mesh is right to this share of itself."""
_NONE = 1e-9
"""An error that is not there is known so well."""
_CLEAR_ODDS = 9.0
"""Logarithm of the odds for another scale at which it is taken: 8,000 to one."""


@dataclass(frozen=True)
class ScaleBelief:
    """What the frames so far tell of the offsets of the outline, and of errors of the calibration,
    which look alike: of the scale among them."""

    sd: float
    """How far the scale may be off, one standard deviation; 0 for a mesh that is right."""
    information: FloatArray = field(default_factory=lambda: np.zeros((_SIZE, _SIZE)))
    """(10, 10) of the offsets in units of their prior deviation and of the errors that
    `pcnav.perception.calibration_fields` has the fields of, the scale last; without priors."""
    vector: FloatArray = field(default_factory=lambda: np.zeros(_SIZE))
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
        if seen.residuals.time_s is not None:
            loose = np.tile(loose, 2)
        n = len(loose)
        inner = told[:n, :n] + np.diag(1.0 / loose**2)
        cross = told[:n, n:]
        kept = told[n:, n:] - cross.T @ np.linalg.solve(inner, cross)
        return replace(
            self,
            information=self.information + kept[:-1, :-1] / _FRAMES_ALIKE,
            vector=self.vector + kept[:-1, -1] / _FRAMES_ALIKE,
            frames=self.frames + 1,
        )

    def factor(self, calibration_sd: FloatArray) -> float:
        """By which the mesh is to be enlarged; 1 while that is not clear.

        ``calibration_sd`` (6,) are the deviations of the errors that may be there besides.
        """
        if self.frames < _MIN_FRAMES or self.sd == 0.0:
            return 1.0
        scale, variance = self._told(calibration_sd)
        alone = self._told(np.zeros(_N_FIELDS))[1]
        # An error of the calibration is no more likely for being seen in many frames.
        told = variance + (min(self.frames, _MAX_COMMON) - 1) * alone
        none, some = told + _EXACT**2, told + self.sd**2
        odds = 0.5 * (scale**2 * (1.0 / none - 1.0 / some) - np.log(some / none))
        return 1.0 + scale * self.sd**2 / (self.sd**2 + variance) if odds > _CLEAR_ODDS else 1.0

    def sd_left(self, calibration_sd: FloatArray) -> float:
        """How far the scale may still be off once the mesh is enlarged."""
        told = self._told(calibration_sd)[1]
        return float(self.sd * np.sqrt(told / (told + self.sd**2)))

    def doubt(self, calibration_sd: FloatArray) -> CalibrationDoubt | None:
        """The error of the calibration that explains best what its deviations (6,) leave
        unexplained; None of few frames."""
        if self.frames < _MIN_FRAMES:
            return None
        together = min(self.frames, _MAX_COMMON)
        return calibration_doubt(self.information, self.vector, together, calibration_sd)

    def _told(self, calibration_sd: FloatArray) -> tuple[float, float]:
        """The scale and its variance by the frames alone, where other errors may be so large."""
        sd = np.concatenate([np.ones(N_OFFSETS), np.maximum(calibration_sd[:-1], _NONE), [self.sd]])
        covariance = np.linalg.inv(self.information + np.diag(sd**-2.0))
        scale, variance = float((covariance @ self.vector)[-1]), float(covariance[-1, -1])
        told = 1.0 / max(1.0 / variance - self.sd**-2.0, 1e-12)
        return scale * told / variance, told


def _of_ranges(seen: SeenFrame, faces: Collection[int]) -> FloatArray:
    """(17, 17) products of what ranges say by pose, offsets, errors of the calibration, and their
    residuals; (23, 23) by pose and twist where the frame takes time."""
    residuals, rendered = seen.residuals, seen.rendered
    # The last place is that of faces that are in no catalogue.
    is_used = np.zeros(int(residuals.face.max(initial=-1)) + 2, dtype=np.bool_)
    is_used[[face for face in faces if -1 <= face < len(is_used) - 1]] = True
    chosen = np.flatnonzero(residuals.agrees & is_used[residuals.face])
    rows_of, columns_of = (part[chosen] for part in residuals.pixels)
    rays = rendered.rays[rendered.window][rows_of, columns_of]
    depth_m = rendered.depth_m[rendered.window][rows_of, columns_of]
    p_cam = rays * depth_m.astype(np.float64)[:, None]
    jacobian = residuals.jacobian[chosen]
    sigma_m = np.broadcast_to(residuals.sigma_m, residuals.agrees.shape)[chosen]
    of_face = np.ones(int(residuals.face.max(initial=0)) + 1)
    for face, fit in seen.ranges.items():
        of_face[face] = max(fit.chi_square_per_dof, 1.0)
    loosened = of_face[residuals.face[chosen]]
    time_s = residuals.time_s
    by_twist = np.empty((len(jacobian), 0))
    if time_s is not None:
        by_twist = time_s[chosen, None] * jacobian
    rows = np.column_stack(
        [
            jacobian,
            by_twist,
            np.zeros((len(jacobian), N_OFFSETS)),
            by_fields(jacobian, p_cam, seen.doubt.T_cam_model),
            residuals.residual_m[chosen],
        ]
    )
    weighted = rows / (sigma_m**2 * loosened)[:, None]
    return np.asarray(rows.T @ weighted)


def _of_outline(seen: SeenFrame) -> FloatArray:
    """(17, 17) the same of the outline."""
    runs = seen.contour
    value = runs.value + runs.shared @ np.array(seen.noise.outline_offset_px)
    shared = runs.shared * OUTLINE_PRIOR_SD_PX
    by_twist = np.empty((len(runs), 0))
    if seen.residuals.time_s is not None:
        # Beams in no order show no outline, and have no times of its own.
        by_twist = runs.by_twist if runs.by_twist.size else np.zeros((len(runs), POSE_SIZE))
    rows = np.column_stack([runs.jacobian, by_twist, shared, runs.by_fields, value])
    return np.asarray(rows.T @ (rows / runs.variance[:, None]))
