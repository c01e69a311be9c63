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


def by_fields(jacobian: FloatArray, p_cam: FloatArray, T_cam_model: FloatArray) -> FloatArray:
    """(n, 6) by how much quantities change by unit errors: of points of the target (n, 3), by whose
    shift a quantity changes as the first three columns of its derivative (n, 6) by the pose say.

    Errors of the focal length and of both scales displace a point by a share of itself, those of
    the principal point are angles, in units of the focal length, that of the range is in m. A
    z-depth does not depend on where its pixel looks.

    Args:
        jacobian: of the quantities.
        p_cam: camera axes.
        T_cam_model: (4, 4) the pose of the model, which a larger target is larger about.
    """
    (a, b, c), (x, y, z) = jacobian[:, :3].T, p_cam.T
    fields = np.empty((len(p_cam), len(FIELD_NAMES)))
    fields[:, 0] = a * x + b * y
    fields[:, 1], fields[:, 2] = a * z, b * z
    along = fields[:, 0] + c * z
    fields[:, 3] = along / np.sqrt(x * x + y * y + z * z)
    fields[:, 4] = along
    fields[:, 5] = along - jacobian[:, :3] @ T_cam_model[:3, 3]
    return fields
