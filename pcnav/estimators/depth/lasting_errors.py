"""What errors that last from frame to frame add to the covariance of a filter that takes them for
white noise.

They are considered, not estimated (Schmidt 1966): the filter's gains stay, and beside it goes the
covariance of its error with an error of the frames' poses that is correlated in time,
``u_k = c u_{k-1} + white``. The filter counts its variance in each frame; what it leaves out are
the products of different frames.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import STATE_SIZE
from pcnav.estimators.depth.calibration_errors import CalibrationErrors, SeenBy
from pcnav.estimators.depth.influence import influence_of
from pcnav.estimators.depth.measuring import Kalman
from pcnav.estimators.depth.pose_measurement import ObserverPose
from pcnav.perception.lasting_errors import lasting_part, unweighed_parts
from pcnav.perception.modality import POSE_SIZE
from pcnav.perception.sensor_noise import SensorNoise


@dataclass(frozen=True)
class Considered:
    """A filter of n states beside k errors of unit variance that it does not estimate."""

    added: FloatArray
    """(n, n) covariance of its error beyond its own."""
    by_error: FloatArray
    """(n, k) covariance of its error with the errors of the last frame."""

    @staticmethod
    def begun(moved: FloatArray, correlation: float, frames: int) -> "Considered":
        """Of a filter that a few frames began, each moved (n, k) by such errors."""
        share = 1.0 / frames
        lasting = correlation * (1.0 - share)
        return Considered(lasting * moved @ moved.T, (lasting + share) * moved)

    def with_own(self, moved: FloatArray) -> "Considered":
        """With the variance of a frame that the filter did not count."""
        return replace(self, added=self.added + moved @ moved.T)

    def predicted(self, transition: FloatArray) -> "Considered":
        """After a prediction by (n, n)."""
        return Considered(transition @ self.added @ transition.T, transition @ self.by_error)

    def updated(self, kept: FloatArray, moved: FloatArray, correlation: float) -> "Considered":
        """After an update.

        Args:
            kept: (n, n) of the error before, ``1 - K H``.
            moved: (n, k) by the errors of this frame.
            correlation: of these with those of the last frame.
        """
        before = correlation * kept @ self.by_error
        across = before @ moved.T
        return Considered(kept @ self.added @ kept.T + across + across.T, before + moved)


class LastingErrors:
    """Of one track."""

    def __init__(self, frames: int) -> None:
        """``frames`` that the track began with."""
        self._frames = frames
        self._kalman: Kalman | None = None
        none = Considered(np.zeros((STATE_SIZE, STATE_SIZE)), np.zeros((STATE_SIZE, POSE_SIZE)))
        self._parts: tuple[Considered, ...] = (none,) * 3
        """Of what the filter counts in each frame, and of what it does not: of faces, of frames."""
        self._of_calibration = CalibrationErrors()
        self._are_shown = True

    @property
    def covariance(self) -> FloatArray:
        """(20, 20) beyond the filter's own."""
        return self._of_surface + self._of_calibration.covariance

    @property
    def in_camera(self) -> FloatArray:
        """(20, 20) of it that concerns where the target is in the camera, but for errors that so
        few frames do not rule out and none has shown: their mean square is that of a long tail."""
        shown = self._of_surface if self._are_shown else self._parts[0].added
        return shown + self._of_calibration.in_camera

    @property
    def budget(self) -> Mapping[str, FloatArray]:
        """(20, 20) of what it is made of, by name."""
        return {"faces and outline": self._of_surface, **self._of_calibration.budget}

    @property
    def _of_surface(self) -> FloatArray:
        return np.asarray(sum(part.added for part in self._parts))

    def predict(self, kalman: Kalman) -> None:
        """Follow a filter that was just moved to the time of a frame."""
        if self._kalman is not None:
            self._parts = tuple(part.predicted(kalman.transition) for part in self._parts)
            self._of_calibration.predict(kalman.transition)

    def take_in(
        self, kalman: Kalman, observer: ObserverPose, seen: SeenBy, known: SensorNoise
    ) -> None:
        """Follow a filter that was just updated with a compared frame.

        Args:
            kalman: the filter; where it is another than before, it begins anew.
            observer: where the camera was.
            seen: the frame, and what of it was used.
            known: of the sensor's noise by now.
        """
        self._frames += 1
        self._are_shown = known.unweighed_are_shown
        comparison, used = seen.comparison, seen.used
        noise, lever_m = comparison.seen.noise, 0.5 * comparison.seen.edges.diameter_m
        lasts = noise.has_face_errors or noise.outline_sd_px > 0.0 or known.has_unweighed_errors
        if not lasts and seen.calibration.is_exact and self._kalman is None:
            return
        is_first = kalman is not self._kalman
        influence = influence_of(kalman, observer, comparison, used, is_first=is_first)
        self._kalman = kalman
        self._of_calibration.take_in(influence, kalman, observer, seen, self._frames)
        surface = lasting_part(comparison, used)
        of_evidence = surface, *unweighed_parts(comparison, used, known)
        correlations = noise.face_correlation, known.face_correlation, 0.0
        parts = []
        for part, covariance, correlation, counted in zip(
            self._parts, of_evidence, correlations, (True, False, False), strict=True
        ):
            of_pose = influence.of_pose @ covariance @ influence.of_pose.T
            moved = influence.by_evidence @ matrix_root(of_pose, lever_m)
            if is_first:
                after = Considered.begun(moved, correlation, self._frames)
                moved = moved / np.sqrt(self._frames)
            else:
                after = part.updated(influence.kept, moved, correlation)
            parts.append(after if counted else after.with_own(moved))
        self._parts = tuple(parts)


def matrix_root(covariance: FloatArray, lever_m: float) -> FloatArray:
    """(6, 6) a square root of the covariance of a vector of evidence of a pose.

    It is the symmetric one, by which the errors of like frames are alike, turns being counted by
    the shift that they make of a lever.
    """
    scale = np.repeat([1.0, 1.0 / lever_m], 3)
    variance, axes = np.linalg.eigh(covariance * np.outer(scale, scale))
    root = (axes * np.sqrt(np.maximum(variance, 0.0))) @ axes.T
    return np.asarray(root / scale[:, None])
