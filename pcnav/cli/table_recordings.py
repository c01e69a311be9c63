"""``pcnav table`` over recordings that lie in files."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pcnav.cli.names import mesh_of_pipeline, named_mesh, named_pipeline
from pcnav.config.length_unit import LengthUnit
from pcnav.core.errors import InputError

if TYPE_CHECKING:
    from pcnav.batch.recordings import RecordingsPlan

BATCH_FILE = "batch.json"
"""What tells the folder of a batch."""

Estimators = Annotated[
    str | None,
    typer.Option("--estimator", help="Of recordings: estimators, like depth,open3d_icp."),
]
TargetOf = Annotated[
    str | None,
    typer.Option("--target", help="Of recordings: the mesh, where they do not name their own."),
]
PipelineOf = Annotated[
    str | None, typer.Option("--pipeline", help="Of recordings: the settings of the estimators.")
]
Objects = Annotated[
    str | None,
    typer.Option(
        "--object",
        help="Of a BOP data set: obj_id of the targets, like 1,5; else those of its targets file.",
    ),
]


def plan_of_recordings(folder: Path, options: Mapping[str, object]) -> "RecordingsPlan":
    """The recordings below a folder, as the options say. Raises `InputError`."""
    from pcnav.batch.recordings import recordings_plan
    from pcnav.config.pipeline_file import Pipeline

    path, pipeline = Path("pipeline"), Pipeline()
    mesh = options["--target"]
    if options["--pipeline"] is not None:
        path, pipeline = named_pipeline(str(options["--pipeline"]))
    found = None if mesh is None else named_mesh(str(mesh))
    if mesh is None and pipeline.target_mesh is not None:
        place = mesh_of_pipeline(path, pipeline.target_mesh)
        pipeline = pipeline.model_copy(update={"target_mesh": str(place)})
    estimators = options["--estimator"]
    names = str(pipeline.estimator.kind) if estimators is None else str(estimators)
    unit = options["--mesh-unit"]
    words = [str(w) for name, value in options.items() if value is not None for w in (name, value)]
    return recordings_plan(
        folder,
        [name.strip() for name in names.split(",") if name.strip()],
        pipeline,
        objects=_objects(options["--object"]),
        mesh=found,
        mesh_unit=unit if isinstance(unit, LengthUnit) else None,
        words=words,
    )


def _objects(text: object) -> list[int]:
    words = [] if text is None else [word.strip() for word in str(text).split(",")]
    if not all(word.isascii() and word.isdecimal() and len(word) < 7 for word in words):
        raise InputError("pcnav table", "--object", f"expected numbers like 1,5, got {text}")
    if len(set(words)) < len(words):
        raise InputError("pcnav table", "--object", "expected every object once")
    return [int(word) for word in words]
