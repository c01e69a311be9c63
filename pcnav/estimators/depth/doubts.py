"""What speaks against the estimate of a frame, and the numbers that it rests on."""

from collections.abc import Mapping
from dataclasses import dataclass

from pcnav.estimators.depth.track import Track
from pcnav.perception.calibration_doubt import CalibrationDoubt
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.runs.doubts import COLUMN, RIM_COLUMN, TILT_COLUMN, Doubt, column_of
from pcnav.runs.estimate import Note

_CLEAR_SD = 4.0
_STEP_PX = 0.25
"""An outline that is seen so much further out, or in: that of a pixel which returns from a quarter
of its area on."""


@dataclass(frozen=True)
class FrameDoubts:
    """Of one frame."""

    raised: tuple[Doubt, ...] = ()
    tilt_sd: float = float("nan")
    """Deviations by which frames contradict the stated calibration; nan before they tell."""
    rim_px: float = float("nan")
    """How far outward the outline is seen, where that is clear; nan where it is not known."""

    @staticmethod
    def of(
        track: Track | None,
        is_contradicted: bool,
        calibration: CalibrationDoubt | None,
        noise: SensorNoise,
    ) -> "FrameDoubts":
        """Of a track, the last frames of which contradict the mass and the calibration so."""
        if track is None:
            return FrameDoubts()
        rim_px = rim_step_px(noise)
        raised = {
            Doubt.NIS: track.evidence.errs,
            Doubt.EXPLAINED: track.evidence.explains_little or bool(track.blind_frames),
            Doubt.PRIOR: is_contradicted,
            Doubt.TILT: calibration is not None and calibration.is_clear,
            Doubt.RIM: abs(rim_px) > _STEP_PX,
        }
        tilt_sd = float("nan") if calibration is None else calibration.deviations
        return FrameDoubts(tuple(doubt for doubt, on in raised.items() if on), tilt_sd, rim_px)

    @property
    def notes(self) -> Mapping[str, Note]:
        """Fields of states.csv."""
        numbers = {TILT_COLUMN: self.tilt_sd, RIM_COLUMN: self.rim_px}
        return {COLUMN: column_of(list(self.raised)), **numbers}


def rim_step_px(noise: SensorNoise) -> float:
    """How far outward the outline is seen before space, or before another surface where that is
    more, px; 0 where that is not clear."""
    offsets = zip(noise.outline_offset_px[::2], noise.outline_offset_sd_px[::2], strict=True)
    clear = [offset for offset, sd in offsets if abs(offset) > _CLEAR_SD * sd]
    return float(max(clear, key=abs, default=0.0))
