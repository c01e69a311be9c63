"""Whether frames contradict what is stated of the calibration, and which error would explain it.

Each error of the calibration displaces ranges and outline by a pattern of its own, which no pose
makes: a focal length tilts faces against each other across the image, an offset of the ranges lets
them recede from an outline that stays. What frames tell of each, were it the only one, is compared
with how large it is stated to be.
"""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.perception.calibration_fields import FIELD_NAMES

N_OFFSETS = 4
"""Offsets of the outline, which stand before the errors of the calibration."""
_MESH_SCALE = FIELD_NAMES.index("mesh scale")
"""Told otherwise: the target is then followed at the size that it has."""
CLEAR_SD = 4.0
"""Deviations of what frames and statement allow together: by chance one in 16,000."""


@dataclass(frozen=True)
class CalibrationDoubt:
    """The error of the calibration that explains the frames best."""

    name: str
    """One of `FIELD_NAMES`."""
    value: float
    """That it would have: a share, an angle in units of the focal length, or m."""
    sd: float
    """How large it is stated to be."""
    deviations: float
    """By how many deviations the frames contradict that."""

    @property
    def is_clear(self) -> bool:
        """Whether it is no chance."""
        return self.deviations > CLEAR_SD

    @property
    def said(self) -> str:
        """In one sentence."""
        off = f"{self.name} is off by {_size(self.name, self.value)}"
        stated = _size(self.name, self.sd)
        return (
            f"ranges and outline contradict each other in all frames as if the {off}, where "
            f"{stated} is stated or assumed ({self.deviations:.1f} deviations): the calibration "
            "or the mesh is not what it is taken for, and errors are larger than stated"
        )


def calibration_doubt(
    information: FloatArray, vector: FloatArray, frames_together: int, stated_sd: FloatArray
) -> CalibrationDoubt:
    """The best explanation by one error.

    Args:
        information: (10, 10) of the offsets of the outline, in units of their prior deviation, and
            of the six errors; without priors.
        vector: (10,)
        frames_together: that err alike, and are no surer than one.
        stated_sd: (6,) of the errors.
    """
    n = N_OFFSETS
    inner, cross = information[:n, :n] + np.eye(n), information[:n, n:]
    solved = np.linalg.solve(inner, np.column_stack([cross, vector[:n]]))
    own = np.diag(information)[n:] - np.sum(cross * solved[:, :-1], axis=0)
    told = vector[n:] - cross.T @ solved[:, -1]
    own = np.maximum(own, np.finfo(np.float64).tiny)
    value = told / own
    beyond = np.abs(value) / np.sqrt(frames_together / own + stated_sd**2)
    beyond[_MESH_SCALE] = 0.0
    k = int(np.argmax(beyond))
    return CalibrationDoubt(FIELD_NAMES[k], float(value[k]), float(stated_sd[k]), float(beyond[k]))


def _size(name: str, value: float) -> str:
    if name == "range offset":
        return f"{1e3 * abs(value):.2g} mm"
    if name == "principal point":
        return f"{1e3 * abs(value):.2g} mrad"
    return f"{1e2 * abs(value):.2g} %"
