"""The panel at the right of one browser: image and plots at once, the frame, what is known."""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import viser

from pcnav.runs.feature_outcomes import FeatureOutcomes
from pcnav.viewer.controls import set_value
from pcnav.viewer.features_told import counts_text, features_html
from pcnav.viewer.frames import Shot
from pcnav.viewer.knowledge import knowledge_html
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.page import PLOTS_HTML
from pcnav.viewer.palette import (
    ACCEPTED_COLOUR,
    MASS_CENTRE,
    REJECTED_COLOUR,
    SENSOR,
    coloured,
)
from pcnav.viewer.panels import facts_html, frame_picture, measurements_html
from pcnav.viewer.plots import choices, plots_of
from pcnav.viewer.render_options import RenderOptions

_WIDTH_PX = 430


class SidePanel:
    """The panel of one browser."""

    def __init__(
        self, gui: viser.GuiApi, runs: tuple[LoadedRun, ...], on_choice: Callable[[], None]
    ) -> None:
        panel = gui.add_panel()
        with panel.add_tab("Image and plots"):
            self._picture: npt.NDArray[np.uint8] = np.zeros((8, 8, 3), dtype=np.uint8)
            self._image = gui.add_image(self._picture, format="png", visible=False)
            self._legend = gui.add_html("", visible=False)
            self._choice = gui.add_dropdown("plots", choices(runs))
            gui.add_html(PLOTS_HTML)
            self._key = gui.add_html("")
        with panel.add_tab("Frame"):
            self._facts = [gui.add_html("") for _ in runs]
            self._measurements = gui.add_html("")
        with panel.add_tab("Known"):
            self._known = gui.add_html("")
        panel.dock_right()
        panel.set_width(_WIDTH_PX)
        self._choice.on_update(lambda _: on_choice())
        self.show_known(runs)

    @property
    def chosen(self) -> str:
        """The group of plots."""
        return str(self._choice.value)

    def choose(self, name: str) -> None:
        """Another group of plots, if there is such a one."""
        if name in self._choice.options:
            set_value(self._choice, name)

    def plots(self, runs: tuple[LoadedRun, ...]) -> dict[str, Any]:
        """The chosen group for the page; its key is shown here."""
        found = plots_of(runs, self.chosen)
        self._key.content = found.key
        return found.data

    def show_known(self, runs: tuple[LoadedRun, ...]) -> None:
        """What is known after the run."""
        self._known.content = "".join(knowledge_html(loaded) for loaded in runs)

    def show(
        self, runs: tuple[LoadedRun, ...], frame: int, shot: Shot | None, options: RenderOptions
    ) -> None:
        """Picture, facts and measurements of a frame."""
        first = runs[0]
        records = first.records_at(frame)
        for k, (loaded, facts) in enumerate(zip(runs, self._facts, strict=True)):
            at = frame if k == 0 else loaded.nearest_frame(float(first.run.time_s[frame]))
            facts.content = "" if at is None else facts_html(loaded, at, options.magnified)
        outcomes = first.outcomes_at(frame)
        if first.target is not None:
            self._measurements.content = measurements_html(records)
        elif outcomes is not None:
            self._measurements.content = features_html(outcomes, first.frame_outcome(frame))
        if shot is not None and first.frames is not None:
            scale_m = options.residual_scale_m or first.frames.scale_m
            self._show_picture(frame_picture(shot, records, options.colour_by, scale_m))
        elif first.tracked is not None:
            pose = first.pose(frame) if first.trajectory.T_cam_target is not None else None
            time_s = float(first.run.time_s[frame])
            self._show_picture(first.tracked.picture(time_s, first.features, pose, outcomes))
            self._legend.content = _tracks_legend(outcomes, has_points=pose is not None)
        has_picture = shot is not None or first.tracked is not None
        self._image.visible = has_picture
        self._legend.visible = shot is None and has_picture

    def _show_picture(self, picture: npt.NDArray[np.uint8]) -> None:
        # A page that is sent the same again throws away what it is still loading, and complains.
        if not np.array_equal(picture, self._picture):
            self._image.image = self._picture = picture


def _tracks_legend(outcomes: FeatureOutcomes | None, *, has_points: bool) -> str:
    """What the colours of tracks mean, and how many there are of each."""
    used, rejected, seen = (
        coloured("●", colour) for colour in (ACCEPTED_COLOUR, REJECTED_COLOUR, SENSOR)
    )
    if outcomes is None:
        text = f"tracks over 12 frames: {used} used, {rejected} mostly rejected, {seen} not told"
    else:
        words = zip((used, rejected, seen), counts_text(outcomes).split(", "), strict=True)
        text = f"tracks over 12 frames: {', '.join(f'{dot} {word}' for dot, word in words)}"
        text += "; click at one for the reason"
    if has_points:
        text += f"; {coloured('+', MASS_CENTRE)} where the final points of the estimate should be"
    return f"<div style='font-size:12px;padding:0 10px'>{text}</div>"
