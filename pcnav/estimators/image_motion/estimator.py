"""Attitude and rate from images of one camera, frame by frame: the chain's answers.

Rates follow from the attitudes of several frames, those that come later among them: they are there
when the run has ended.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pcnav.core.arrays import IntArray
from pcnav.dynamics.blocks import ATTITUDE, ATTITUDE_LAYOUT, RATE
from pcnav.estimators.image_motion.chain import ChainFrame, ImageMotionChain
from pcnav.estimators.image_motion.outcomes import feature_outcomes, outcome_in_words
from pcnav.estimators.image_motion.rates import smoothed
from pcnav.estimators.image_motion.relative import Outcome
from pcnav.estimators.interface import Estimator, Given
from pcnav.recordings.tracks import TrackFrame
from pcnav.runs.estimate import Estimate, FeatureUse, Output
from pcnav.runs.status import Status


class ImageMotionEstimator(Estimator):
    """Takes in frames of feature tracks of one camera."""

    output = Output(
        ATTITUDE_LAYOUT,
        without_sd=(RATE,),
        notes=("outcome", "segment", "reference", "features", "matches", "agreeing"),
        has_nis=False,
        has_feature_outcomes=True,
        follows_signs=True,
    )

    def __init__(self, given: Given) -> None:
        self._settings = given.pipeline.image_motion
        about = given.about
        self._chain = ImageMotionChain(about.camera, about.pixel_sigma_px, self._settings)
        self._measured: set[int] = set()
        self._answers: list[Estimate] = []

    def step(self, frame: TrackFrame, /) -> Estimate:
        """See `Estimator`. Raises `InputError` for the robust solver without its library."""
        answer = self._answer(self._chain.step(frame), frame.features)
        self._answers.append(answer)
        return answer

    def finish(self) -> Sequence[Estimate]:
        """All with the rates, every segment on its own."""
        answers = list(self._answers)
        placed = [k for k, answer in enumerate(answers) if answer.values]
        segments = np.array([answers[k].notes["segment"] for k in placed])
        for segment in np.unique(segments):
            at = [placed[k] for k in np.flatnonzero(segments == segment)]
            time_s = np.array([answers[k].time_s for k in at])
            _, rates = smoothed(
                time_s, np.stack([answers[k][ATTITUDE] for k in at]), self._settings
            )
            for k, rate in zip(at, rates, strict=True):
                answers[k] = replace(answers[k], values={**answers[k].values, RATE.name: rate})
        return answers

    def _answer(self, frame: ChainFrame, seen: IntArray) -> Estimate:
        known = frame.R_world_body is not None and frame.covariance is not None
        is_first = frame.outcome is Outcome.FIRST
        return Estimate(
            time_s=frame.time_s,
            status=str(self._status(frame)),
            values={ATTITUDE.name: frame.R_world_body} if frame.R_world_body is not None else {},
            covariance=frame.covariance if known else None,
            notes={
                "outcome": outcome_in_words(frame.outcome, self._settings),
                "segment": frame.segment,
                "reference": frame.reference,
                "features": len(seen),
                "matches": frame.matches,
                "agreeing": frame.agreeing,
            },
            features=FeatureUse(outcomes=feature_outcomes(frame, seen)),
            new_axes=frame.R_world_body if is_first else None,
        )

    def _status(self, frame: ChainFrame) -> Status:
        """Locked where measured; before that in a segment acquiring, afterwards coasting."""
        if frame.outcome is Outcome.MEASURED:
            self._measured.add(frame.segment)
            return Status.LOCKED
        return Status.COASTING if frame.segment in self._measured else Status.ACQUIRING
