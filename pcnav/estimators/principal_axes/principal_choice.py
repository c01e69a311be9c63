"""The principal axes of a state: which are chosen, how certain they are, what is reported."""

from dataclasses import dataclass

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import MOTION_LAYOUT
from pcnav.dynamics.principal_inertia import middle_ratio, moments_from_ratios, moments_jacobian
from pcnav.estimators.features.answer import Motion
from pcnav.estimators.features.photogrammetric_frame import photogrammetric_axes
from pcnav.estimators.principal_axes.feature_states import (
    PA_OMEGA,
    PA_R_HILL,
    PA_RATIOS,
    PA_THETA,
    PA_V_HILL,
    PrincipalState,
    point_slice,
)
from pcnav.estimators.principal_axes.principal_frame import (
    PRINCIPAL_CHOICES,
    clearest_triple,
    free_axes,
    principal_axes,
)
from pcnav.runs.estimate import FeaturePoint

NOTES = ("p_x", "p_y", "p_z", "moment_gap_over_sd", "axes_sd_rad")
CLEAR_SD = 3.0
"""Moments closer than so many standard deviations of their gap are near equal."""
_MAX_TILT_SD_RAD = 0.15
"""Beyond, the axes are not determined however clear the gaps look."""


@dataclass(frozen=True)
class AxesCertainty:
    """How well the principal axes are known."""

    ratios: tuple[float, float, float]
    """p_x, p_y, p_z."""
    gaps: FloatArray
    """(2,) Ix - Iy and Iy - Iz over Ix."""
    gap_sd: FloatArray
    """(2,)"""
    tilt_sd_rad: float
    """Of the attitude, in its least known direction."""
    sign_significance: float = np.inf
    """How far the frame of three points is from giving an axis the other sign, in standard
    deviations; negative when it would give it now."""

    @property
    def significance(self) -> float:
        """Smaller distance between successive moments over its standard deviation."""
        return float(np.min(np.abs(self.gaps) / np.maximum(self.gap_sd, 1e-12)))

    @property
    def order_significance(self) -> float:
        """The smaller gap over its standard deviation; negative when the order is violated."""
        return float(np.min(self.gaps / np.maximum(self.gap_sd, 1e-12)))

    @property
    def is_determined(self) -> bool:
        """Whether the moments differ clearly, and the axes are known with their signs."""
        return self.are_axes_known and self.is_signed

    @property
    def are_axes_known(self) -> bool:
        """Whether the moments differ clearly and the axes are known, whatever their signs."""
        return self.significance > CLEAR_SD and self.tilt_sd_rad < _MAX_TILT_SD_RAD

    @property
    def is_signed(self) -> bool:
        """Whether the signs are clear: no error that is to be expected would reverse an axis."""
        return abs(self.sign_significance) > CLEAR_SD

    def notes(self) -> dict[str, float]:
        """The columns `NOTES` of a result."""
        values = (*self.ratios, self.significance, self.tilt_sd_rad)
        return dict(zip(NOTES, values, strict=True))


def axes_certainty(
    state: PrincipalState, covariance: FloatArray, corners: FloatArray | None = None
) -> AxesCertainty:
    """What state and covariance (n, n) say of the axes.

    ``corners`` (3, 3) are the points whose photogrammetric frame decides the signs (17).
    """
    moments = moments_from_ratios(state.ratios)
    by = -np.diff(moments_jacobian(state.ratios), axis=0)
    gap_sd = np.sqrt(np.einsum("ip,pq,iq->i", by, covariance[PA_RATIOS, PA_RATIOS], by))
    px, pz = state.ratios.tolist()
    by_axes = covariance[PA_THETA, PA_THETA]
    tilt = float(np.linalg.eigvalsh(by_axes)[-1])
    return AxesCertainty(
        ratios=(px, middle_ratio(state.ratios), pz),
        gaps=-np.diff(moments),
        gap_sd=gap_sd,
        tilt_sd_rad=float(np.sqrt(max(tilt, 0.0))),
        sign_significance=np.inf if corners is None else _sign_significance(corners, by_axes),
    )


