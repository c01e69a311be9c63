"""Clicks in the scene: a card of what is there, or a distance between two returns."""

import numpy as np
import viser

from pcnav.core.arrays import FloatArray
from pcnav.runs.records import RectangleRecord
from pcnav.viewer.card import Card
from pcnav.viewer.features_told import feature_card
from pcnav.viewer.frames import Shot
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.page import Page
from pcnav.viewer.palette import MASS_CENTRE
from pcnav.viewer.picking import (
    Ray,
    picked_point,
    picked_rectangle,
    point_card,
    rectangle_card,
)
from pcnav.viewer.render_options import line_colour, vector
from pcnav.viewer.server import drawing

_NOTHING = Card("", [])


class Pointer:
    """What a browser's clicks do in its scene."""

    def __init__(self, client: viser.ClientHandle, page: Page) -> None:
        self._client, self._page = client, page
        self._measures = False
        self._from: FloatArray | None = None
        self._line = client.scene.add_line_segments(
            "/distance",
            np.zeros((1, 2, 3), dtype=np.float32),
            line_colour(MASS_CENTRE),
            thickness=2.5,
            thickness_units="screen",
            visible=False,
        )

    def measure(self, wanted: bool) -> None:
        """Measure from now on, or tell."""
        self._measures = wanted
        self.clear()

    def clear(self) -> None:
        """Take card and distance off the page."""
        self._from = None
        with drawing(self._client):
            self._line.visible = False
            self._tell(_NOTHING)

    def pick(
        self,
        ray: Ray,
        loaded: LoadedRun,
        shot: Shot | None,
        records: tuple[RectangleRecord, ...],
    ) -> None:
        """What lies along a ray."""
        point = None if shot is None else picked_point(shot, ray)
        if self._measures:
            self._measure(None if shot is None or point is None else shot.points[point])
            return
        rectangle = picked_rectangle(records, ray)
        card = _NOTHING
        if rectangle is not None:
            card = rectangle_card(loaded, rectangle, shot)
            if shot is not None and point is not None:
                own = point_card(loaded, shot, point)
                card = Card(card.title, [*card.rows, *own.rows])
        elif shot is not None and point is not None:
            card = point_card(loaded, shot, point)
        with drawing(self._client):
            self._tell(card)

    def pick_in_image(self, place: FloatArray, loaded: LoadedRun, frame: int) -> None:
        """Why a track was used or not: at a place (2,) of the picture, its sides 1 long."""
        tracked, outcomes = loaded.tracked, loaded.outcomes_at(frame)
        if tracked is None or outcomes is None:
            return
        pose = loaded.pose(frame) if loaded.trajectory.T_cam_target is not None else None
        time_s = float(loaded.run.time_s[frame])
        number = tracked.feature_at(place, time_s, loaded.features, pose)
        known = number is not None and number in outcomes.feature
        told = loaded.frame_outcome(frame)
        card = feature_card(outcomes, number, told) if number is not None and known else _NOTHING
        with drawing(self._client):
            self._tell(card)

    def _measure(self, p_cam: FloatArray | None) -> None:
        if p_cam is None:
            return
        p_cam = np.asarray(p_cam, dtype=np.float64)
        with drawing(self._client):
            if self._from is None:
                self._from, self._line.visible = p_cam, False
                place = ", ".join(f"{value:.4f}" for value in p_cam)
                self._tell(Card("distance", [["from", f"{place} m"], ["to", "click at a return"]]))
                return
            apart = p_cam - self._from
            self._line.points = np.stack([self._from, p_cam])[None].astype(np.float32)
            self._line.visible = True
            along = ", ".join(f"{value:+.4f}" for value in vector(apart))
            rows = [
                ["distance", f"{np.linalg.norm(apart):.4f} m"],
                ["along the camera's axes", f"{along} m"],
            ]
            self._from = None
            self._tell(Card("distance", rows))

    def _tell(self, card: Card) -> None:
        self._page.send("card", {"title": card.title, "rows": card.rows})
