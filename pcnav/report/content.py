"""What the report of a run is made from."""

from collections.abc import Mapping
from dataclasses import dataclass

from matplotlib.figure import Figure

from pcnav.evaluation.answer.model import Answer
from pcnav.evaluation.information_gain import InformationGain
from pcnav.evaluation.metrics import Metrics
from pcnav.files.text_table import TextTable
from pcnav.perception.part_fit import PartFit
from pcnav.runs.run import Run


@dataclass(frozen=True)
class ReportContent:
    """All that the sections of a report choose from."""

    title: str
    """Name of the recording."""
    command: str
    """How the run was started, as typed."""
    answer: Answer
    """What the run found, and the warnings about it."""
    run: Run
    """With its covariances when the NEES is to be drawn."""
    metrics: Metrics
    """With the errors behind them where there is a truth."""
    configuration: Mapping[str, object]
    """The pipeline as nested tables."""
    versions: Mapping[str, str]
    gain: InformationGain | None = None
    """What the data told of every state; None without an estimate or without a prior."""
    parts: tuple[PartFit, ...] = ()
    """Of the target, against the frames; empty without a mesh or a claim."""
    observability: tuple[TextTable, ...] = ()
    """What the motion makes observable; empty without an estimate."""
    picture: Figure | None = None
    """A frame drawn by `frame_picture`."""
    picture_caption: str = ""
