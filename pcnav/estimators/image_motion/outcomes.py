"""What became of the features of an image, beside what became of the image."""

import numpy as np

from pcnav.config.image_motion import ImageMotionTable
from pcnav.core.arrays import IntArray
from pcnav.estimators.image_motion.chain import ChainFrame
from pcnav.estimators.image_motion.relative import Outcome, matched
from pcnav.runs.feature_outcomes import BEHIND, GATED, INLIER, TRACKED, FeatureOutcomes
from pcnav.runs.records import ACCEPTED

_WORDS = {
    Outcome.MEASURED: "measured",
    Outcome.FIRST: "first frame of a segment",
    Outcome.NO_CONSENSUS: "most matches agree with no one motion",
    Outcome.NO_MOTION: "nothing moved in the image",
    Outcome.NO_PARALLAX: "a turn of the camera alone explains the matches",
    Outcome.PLANAR: "points of one plane explain the matches",
    Outcome.AMBIGUOUS: "two motions explain the matches alike",
    Outcome.UNEXPECTED: "far from what the rate promises",
    Outcome.IMPRECISE: "the turn is too uncertain",
}


def outcome_in_words(outcome: Outcome, settings: ImageMotionTable) -> str:
    """What became of a frame."""
    if outcome is Outcome.FEW_MATCHES:
        return f"fewer than {settings.min_matches} matches"
    return _WORDS[outcome]


def feature_outcomes(frame: ChainFrame, seen: IntArray) -> FeatureOutcomes:
    """Of the features ``seen`` (n,) in a frame: matched ones are judged by the squared distance to
    their epipolar line (Sampson's), over the variance of a coordinate."""
    words, squared = [TRACKED] * len(seen), np.full(len(seen), np.nan)
    relative = frame.relative
    if relative is None or relative.squared is None:
        return FeatureOutcomes(seen, tuple(words), squared)
    _, here, there = matched(seen, frame.matched)
    squared[here] = relative.squared[there]
    is_measured = frame.outcome is Outcome.MEASURED
    for at, distance, agrees in zip(
        here.tolist(), squared[here].tolist(), relative.agreeing[there].tolist(), strict=True
    ):
        if agrees:
            words[at] = ACCEPTED if is_measured else INLIER
        else:
            words[at] = GATED if distance >= relative.gate else BEHIND
    return FeatureOutcomes(seen, tuple(words), squared, relative.gate)
