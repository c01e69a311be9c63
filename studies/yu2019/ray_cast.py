"""The paper's method on what a depth camera returns: ray-cast frames, not idealised clouds."""

from dataclasses import dataclass

from pcnav.batch.cluster import Workers
from pcnav.config.depth import PerceptionMode
from pcnav.config.pipeline_file import Pipeline

from ..folder import Chapter, StudyFigure
from ..panels import error_panel, panels_figure
from ..progress import Progress
from .boxsat import SequenceErrors, pose_errors, pose_table, sequence_errors, sequence_table
from .panel import PanelErrors, panel_errors, panel_table


@dataclass(frozen=True)
class RayCastResult:
    """Ray-cast frames and what they come to."""

    chapter: Chapter
    panel: PanelErrors
    """At the paper's noise, area-weighted."""


def ray_cast_chapter(
    runs: int, panel: Pipeline, boxsat: Pipeline, workers: Workers, progress: Progress
) -> RayCastResult:
    """Single frames of a panel and of a satellite, and the filter on a sequence of the latter."""
    panels = panel_errors(runs, panel, workers, progress)
    poses = pose_errors(max(1, runs // 2), boxsat, workers, progress)
    sequences = sequence_errors(boxsat, workers, progress)
    chapter = Chapter(
        "Ray-cast depth frames: what a depth camera would give",
        _TEXT,
        (panel_table(panels), pose_table(poses), sequence_table(sequences)),
        tuple(
            _figure(each)
            for each in sequences
            if each.mode is PerceptionMode.AREA_WEIGHTED and (each.pose_m == each.pose_m).any()
        ),
    )
    best = next(
        p
        for p in panels
        if p.mode is PerceptionMode.AREA_WEIGHTED and p.noise_m == panels[0].noise_m
    )
    return RayCastResult(chapter, best)


def _figure(sequence: SequenceErrors) -> StudyFigure:
    known = sequence.pose_m == sequence.pose_m
    time_s = sequence.time_s[known]
    errors = 1e3 * sequence.errors[known, 6:9]
    half = len(time_s) // 2
    panels = [error_panel("model origin, mm", 1e3 * sequence.pose_m[known], settled_from=half)]
    panels += [
        error_panel(f"mass centre {a}, mm", errors[:, k], settled_from=half)
        for k, a in enumerate("xyz")
    ]
    key = f"boxsat_{1e3 * sequence.noise_m:03.0f}mm"
    title = f"Whole satellite, range noise {sequence.noise_m:g} m, area-weighted"
    caption = (
        "Pose in the camera (norm of the error) and mass centre; the second half sets the axes."
    )
    return panels_figure(key, title, caption, time_s, panels)


_TEXT = (
    "The paper simulates points that are spread evenly over the face. A depth camera does not: "
    "it has more pixels on the near end of an oblique face than on the far end, so plain means "
    "put the centroid centimetres towards the near end at any noise, and noise along the ray "
    "leaks into the plane. `paper` mode is the paper's method as it stands; `area_weighted` "
    "slides each point along its ray onto the fitted plane and weighs it with the area its pixel "
    "covers.",
    "Isolated panel: the tilt about the long side rests on half of 1.5 m as its arm. With 3200 "
    "pixels of 0.1 m noise no method that uses the ranges alone can tell it to better than 0.23 "
    "degrees facing the sensor (less at an angle, as the noise is along the ray): the stated "
    "column is that bound for the frames shown.",
    "Whole satellite: at 0.1 m the noise is a sixteenth of the bus. RANSAC therefore looks at "
    "returns averaged over squares of pixels, or it would join returns of several faces into "
    "planes that are not there. The paper's way then recognises each plane by its size, which "
    "hidden parts and rims change; the area-weighted mode reads the frame again with the planes "
    "of the hypothesis it starts from, and compares every face with the view expected of it.",
)
