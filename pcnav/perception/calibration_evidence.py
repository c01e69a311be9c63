"""What pose errors of the calibration are taken for in a frame, by the evidence of its faces."""

from collections.abc import Collection

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.perception.calibration_fields import FIELD_NAMES, by_fields
from pcnav.perception.correlated_ranges import face_field, range_evidence
from pcnav.perception.face_evidence import WITHOUT_RANGES
from pcnav.perception.modality import POSE_SIZE, SeenFrame


def evidence_of_fields(seen: SeenFrame, faces: Collection[int]) -> FloatArray:
    """(6 + k, 6) what unit errors add to the vector of the evidence of some faces of a frame, of
    the pose and of k errors that the frame shares."""
    return _of_ranges(seen, faces) + _of_outline(seen, faces)


def _of_ranges(seen: SeenFrame, faces: Collection[int]) -> FloatArray:
    residuals, rendered, noise = seen.residuals, seen.rendered, seen.noise
    window, pixels = rendered.window, residuals.pixels
    total = np.zeros((POSE_SIZE + noise.n_shared, len(FIELD_NAMES)))
    rays, depth_m = rendered.rays[window][pixels], rendered.depth_m[window][pixels]
    for face, fit in seen.ranges.items():
        if face not in faces:
            continue
        chosen = residuals.agrees & (residuals.face == face)
        p_cam = rays[chosen] * depth_m[chosen].astype(np.float64)[:, None]
        H = residuals.jacobian[chosen]
        moved = by_fields(H, p_cam, seen.doubt.T_cam_model)
        if isinstance(residuals.sigma_m, np.ndarray):
            own = residuals.sigma_m[chosen]
            weight = (np.sqrt(np.mean(own**2)) / own)[:, None]
            H, moved = H * weight, moved * weight
        field = face_field(residuals.u[chosen], residuals.v[chosen])
        total += range_evidence(H, moved, field, fit.variance_m2, noise).evidence.vector
    return total


def _of_outline(seen: SeenFrame, faces: Collection[int]) -> FloatArray:
    runs, noise = seen.contour, seen.noise
    of_face = seen.face_of_triangle[runs.triangle]
    used = np.isin(of_face, list(faces))
    if WITHOUT_RANGES in faces:
        used |= ~np.isin(of_face, list(seen.ranges))
    H = runs.by_pose_and_shared(noise)
    return np.asarray((H[used] / runs.variance[used, None]).T @ runs.by_fields[used])
