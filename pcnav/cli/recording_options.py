"""Options for recordings that do not say all of themselves, and of which frames are taken."""

from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from pcnav.config.pipeline_file import Pipeline
    from pcnav.config.recording import RecordingTable

Camera = Annotated[
    tuple[float, float, float, float] | None,
    typer.Option(
        "--camera",
        metavar="FX FY CX CY",
        help="Intrinsics of the depth images, px, where no file beside them says them.",
    ),
]
Unit = Annotated[
    float | None, typer.Option("--unit", help="Metres of one stored unit of depth, like 0.001.")
]
Rate = Annotated[
    float | None, typer.Option("--rate", help="Frames a second, where there are no time stamps.")
]
Topic = Annotated[
    str | None, typer.Option("--topic", help="Of a bag: the depth images or organised clouds.")
]
CameraTopic = Annotated[
    str | None, typer.Option("--camera-topic", help="Of a bag: the CameraInfo of the images.")
]
Object = Annotated[
    int | None,
    typer.Option("--object", min=0, help="obj_id of the target among those of a BOP scene."),
]
Start = Annotated[int, typer.Option("--start", min=0, help="First frame that is taken, from 0.")]
Frames = Annotated[
    int | None, typer.Option("--frames", min=1, help="How many frames are taken at most.")
]
Every = Annotated[int, typer.Option("--every", min=1, help="Take every so many frames.")]


def options_of(
    camera: tuple[float, float, float, float] | None,
    unit: float | None,
    rate: float | None,
    topic: str | None,
    camera_topic: str | None,
    object_: int | None,
    start: int,
    frames: int | None,
    every: int,
) -> dict[str, Any]:
    """What these options are called in the table of a recording."""
    return {
        "camera_px": camera,
        "unit_m": unit,
        "frame_rate_hz": rate,
        "topic": topic,
        "camera_topic": camera_topic,
        "object": object_,
        "start": start,
        "frames": frames,
        "every": every,
    }


def recording_table(base: "RecordingTable | None" = None, **options: Any) -> "RecordingTable":
    """What options say of a recording, over what a table says. Raises `InputError`."""
    from pcnav.config.recording import AS_IT_IS, RecordingTable
    from pcnav.files.toml_file import checked

    stated = (base or AS_IT_IS).model_dump()
    said = {key: value for key, value in options.items() if value != getattr(AS_IT_IS, key)}
    return checked("options", RecordingTable, {**stated, **said})


def with_recording_options(pipeline: "Pipeline | None", **options: Any) -> "Pipeline | None":
    """A pipeline with what the options say of the recording; as it is where they say nothing."""
    from pcnav.config.pipeline_file import Pipeline

    base = pipeline or Pipeline()
    table = recording_table(base.recording, **options)
    return pipeline if table == base.recording else base.model_copy(update={"recording": table})
