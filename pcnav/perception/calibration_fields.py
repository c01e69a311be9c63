"""What errors of the camera's calibration and of the mesh make of a frame.

Each displaces the points that a frame shows, in proportion to itself: by a field over space. A
field says how ranges change, by their slopes, and how the outline does, by its normals, just as a
displacement of the target does. So the evidence of a pose tells what pose each of them is taken
for.
"""

import numpy as np

from pcnav.core.arrays import FloatArray

FIELD_NAMES = (
    "focal length",
    "principal point",
    "principal point",
    "range offset",
    "range scale",
    "mesh scale",
)
"""What errs; the point across and down."""


def displacements(p_cam: FloatArray, T_cam_model: FloatArray) -> FloatArray:
    """(n, 3, 6) by which points (n, 3) seem displaced, m in camera axes, by unit errors.

    Those of the focal length and of both scales are shares of themselves, those of the principal
    point angles, in units of the focal length, that of the range in m. A z-depth does not depend
    on where its pixel looks.

    Args:
        p_cam: camera axes.
        T_cam_model: (4, 4) the pose of the model, which a larger target is larger about.
    """
    fields = np.zeros((len(p_cam), 3, len(FIELD_NAMES)))
    fields[:, :2, 0] = p_cam[:, :2]
    fields[:, 0, 1] = fields[:, 1, 2] = p_cam[:, 2]
    fields[:, :, 3] = p_cam / np.linalg.norm(p_cam, axis=1, keepdims=True)
    fields[:, :, 4] = p_cam
    fields[:, :, 5] = p_cam - T_cam_model[:3, 3]
    return fields


def by_fields(jacobian: FloatArray, p_cam: FloatArray, T_cam_model: FloatArray) -> FloatArray:
    """(n, 6) by how much quantities change by unit errors: of points of the target (n, 3), by whose
    shift a quantity changes as the first three columns of its derivative (n, 6) by the pose say."""
    moved = displacements(p_cam, T_cam_model)
    return np.asarray(np.einsum("ni,nik->nk", jacobian[:, :3], moved))
