"""What the cases of a grid are based on: pipeline and mesh of each, found where a run is made.

This is all of a grid that a run needs, so it is all that travels to another machine. Shipped files
are those of the machine that runs; files of the user's own must be at the same place there.
"""

import shlex
from dataclasses import dataclass
from pathlib import Path

from pcnav.batch.axes import SATELLITE_AXIS
from pcnav.batch.case import BatchRun, Case
from pcnav.config.pipeline_file import EstimatorKind, Pipeline, read_pipeline
from pcnav.config.shipped import (
    shipped_mesh,
    shipped_mesh_names,
    shipped_pipeline,
    shipped_pipeline_names,
)
from pcnav.core.errors import InputError


@dataclass(frozen=True)
class GridBasis:
    """The part of a grid that all cases share."""

    source: str
    """What the grid is called: a path or a shipped name."""
    folder: Path
    """That paths in the grid are relative to."""
    frames: int | None
    """Of every run; None where the duration is stated."""
    duration_s: float | None
    pipeline_name: str | None
    """Of the pipeline under all cases; None takes the one shipped with each satellite."""
    pipeline: Pipeline | None
    """Its content."""

    def command(self, run: BatchRun) -> str:
        """What repeats a run alone."""
        words = ("pcnav", "table", self.source, "--case", run.case.name, "--run", str(run.index))
        return shlex.join([*words, "-o", f"runs/{run.key}"])

    def pipeline_of(self, case: Case) -> tuple[str, Pipeline]:
        """Name and content of the pipeline that a case is based on, none of its axes applied.

        Raises `InputError` where there is none, or one that is not for depth frames.
        """
        name, pipeline = self.pipeline_name, self.pipeline
        if name is None or pipeline is None:
            name = str(_satellite(case))
            path = shipped_pipeline(name)
            if path is None:
                known = ", ".join(shipped_pipeline_names())
                expected = f"expected one of {known}, or batch.pipeline beside it, got {name}"
                raise InputError(self.source, SATELLITE_AXIS, expected)
            pipeline = read_pipeline(path)
        kind = pipeline.estimator.kind
        if kind is not EstimatorKind.DEPTH:
            expected = f'expected a pipeline for depth frames, {name} has estimator.kind = "{kind}"'
            raise InputError(self.source, "batch.pipeline", expected)
        return name, pipeline

    def mesh_of(self, case: Case) -> Path:
        """The mesh of a case's satellite. Raises `InputError` where there is none."""
        satellite = _satellite(case)
        if satellite is None:
            name, pipeline = self.pipeline_of(case)
            satellite = pipeline.target_mesh
            if satellite is None:
                expected = f"expected this axis, as {name} has no target_mesh"
                raise InputError(self.source, SATELLITE_AXIS, expected)
        beside = self.folder / satellite
        found = beside if beside.is_file() else shipped_mesh(satellite)
        if found is None:
            known = ", ".join(shipped_mesh_names())
            expected = f"expected a mesh file or one of {known}, got {satellite}"
            raise InputError(self.source, SATELLITE_AXIS, expected)
        return found

    def frames_at(self, frame_rate_hz: float) -> int:
        """Frames of a run; two at least."""
        if self.frames is not None:
            return self.frames
        assert self.duration_s is not None, "a grid file states one of them"
        return max(2, round(self.duration_s * frame_rate_hz))


def stated_pipeline(name: str, folder: Path, grid: Path) -> Pipeline:
    """The pipeline that a grid names, its mesh as an absolute path where it is a file.

    Raises `InputError`, naming the grid where there is no such pipeline.
    """
    beside = folder / name
    path = beside if beside.is_file() else shipped_pipeline(name)
    if path is None:
        known = ", ".join(shipped_pipeline_names())
        raise InputError(grid, "batch.pipeline", f"expected a file or one of {known}, got {name}")
    pipeline = read_pipeline(path)
    mesh = path.parent / (pipeline.target_mesh or "")
    if not mesh.is_file():
        return pipeline
    return pipeline.model_copy(update={"target_mesh": str(mesh.resolve())})


def _satellite(case: Case) -> str | None:
    value = dict(case.axes).get(SATELLITE_AXIS)
    return None if value is None else str(value)
