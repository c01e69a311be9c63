"""What errors that last from frame to frame add to the covariance of a filter that takes them for
white noise.

They are considered, not estimated (Schmidt 1966): the filter's gains stay, and beside it goes the
covariance of its error with an error of the frames' poses that is correlated in time,
``u_k = c u_{k-1} + white``. The filter counts its variance in each frame; what it leaves out are
the products of different frames.
"""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.state import R_HILL, STATE_SIZE, THETA_BODY
from pcnav.estimators.depth.measuring import Kalman
from pcnav.estimators.depth.pose_measurement import ObserverPose, pose_jacobian
from pcnav.perception.lasting_errors import lasting_part
from pcnav.perception.modality import POSE_SIZE, Evidence
from pcnav.perception.render_compare import Comparison

_FAINT = 1e-3
"""What a frame tells of a pose is not its own where it is less than that of what is known."""


@dataclass(frozen=True)
class Considered:
    """A filter of n states beside k errors of unit variance that it does not estimate."""

    added: FloatArray
    """(n, n) covariance of its error beyond its own."""
    by_error: FloatArray
    """(n, k) covariance of its error with the errors of the last frame."""

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
        self._considered = Considered(
            np.zeros((STATE_SIZE, STATE_SIZE)), np.zeros((STATE_SIZE, POSE_SIZE))
        )

    @property
    def covariance(self) -> FloatArray:
        """(20, 20) beyond the filter's own."""
        return self._considered.added

    def predict(self, kalman: Kalman) -> None:
        """Follow a filter that was just moved to the time of a frame."""
        if self._kalman is not None:
            self._considered = self._considered.predicted(kalman.transition)

    def take_in(
        self,
        kalman: Kalman,
        observer: ObserverPose,
        comparison: Comparison,
        used: tuple[bool, ...],
    ) -> None:
        """Follow a filter that was just updated with a compared frame.

        Args:
            kalman: the filter; where it is another than before, it begins anew.
            observer: where the camera was.
            comparison: of the frame with the view.
            used: which of its faces were.
        """
        self._frames += 1
        noise, lever_m = comparison.seen.noise, 0.5 * comparison.seen.edges.diameter_m
        lasts = noise.has_face_errors or noise.outline_sd_px > 0.0
        if not lasts and self._kalman is None:
            return
        J, P = pose_jacobian(kalman.state, observer), kalman.covariance
        faces = zip(comparison.faces, used, strict=True)
        together = Evidence.together((f.joint for f, ok in faces if ok), noise.n_shared)
        information = together.of_pose.information
        error = matrix_root(lasting_part(comparison, used), lever_m)
        if kalman is self._kalman:
            gain = P @ J.T
            kept = np.eye(STATE_SIZE) - gain @ information @ J
            self._considered = self._considered.updated(kept, gain @ error, noise.face_correlation)
            return
        self._kalman = kalman
        # All frames so far saw the target as much off its place as this one: it moves as it seems
        # to, but elsewhere.
        known = _FAINT * np.linalg.inv(J @ P @ J.T)
        pose, index = np.linalg.solve(information + known, error), np.r_[R_HILL, THETA_BODY]
        moved = np.zeros((STATE_SIZE, POSE_SIZE))
        moved[index] = np.linalg.solve(J[:, index], pose)
        share = 1.0 / self._frames
        lasting = noise.face_correlation * (1.0 - share)
        self._considered = Considered(lasting * moved @ moved.T, (lasting + share) * moved)


def matrix_root(covariance: FloatArray, lever_m: float) -> FloatArray:
    """(6, 6) a square root of the covariance of a vector of evidence of a pose.

    It is the symmetric one, by which the errors of like frames are alike, turns being counted by
    the shift that they make of a lever.
    """
    scale = np.repeat([1.0, 1.0 / lever_m], 3)
    variance, axes = np.linalg.eigh(covariance * np.outer(scale, scale))
    root = (axes * np.sqrt(np.maximum(variance, 0.0))) @ axes.T
    return np.asarray(root / scale[:, None])
