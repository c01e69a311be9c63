"""What the evidence of a face owes to how the target was taken to move while the frame was taken.

A return seen a time t after that of the frame lies where the pose moved by t times the rate has it:
its residual changes by the rate t times as much as by the pose. A rate that is off is taken for a
pose that is off, by what this says.
"""

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.perception.correlated_ranges import face_field, range_evidence
from pcnav.perception.face_evidence import WITHOUT_RANGES, FaceEvidence
from pcnav.perception.modality import POSE_SIZE, SeenFrame


def evidence_of_twist(seen: SeenFrame, face: FaceEvidence) -> FloatArray:
    """(6 + k, 6) what a unit error of the target's twist adds to the vector of the evidence of a
    face, of the pose and of k errors that the frame shares.

    The twist is the rate of the pose: of the model origin (m/s, camera axes) and rotation (rad/s,
    model axes).
    """
    return _of_ranges(seen, face.place) + _of_outline(seen, face.place, len(face.joint.vector))


def _of_ranges(seen: SeenFrame, place: int) -> FloatArray:
    residuals, noise = seen.residuals, seen.noise
    fit = seen.ranges.get(place)
    if fit is None or residuals.time_s is None:
        return np.zeros((POSE_SIZE + noise.n_shared, POSE_SIZE))
    chosen = residuals.agrees & (residuals.face == place)
    H = residuals.jacobian[chosen]
    if isinstance(residuals.sigma_m, np.ndarray):
        own = residuals.sigma_m[chosen]
        H = H * (np.sqrt(np.mean(own**2)) / own)[:, None]
    by_twist = residuals.time_s[chosen, None] * H
    field = face_field(residuals.u[chosen], residuals.v[chosen])
    return range_evidence(H, by_twist, field, fit.variance_m2, noise).evidence.vector


def _of_outline(seen: SeenFrame, place: int, size: int) -> FloatArray:
    runs, noise = seen.contour, seen.noise
    if not runs.by_twist.size:
        return np.zeros((size, POSE_SIZE))
    of_face = seen.face_of_triangle[runs.triangle]
    without = place == WITHOUT_RANGES
    used = ~np.isin(of_face, list(seen.ranges)) if without else of_face == place
    H = runs.by_pose_and_shared(noise)
    return np.asarray((H[used] / runs.variance[used, None]).T @ runs.by_twist[used])
