"""What became of each rectangle seen: the rows of measurements.csv."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import transform_points, xyzw_from_rotation

ACCEPTED = "accepted"
"""The outcome of a rectangle that the filter used."""
POSE_COLUMNS = ("p_x_m", "p_y_m", "p_z_m", "q_x", "q_y", "q_z", "q_w")
SIZE_COLUMNS = ("length_m", "width_m")
RECORD_SD_COLUMNS = (
    *("sd_x_m", "sd_y_m", "sd_z_m"),
    *("sd_theta_x_rad", "sd_theta_y_rad", "sd_theta_z_rad"),
)
WORD_COLUMNS = ("rectangle", "case", "outcome", "worst_axis")
GATE_COLUMNS = ("squared_distance", "gate")
WORST_COLUMN = "worst_axis"
OLDER_COLUMNS = (
    *("time_s", "rectangle", *SIZE_COLUMNS),
    *(*POSE_COLUMNS, *RECORD_SD_COLUMNS, "case", "outcome"),
)
"""Of result folders up to release 0.1."""
MEASUREMENT_COLUMNS = (*OLDER_COLUMNS, *GATE_COLUMNS, WORST_COLUMN)
AXES = ("x", "y", "z", "theta_x", "theta_y", "theta_z")
"""Of a rectangle: shifts along its width, its length and its normal, and turns about them."""


@dataclass(frozen=True)
class RectangleRecord:
    """One rectangle seen in one frame and what became of it: a row of measurements.csv."""

    time_s: float
    rectangle: str
    """Name in the catalogue; empty when it was not recognised."""
    length_m: float
    width_m: float
    T_cam_rect: FloatArray
    """(4, 4) measured pose of the rectangle frame, the ambiguity resolved as `case` says."""
    sd: FloatArray
    """(6,) standard deviations in rectangle axes: x, y, z (m), rotation about x, y, z (rad).
    Infinite where the measurement says nothing."""
    case: str
    """Which of the four proper rotations was chosen: I, X, Y or Z; empty when undecided."""
    outcome: str
    """`accepted`, or the reason why it was not."""
    squared_distance: float = np.nan
    """From the prediction, squared, over the covariance of the innovation; nan where the filter
    was not asked."""
    gate: float = np.nan
    """What the squared distance of an accepted one stays below."""
    worst_axis: str = ""
    """One of `AXES`, along which it is farthest from what was rendered at the prediction, in
    standard deviations of its own; empty where it was not compared."""

    @property
    def corners_cam(self) -> FloatArray:
        """(4, 3) corners in the camera frame, m: x along the width, y along the length."""
        x, y = 0.5 * self.width_m, 0.5 * self.length_m
        p_rect = np.array([[-x, -y, 0.0], [x, -y, 0.0], [x, y, 0.0], [-x, y, 0.0]])
        return transform_points(self.T_cam_rect, p_rect)

    def row(self, pose: Sequence[float | str]) -> list[float | str]:
        """In the order of `MEASUREMENT_COLUMNS`, with its pose in that of `POSE_COLUMNS`."""
        return [
            *(float(self.time_s), self.rectangle, float(self.length_m), float(self.width_m)),
            *(pose or [""] * len(POSE_COLUMNS)),
            *(*self.sd.tolist(), self.case, self.outcome),
            *(
                "" if np.isnan(value) else float(value)
                for value in (self.squared_distance, self.gate)
            ),
            self.worst_axis,
        ]


def rows_of(records: Sequence[RectangleRecord]) -> Iterator[list[float | str]]:
    """Those of one frame, in the order of `MEASUREMENT_COLUMNS`."""
    poses = np.array([record.T_cam_rect for record in records]).reshape(-1, 4, 4)
    known = np.isfinite(poses).all(axis=(1, 2))
    # Quaternions of all at once: the call takes longer than the arithmetic.
    fields = np.full((len(poses), len(POSE_COLUMNS)), np.nan)
    fields[known, :3] = poses[known, :3, 3]
    fields[known, 3:] = xyzw_from_rotation(poses[known, :3, :3]) if known.any() else 0.0
    for record, pose, is_known in zip(records, fields.tolist(), known.tolist(), strict=True):
        yield record.row(pose if is_known else ())


def pose_fields(T: FloatArray) -> list[float]:
    """Position and scalar-last quaternion of a (4, 4) pose."""
    return [float(value) for value in (*T[:3, 3], *xyzw_from_rotation(T[:3, :3]))]
