"""The shipped pipelines that studies start from."""

from pcnav.config.pipeline_file import Pipeline, read_pipeline
from pcnav.config.shipped import shipped_pipeline
from pcnav.core.errors import InputError


def shipped(name: str) -> Pipeline:
    """A shipped pipeline. Raises `InputError` when it is missing or bad."""
    path = shipped_pipeline(name)
    if path is None:
        raise InputError(f"{name}.toml", "pipeline", "expected it among the shipped pipelines")
    return read_pipeline(path)


def with_scenario(pipeline: Pipeline, **changes: float) -> Pipeline:
    """The pipeline with other fields of its scenario, such as ``frames``."""
    return pipeline.model_copy(
        update={"scenario": pipeline.scenario.model_copy(update=dict(changes))}
    )


def shortened(pipeline: Pipeline, frames: int | None) -> Pipeline:
    """The pipeline with at most so many frames; None leaves it as it is."""
    if frames is None or frames >= pipeline.scenario.frames:
        return pipeline
    return with_scenario(pipeline, frames=frames)
