"""The report of a run of any kind."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from matplotlib.figure import Figure

from pcnav.dynamics.blocks import CENTRE, POSITION, RATIOS, ROTATION_LAYOUT
from pcnav.evaluation.knowledge import RunKnowledge
from pcnav.evaluation.metrics import Metrics
from pcnav.files.text_table import TextTable
from pcnav.report import attitude_report, depth_report, feature_report, from_run, image_report
from pcnav.runs.reader import count_outcomes
from pcnav.runs.run import Run
from pcnav.target.satellite import Target
from pcnav.target.symmetry import group_name


@dataclass(frozen=True)
class ReportContent:
    """What a report is made from."""

    title: str
    """Name of the recording."""
    command: str
    """How the run was started, as typed."""
    run: Run
    """With its covariances when the NEES is to be drawn."""
    metrics: Metrics
    target: Target | None
    """Of depth frames."""
    configuration: Mapping[str, object]
    """The pipeline as nested tables."""
    versions: Mapping[str, str]
    knowledge: RunKnowledge | None = None
    """None without an estimate, and of a run without a prior of the mass."""
    observability: tuple[TextTable, ...] = ()
    """What the motion makes observable; empty without an estimate."""
    picture: Figure | None = None
    """A frame drawn by `frame_picture`."""
    picture_caption: str = ""


def write_report(path: Path, content: ReportContent) -> None:
    """Write the page of a run: UTF-8 HTML that loads nothing from elsewhere."""
    path.write_text(_html(content), encoding="utf-8")


def _html(content: ReportContent) -> str:
    trajectory, found = content.run.trajectory, content.metrics.errors
    if content.target is not None or CENTRE in trajectory.layout:
        return _of_depth(content)
    common = {
        "title": content.title,
        "command": content.command,
        "metrics": content.metrics,
        "configuration": content.configuration,
        "versions": content.versions,
        "observability": content.observability,
    }
    if POSITION in trajectory.layout:
        of_features = feature_report.FeatureReport(
            **common,  # type: ignore[arg-type]
            estimator=content.run.estimator,
            track=from_run.feature_track_of(content.run),
            errors=found,
        )
        return feature_report.feature_report_html(of_features)
    if RATIOS in trajectory.layout:
        words = Counter(content.run.words.get("outcome", ()))
        of_attitudes = attitude_report.AttitudeReport(
            **common,  # type: ignore[arg-type]
            track=from_run.attitude_track_of(content.run),
            errors=None if found is None else from_run.stacked(found, ROTATION_LAYOUT),
            outcomes=words.most_common(),
        )
        return attitude_report.attitude_report_html(of_attitudes)
    of_images = image_report.ImageReport(
        **common,  # type: ignore[arg-type]
        track=from_run.image_track_of(content.run),
        errors=found,
    )
    return image_report.image_report_html(of_images)


def _of_depth(content: ReportContent) -> str:
    target, folder = content.target, content.run.folder
    return depth_report.report_html(
        depth_report.ReportContent(
            title=content.title,
            target="" if target is None else target.name,
            command=content.command,
            track=from_run.track_of(content.run),
            outcomes=Counter() if folder is None else count_outcomes(folder),
            metrics=content.metrics,
            configuration=content.configuration,
            versions=content.versions,
            symmetry="C1" if target is None else group_name(target.symmetry_transforms),
            knowledge=content.knowledge,
            observability=content.observability,
            picture=content.picture,
            picture_caption=content.picture_caption,
        )
    )
