"""The panel at the right of one browser: image and plots at once, the frame, what is known."""

from collections.abc import Callable
from typing import Any

import numpy as np
import viser

from pcnav.viewer.controls import set_value
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
_TRACKS_LEGEND = (
    "<div style='font-size:12px;padding:0 10px'>"
    f"tracks over 12 frames: {coloured('●', ACCEPTED_COLOUR)} used, "
    f"{coloured('●', REJECTED_COLOUR)} mostly rejected, {coloured('●', SENSOR)} not told; "
    f"{coloured('+', MASS_CENTRE)} where the final points of the estimate should be</div>"
)


class SidePanel:
    """The panel of one browser."""

    def __init__(
        self, gui: viser.GuiApi, runs: tuple[LoadedRun, ...], on_choice: Callable[[], None]
    ) -> None:
        panel = gui.add_panel()
        with panel.add_tab("Image and plots"):
            nothing = np.zeros((8, 8, 3), dtype=np.uint8)
            self._image = gui.add_image(nothing, format="png", visible=False)
            self._legend = gui.add_html(_TRACKS_LEGEND, visible=False)
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
        if first.target is not None:
            self._measurements.content = measurements_html(records)
        if shot is not None and first.frames is not None:
            scale_m = options.residual_scale_m or first.frames.scale_m
            self._image.image = frame_picture(shot, records, options.colour_by, scale_m)
        elif first.tracked is not None:
            pose = first.pose(frame) if first.trajectory.T_cam_target is not None else None
            time_s = float(first.run.time_s[frame])
            self._image.image = first.tracked.picture(time_s, first.features, pose)
        has_picture = shot is not None or first.tracked is not None
        self._image.visible = has_picture
        self._legend.visible = shot is None and has_picture