def _sign_significance(corners: FloatArray, covariance: FloatArray) -> float:
    """Angle of an axis from where (17) would reverse it over its deviation, of the less certain.

    The points stay where they are when the axes turn: ``covariance`` (3, 3) is that of the turn.
    """
    given, axes = photogrammetric_axes(corners).T[:2], np.eye(3)[:2]
    across = np.cross(axes, given)
    cosine = np.einsum("ij,ij->i", axes, given)
    slope = np.linalg.norm(across, axis=1)
    sd = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", across, covariance, across), 0.0))
    angle = np.arctan2(cosine, slope)
    return float(np.min(angle / np.maximum(sd / np.maximum(slope, 1e-12), 1e-12)))


def signing_triple(
    state: PrincipalState, covariance: FloatArray, triple: tuple[int, int, int]
) -> tuple[int, int, int]:
    """Places in the state of the three points that sign its axes: those it has, while they are
    clear about it, else the clearest."""
    if axes_certainty(state, covariance, state.points[list(triple)]).is_signed:
        return triple
    order = unique_choice(state, None)
    return clearest_triple(state.points @ order)


def unique_choice(state: PrincipalState, corners: FloatArray | None) -> FloatArray:
    """(3, 3) R_body_new to the axes that (17) asks for, a signed permutation.

    ``corners`` (3, 3) are the points whose photogrammetric frame decides the signs; without them,
    the nearest axes with the right order are taken.
    """
    inertia = np.diag(moments_from_ratios(state.ratios))
    if corners is None:
        moments = moments_from_ratios(state.ratios)
        ordered = [S for S in PRINCIPAL_CHOICES if np.all(np.diff(moments @ np.abs(S)) <= 1e-15)]
        return max(ordered, key=lambda S: float(np.trace(S)))
    R_body_p = photogrammetric_axes(corners)
    _, axes = principal_axes(R_body_p.T @ inertia @ R_body_p)
    return _nearest_choice(R_body_p @ axes)


def free_choice(state: PrincipalState, corners: FloatArray) -> FloatArray:
    """(3, 3) R_body_new to the axes as the eigen-decomposition hands them out."""
    inertia = np.diag(moments_from_ratios(state.ratios))
    R_body_p = photogrammetric_axes(corners)
    return _nearest_choice(R_body_p @ free_axes(R_body_p.T @ inertia @ R_body_p))


def _nearest_choice(R_body_new: FloatArray) -> FloatArray:
    """The axes are eigenvectors of a diagonal matrix: but for rounding, one of the 24 choices."""
    fit = np.einsum("kij,ij->k", PRINCIPAL_CHOICES, R_body_new)
    return np.asarray(PRINCIPAL_CHOICES[int(fit.argmax())], np.float64)


def reported_motion(
    state: PrincipalState, covariance: FloatArray, features: tuple[int, ...]
) -> Motion:
    """What the filter reports: in its axes the products of inertia are zero by definition."""
    moments = moments_from_ratios(state.ratios)
    change = state.additive()
    covariance = change @ covariance @ change.T
    rows = np.concatenate(
        [np.arange(block.start, block.stop) for block in (PA_R_HILL, PA_V_HILL, PA_THETA, PA_OMEGA)]
    )
    selected = np.zeros((MOTION_LAYOUT.size, len(covariance)))
    selected[np.arange(12), rows] = 1.0
    selected[12:14, PA_RATIOS] = moments_jacobian(state.ratios)[1:]
    points = {
        name: FeaturePoint(state.points[k], covariance[point_slice(k), point_slice(k)])
        for k, name in enumerate(features)
    }
    return Motion(
        r_hill=state.r_hill,
        v_hill=state.v_hill,
        R_world_body=state.R_world_body,
        omega_body=state.omega_body,
        inertia_ratios=np.array([moments[1], moments[2], 0.0, 0.0, 0.0]),
        covariance=selected @ covariance @ selected.T,
        points=points,
    )
