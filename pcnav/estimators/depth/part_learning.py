"""Learns which parts of the target are not as in its mesh, from the frames of a track.

A part that was turned bends a pose that is fitted to it, and one that is missing hides what is
behind it. A part is judged by where its returns lie in the model frame over views that change,
against all of the target that fits; so one that does not fit is shown from then on where it is, and
no pose is measured by it.
"""

import logging

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import rotation_angle
from pcnav.estimators.depth.views import FrameView
from pcnav.perception.part_fit import MeshFit, PartFit, PartVerdict
from pcnav.perception.reading import FrameReader
from pcnav.target.as_found import PartChanges, as_found
from pcnav.target.parts import Parts, has_several_bodies, parts_of
from pcnav.target.satellite import Target

_log = logging.getLogger("pcnav")

_MIN_FRAMES, _MAX_FRAMES = 5, 24
"""A part is judged from so many frames on, and anew after as many as these."""
_NEW_VIEW_RAD, _MAX_WAIT = 0.1, 10
"""A frame is taken in where it shows the target turned by so much, or after so many frames."""
_FITS = 0.985
"""A part of which more is explained lies where the mesh has it."""
_SAME_RAD = 0.01
"""A part that turns out to be turned by so much more or less stays where it was found."""


class PartLearner:
    """Which parts of the target are not as in its mesh."""

    def __init__(self, target: Target, reader: FrameReader) -> None:
        """``reader`` is told."""
        self._target, self._reader = target, reader
        self._changes = PartChanges()
        self._known: Parts | None = None
        # Now, for it takes a while of a mesh of many faces: no frame has to wait for it.
        self._has_parts = has_several_bodies(target.mesh)
        self._scale = 1.0
        self._begin()

    def _begin(self) -> None:
        self._fit, self._wait = MeshFit(self._target), 0
        self._last: FloatArray | None = None

    @property
    def found(self) -> tuple[str, ...]:
        """Names of the parts that are not as in the mesh."""
        return tuple(self._parts.each[k].name for k in sorted(self._changes.parts))

    @property
    def _parts(self) -> Parts:
        if self._known is None:
            self._known = parts_of(self._target)
        return self._known

    def start_again(self, mesh_scale: float) -> None:
        """Forget what a track taught that was wrong."""
        self._apply(PartChanges(), mesh_scale)

    def learn(self, view: FrameView, T_cam_model: FloatArray, mesh_scale: float) -> bool:
        """Take in a frame that a track was updated with, to a pose (4, 4), of a target that is so
        much larger than its mesh; whether that has changed what is looked for."""
        if mesh_scale != self._scale:
            # Poses of a target that was taken for larger or smaller were bent as well.
            self._scale = mesh_scale
            self._begin()
        if not self._has_parts or not self._is_new(T_cam_model):
            return False
        exposure = self._reader.exposure(view.frame, T_cam_model)
        self._fit.add(view.frame, T_cam_model, self._reader.noise, mesh_scale, exposure)
        if self._fit.frames < _MIN_FRAMES:
            return False
        fits = self._fit.parts(_FITS)
        changes = self._changed(fits)
        if changes is None:
            if self._fit.frames >= _MAX_FRAMES:
                self._begin()
            return False
        self._tell(view.frame.index, fits, changes)
        self._apply(changes, mesh_scale)
        return True

    def _is_new(self, T_cam_model: FloatArray) -> bool:
        self._wait += 1
        last, R = self._last, T_cam_model[:3, :3]
        is_new = last is None or float(rotation_angle(last.T @ R)) > _NEW_VIEW_RAD
        if is_new or self._fit.frames < _MIN_FRAMES or self._wait >= _MAX_WAIT:
            self._last, self._wait = R.copy(), 0
            return True
        return False

    def _changed(self, fits: tuple[PartFit, ...]) -> PartChanges | None:
        """What is known after these fits; None where that is nothing new, or where most of the
        target does not fit: it is the pose then that is wrong."""
        known = self._changes
        moved, missing, strange = dict(known.moved), set(known.missing), set(known.strange)
        right = wrong = 0.0
        for k, fit in enumerate(fits):
            if fit.verdict is PartVerdict.HARDLY_SEEN:
                continue
            if fit.verdict is PartVerdict.FITS:
                right += fit.pixels * fit.explained_share
            else:
                wrong += fit.pixels
            before = moved.pop(k, None)
            missing.discard(k)
            strange.discard(k)
            if fit.verdict is PartVerdict.MISSING:
                missing.add(k)
            elif fit.verdict is PartVerdict.DIFFERS:
                strange.add(k)
            elif fit.T_model_part is not None:
                is_same = before is not None and _angle(before, fit.T_model_part) < _SAME_RAD
                moved[k] = before if is_same and before is not None else fit.T_model_part
        changes = PartChanges(moved, frozenset(missing), frozenset(strange))
        return None if right <= wrong or _are_same(changes, known) else changes

    def _apply(self, changes: PartChanges, mesh_scale: float) -> None:
        self._begin()
        if _are_same(changes, self._changes):
            return
        self._changes = changes
        target, measured = self._target, None
        if changes.parts:
            target, measured = as_found(target, self._parts, changes)
        self._reader.look_for(target.scaled(mesh_scale), measured)

    def _tell(self, index: int, fits: tuple[PartFit, ...], changes: PartChanges) -> None:
        for k, fit in enumerate(fits):
            was, now = k in self._changes.parts, k in changes.parts
            if was and not now:
                _log.info("frame %d: %s is as in the mesh again", index, fit.name)
            elif k in changes.moved and changes.moved[k] is not self._changes.moved.get(k):
                why = f"turned by {fit.turn_deg:.1f} deg against the mesh"
                _log.info("frame %d: %s is %s: no pose is measured by it", index, fit.name, why)
            elif now and not was:
                why = "missing" if k in changes.missing else "not as in the mesh"
                _log.info("frame %d: %s is %s: no pose is measured by it", index, fit.name, why)


def _angle(a: FloatArray, b: FloatArray) -> float:
    return float(rotation_angle(a[:3, :3].T @ b[:3, :3]))


def _are_same(a: PartChanges, b: PartChanges) -> bool:
    same = (a.missing, a.strange, a.moved.keys()) == (b.missing, b.strange, b.moved.keys())
    return same and all(np.array_equal(T, b.moved[k]) for k, T in a.moved.items())
