"""What the frames so far tell of the sensor's noise, all kinds of it together."""

from dataclasses import dataclass, replace

from pcnav.perception.contour import ContourRuns
from pcnav.perception.face_errors import FaceErrors
from pcnav.perception.lasting_errors import FaceMemory
from pcnav.perception.modality import Evidence
from pcnav.perception.outline_belief import OutlineBelief
from pcnav.perception.outline_scatter import OutlineScatter
from pcnav.perception.range_level import RangeLevel, face_levels
from pcnav.perception.render_compare import Comparison
from pcnav.perception.sensor_noise import SensorNoise
from pcnav.perception.shared_levels import FrameErrors

_FEW_FRAMES = 5
"""As long as so few have been learnt from, what they do not rule out may be. Afterwards what frames
do not show is taken not to be, as where none can be learnt from."""


@dataclass(frozen=True)
class NoiseBelief:
    """One belief of each kind of error."""

    level: RangeLevel
    outline: OutlineBelief
    scatter: OutlineScatter
    faces: FaceErrors
    memory: FaceMemory
    offsets: FrameErrors
    frames: int = 0
    """Learnt from, but for offsets of frames."""

    @staticmethod
    def before_any_frame(lever_m: float, stated_m: float | None) -> "NoiseBelief":
        """Of a target of half the diameter ``lever_m`` and a recording that states such noise."""
        return NoiseBelief(
            RangeLevel(stated_m),
            OutlineBelief(),
            OutlineScatter(lever_m),
            FaceErrors(lever_m),
            FaceMemory(lever_m),
            FrameErrors.before_any_frame(lever_m),
        )

    def followed(self, time_s: float, comparison: Comparison, together: Evidence) -> "NoiseBelief":
        """Take in how the distance goes on; ``together``: of the faces used, as in `with_frame`."""
        pose, noise = comparison.T_cam_model, comparison.seen.sensor_noise
        return replace(
            self,
            offsets=self.offsets.with_frame(time_s, pose, together, noise),
            memory=self.memory.with_frame(comparison.seen),
        )

    def with_frame(
        self, comparison: Comparison, together: Evidence, lever_m: float
    ) -> "NoiseBelief":
        """Take in a frame; ``together`` (6 + k): what the faces that a track used say of it."""
        seen, noise = comparison.seen, comparison.seen.sensor_noise
        faces = self.faces.with_frame(seen)
        facets_px2 = seen.noise.outline_sd_px**2 - noise.outline_sd_px**2
        ranges = faces.evidence(seen)
        if faces.applied(seen.sensor_noise).has_face_errors and not noise.has_face_errors:
            # Weighed as if faces did not err, what they err by would pass for the outline's.
            together = ranges.with_also(_of_outline(seen.contour, noise))
        return replace(
            self,
            level=self.level.with_levels(face_levels(seen.residuals, noise)),
            outline=self.outline.with_frame(together, noise, lever_m),
            scatter=self.scatter.with_frame(seen.contour, noise, ranges, facets_px2),
            faces=faces,
            frames=self.frames + 1,
        )

    def applied(self, noise: SensorNoise) -> SensorNoise:
        """The noise with what is believed of it."""
        for part in (self.level, self.outline, self.scatter):
            noise = part.applied(noise)
        believed = self.faces.applied(noise)
        weighed, unweighed = (believed.face_sd_m, believed.face_tilt_sd_m), (0.0, 0.0)
        few = 0 < self.frames < _FEW_FRAMES
        if not believed.has_face_errors:
            unweighed = self.faces.possible if few else unweighed
        elif self.offsets.shows_exact_outline(noise):
            noise = replace(noise, face_correlation=round(self.memory.correlation, 2))
        else:
            # With faces that err, the outline would hold the pose. A rough one errs by sides.
            weighed, unweighed = unweighed, weighed
        noise = replace(
            noise,
            face_sd_m=weighed[0],
            face_tilt_sd_m=weighed[1],
            unweighed_face_sd_m=unweighed[0],
            unweighed_face_tilt_sd_m=unweighed[1],
            unweighed_are_shown=not few,
        )
        noise = self.offsets.applied(noise)
        if few and noise.frame_sd_m == 0.0:
            return replace(noise, unweighed_frame_sd_m=self.offsets.possible_m(noise))
        return replace(noise, unweighed_frame_sd_m=0.0)


def _of_outline(runs: ContourRuns, noise: SensorNoise) -> Evidence:
    """(6 + k) what an outline says, under the noise that it was measured under."""
    return Evidence.of(runs.value, runs.variance, runs.by_pose_and_shared(noise))
