"""Settings of the estimator on images of one camera (Appl. Sci. 2022): the chain, the tracker."""

from enum import StrEnum
from typing import Annotated, Self

from pydantic import Field, model_validator

from pcnav.config.table import Fraction, NonNegative, Positive, Probability, Table


class MatchSolver(StrEnum):
    """How the essential matrix of two frames is found."""

    ROBUST = "robust"
    """Five-point samples, then least squares on the matches that agree."""
    EIGHT_POINT = "eight_point"
    """All matches taken as right, without refinement: the paper's."""


class Reference(StrEnum):
    """Which earlier frame a frame is matched with."""

    ADJACENT = "adjacent"
    """The last frame with an attitude: the paper's chain."""
    KEY_FRAME = "key_frame"
    """A frame that is kept while enough of its features stay in view."""


class Smoothing(StrEnum):
    """How rates are taken from attitudes."""

    NONE = "none"
    """Differences of neighbouring frames."""
    POLYNOMIAL = "polynomial"
    """A local polynomial of rotation vectors."""


class ImageMotionTable(Table):
    """[image_motion]: settings of `pcnav.estimators.image_motion` (Appl. Sci. 2022, 12, 12625)."""

    solver: MatchSolver = MatchSolver.ROBUST
    reference: Reference = Reference.KEY_FRAME
    pixel_sigma_px: Positive | None = None
    """Noise of each tracked coordinate; None takes the value the recording states."""
    min_matches: Annotated[int, Field(ge=8)] = 12
    """With fewer a frame is not measured: five numbers explain eight matches too easily."""
    inlier_gate_sigma: Positive = 3.5
    """A match agrees with a motion when its Sampson error is below so many deviations."""
    min_agreeing: Fraction = 0.5
    """Share of the matches that must agree with a motion."""
    ambiguous_chi_square: NonNegative = 13.8
    """Two motions whose squared errors differ by less are not told apart: 13.8 is a likelihood
    ratio of 1000."""
    max_sd_deg: Positive = 6.0
    """A rotation less certain than this about its worst axis is not used."""
    min_significance: NonNegative = 4.0
    """A turn out of the image plane of fewer deviations than this is not used: near zero the
    relief of the target and with it the axis of the turn are open."""
    max_turn_deg: Annotated[float, Field(gt=0.0, le=180.0)] = 120.0
    """Largest turn out of the image plane that is believed: no feature is seen from both sides."""
    key_share: Fraction = 0.7
    """A key frame is kept while this share of its features is in view."""
    rate_change: NonNegative = 0.5
    """How much the rate may change between frames, as a share of it (one standard deviation):
    what chooses between two motions that the matches do not tell apart."""
    smoothing: Smoothing = Smoothing.POLYNOMIAL
    window_frames: Annotated[int, Field(ge=3)] = 7
    """Frames of the local polynomial; odd."""
    degree: Annotated[int, Field(ge=1, le=4)] = 2
    """Of the local polynomial."""

    @model_validator(mode="after")
    def _window_holds_the_polynomial(self) -> Self:
        if self.window_frames % 2 == 0:
            raise ValueError(f"window_frames: expected an odd number, got {self.window_frames}")
        if self.degree >= self.window_frames:
            raise ValueError("degree: expected less than window_frames")
        return self


class FeatureTrackerTable(Table):
    """[feature_tracker]: corners followed through images.

    Lucas-Kanade forward and backward from image to image, then the patch of the first sight,
    which may have been sheared, stretched and lit anew.
    """

    max_features: Annotated[int, Field(ge=8)] = 300
    quality: Probability = 0.01
    """Of a corner, as a share of the best."""
    spacing_px: Positive = 8.0
    """Least distance between corners."""
    window_px: Annotated[int, Field(ge=5)] = 21
    """Side of the patch that is matched; odd."""
    pyramid_levels: Annotated[int, Field(ge=0)] = 4
    backward_px: Positive = 0.5
    """A track that does not come back to where it started within this is dropped."""
    anchor_px: Positive = 1.0
    """A track whose first patch is found farther than this from where the last image leads is
    dropped."""
    outline_px: NonNegative = 8.0
    """No corner is taken closer than this to the outline against dark space."""
    dark_fraction: Fraction = 0.05
    """Darker than this share of the target's brightest parts is space or deep shadow."""
    min_correlation: Fraction = 0.97
    """Of the grey levels of a patch with those it had when it was first seen; less drops it."""
    smoothing_px: Positive = 0.8
    """Standard deviation of the Gaussian that takes the grain off before patches are compared."""
    pixel_sigma_px: Positive = 0.1
    """Error of a tracked coordinate, which the recording of tracks states: a corner whose patch
    the noise of the image places less well than this is let go."""
    geometric_check_px: Positive = 1.5
    """Largest distance of a match from the motion that most matches share; frame to frame."""
