"""Errors of faces and outline that last from frame to frame, which no mean over frames makes less.

A face that lies elsewhere than the model has it, or whose returns take a longer way, is off by as
much in the next frame. How much of what faces err by lasts is learnt from what each is off by
beyond what one pose explains, in successive frames: the frames' poses, the filter and its motion
have no part in it. As long as little is known of that, all of it is taken to last.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.perception.face_errors import face_terms, known_beforehand
from pcnav.perception.face_evidence import moved_by_field, unweighed_deviations
from pcnav.perception.modality import POSE_SIZE, Evidence, SeenFrame
from pcnav.perception.render_compare import Comparison
from pcnav.perception.sensor_noise import SensorNoise

_FACES_BEFOREHAND = 3.0
"""Faces in two successive frames whose errors last; so much is believed before any frame."""
_MEMORY = 0.98


@dataclass(frozen=True)
class FaceMemory:
    """By how much the offset of a face is like that of the frame before."""

    lever_m: float
    """Half the target's diameter."""
    alike: float = _FACES_BEFOREHAND
    """Sum of products of offsets in two successive frames, over their variances,"""
    power: float = _FACES_BEFOREHAND
    """and of their mean squares, but for what is white noise."""
    last: Mapping[int, float] = field(default_factory=dict)
    """By face."""

    @property
    def correlation(self) -> float:
        """Of the errors of a face in successive frames."""
        return float(np.clip(self.alike / self.power, 0.0, 1.0))

    def with_frame(self, seen: SeenFrame) -> "FaceMemory":
        """Take in a compared frame of a sensor whose faces err."""
        if not seen.sensor_noise.has_face_errors or len(seen.ranges) < 2:
            return replace(self, last={}) if self.last else self
        return self.with_offsets(*_offsets(seen, self.lever_m))

    def with_offsets(
        self, off: Mapping[int, float], correlated: Mapping[int, float]
    ) -> "FaceMemory":
        """Take in what each face of a frame is off by, in deviations, and the share of its variance
        that is no white noise."""
        both = [face for face in off if face in self.last and face >= 0]
        products = sum(off[face] * self.last[face] for face in both)
        squares = sum(
            0.5 * correlated[face] * (off[face] ** 2 + self.last[face] ** 2) for face in both
        )
        return replace(
            self,
            alike=_MEMORY * self.alike + products,
            power=_MEMORY * self.power + squares,
            last=off,
        )


def _offsets(seen: SeenFrame, lever_m: float) -> tuple[dict[int, float], dict[int, float]]:
    """By face, what its offset is off by in deviations, one pose being taken off all of them; and
    how much of its variance is no white noise."""
    H, y, white_m2, steepness = face_terms(seen)
    noise = seen.sensor_noise
    sd = np.array([noise.face_sd_m, noise.face_tilt_sd_m, noise.face_tilt_sd_m])
    own = (steepness[:, None] * sd) ** 2
    variance = own + white_m2[:, None]
    size = H.shape[-1]
    together = Evidence.of(y.ravel(), variance.ravel(), H.reshape(-1, size))
    known = np.diag(known_beforehand(size, lever_m, seen.noise))
    pose = np.linalg.solve(together.information + known, together.vector)
    off = (y[:, 0] - H[:, 0] @ pose) / np.sqrt(variance[:, 0])
    share = own[:, 0] / variance[:, 0]
    faces = list(seen.ranges)
    return (
        dict(zip(faces, off.tolist(), strict=True)),
        dict(zip(faces, share.tolist(), strict=True)),
    )


def lasting_part(comparison: Comparison, used: Sequence[bool]) -> FloatArray:
    """(6 + k, 6 + k) covariance of what errors of faces and outline add to the vector of a frame's
    evidence of the pose and of the errors that it shares.

    Errors that last have a mean over the faces as well, of which no frame shows anything: it is as
    large as they are. ``used`` says which of the compared faces are.
    """
    seen, noise = comparison.seen, comparison.seen.noise
    size = POSE_SIZE + noise.n_shared
    covariance, mean = np.zeros((size, size)), np.zeros(size)
    places = comparison.places(used)
    for face, fit in seen.ranges.items():
        if face in places and fit.by_field is not None:
            covariance += fit.by_field.T @ fit.by_field
            mean += fit.by_field[0]
    covariance += np.outer(mean, mean)
    if noise.outline_sd_px > 0.0:
        covariance += _of_outline(seen)
    return covariance


def unweighed_parts(
    comparison: Comparison, used: Sequence[bool], noise: SensorNoise
) -> tuple[FloatArray, FloatArray]:
    """(6 + k, 6 + k) each as `lasting_part`, of errors of faces and of a frame that ranges are
    not weighed by: nothing of them is in the information that the frame was taken to have.

    ``noise`` says how large they are, as it is known by now.
    """
    seen, n_shared = comparison.seen, comparison.seen.noise.n_shared
    size = POSE_SIZE + n_shared
    of_faces, of_frame = np.zeros((size, size)), np.zeros(size)
    if not noise.has_unweighed_errors:
        return of_faces, np.outer(of_frame, of_frame)
    sd, places = unweighed_deviations(noise), comparison.places(used)
    for face in seen.ranges:
        if face in places:
            by_field, steepness = moved_by_field(seen, face)
            of_frame += by_field[0] * noise.unweighed_frame_sd_m
            by_field *= (sd * steepness)[:, None]
            of_faces += by_field.T @ by_field
    return of_faces, np.outer(of_frame, of_frame)


def _of_outline(seen: SeenFrame) -> FloatArray:
    runs, noise = seen.contour, seen.noise
    H = runs.by_pose_and_shared(noise)
    weight = noise.outline_sd_px * np.sqrt(runs.by_scatter) / runs.variance
    return np.asarray((H * weight[:, None]).T @ (H * weight[:, None]))
