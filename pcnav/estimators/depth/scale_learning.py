"""Learns the size of the target from the frames of a track, and tells perception."""

import logging

from pcnav.estimators.depth.views import FrameView
from pcnav.perception.face_evidence import NO_FACE
from pcnav.perception.mesh_scale import ScaleBelief
from pcnav.perception.reading import FrameReader
from pcnav.target.satellite import Target

_log = logging.getLogger("pcnav")


class ScaleLearner:
    """By how much the target is larger than its mesh."""

    def __init__(self, target: Target, reader: FrameReader, sd: float) -> None:
        """``reader`` is told; ``sd`` is how far the mesh may be off, 0 for one that is right."""
        self._reader, self._belief = reader, ScaleBelief(sd)
        self._faces: dict[str | None, int] = {None: NO_FACE}
        self._faces.update((each.name, k) for k, each in enumerate(target.rectangles))
        self.factor = 1.0
        """By which the target is taken to be larger now."""

    def learn(self, view: FrameView, accepted: tuple[bool, ...]) -> bool:
        """Take in a frame that a track was updated with; whether it has changed the size."""
        comparison = view.comparison
        if comparison is None or self._belief.sd == 0.0:
            return False
        used = {
            self._faces[None if face.rectangle is None else face.rectangle.name]
            for face, ok in zip(comparison.faces, accepted, strict=True)
            if ok
        }
        lever_m = 0.5 * self._reader.diameter_m
        self._belief = self._belief.with_frame(comparison.seen, used, lever_m)
        change = self._belief.factor
        if change == 1.0:
            return False
        self._reader.rescale(change)
        # Frames that are compared at the new size tell what is left of it.
        self._belief = ScaleBelief(self._belief.sd)
        self.factor *= change
        off = self.factor - 1.0
        _log.info(
            "frame %d: the target is %.2g %% %s than its mesh: followed at that size",
            view.frame.index,
            100.0 * abs(off),
            "larger" if off > 0.0 else "smaller",
        )
        return True
