"""Options of ``pcnav run`` for depth frames: what is left of them, and whether they may be bad."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from pcnav.config.pipeline_file import Pipeline
    from pcnav.config.region import RegionTable

Masks = Annotated[
    str | None,
    typer.Option(
        "--masks",
        metavar="DIR|visib",
        help="Folder of PNG masks of the target, named after the frames; or visib, the mask_visib "
        "of a BOP scene, which are part of its truth.",
    ),
]
MinRange = Annotated[
    float | None, typer.Option("--min-range", help="Nothing is known of what is nearer, m.")
]
MaxRange = Annotated[
    float | None, typer.Option("--max-range", help="What is farther is not the target, m.")
]
Box = Annotated[
    tuple[int, int, int, int] | None,
    typer.Option(
        "--box",
        metavar="U0 V0 U1 V1",
        help="Pixels that are looked at: columns U0 to U1 - 1, rows V0 to V1 - 1.",
    ),
]
Background = Annotated[
    Path | None,
    typer.Option("--background", help="Depth image of the scene without the target."),
]
SkipBadFrames = Annotated[
    bool,
    typer.Option(
        "--skip-bad-frames", help="Coast over damaged and missing depth images, and list them."
    ),
]


def with_frame_options(
    pipeline: "Pipeline | None",
    source: Path,
    *,
    masks: str | None = None,
    min_range: float | None = None,
    max_range: float | None = None,
    box: tuple[int, int, int, int] | None = None,
    background: Path | None = None,
    skip_bad_frames: bool = False,
) -> "Pipeline | None":
    """The pipeline of a file with what the options say; files that it names lie beside it.

    Raises `InputError` for options that contradict each other or the pipeline.
    """
    from pcnav.config.pipeline_file import Pipeline
    from pcnav.config.region import RegionTable
    from pcnav.files.toml_file import checked

    options: dict[str, Any] = {
        **{"masks": masks, "min_range_m": min_range, "max_range_m": max_range, "box_px": box},
        **{"background": None if background is None else str(background)},
    }
    said = {key: value for key, value in options.items() if value is not None}
    if not said and not skip_bad_frames:
        return None if pipeline is None else _beside(pipeline, source)
    pipeline = _beside(pipeline or Pipeline(), source)
    stated = pipeline.region.model_dump(exclude_none=True)
    changes: dict[str, Any] = {"region": checked("options", RegionTable, {**stated, **said})}
    if skip_bad_frames:
        changes["skip_bad_frames"] = True
    return pipeline.model_copy(update=changes)


def _beside(pipeline: "Pipeline", source: Path) -> "Pipeline":
    """A pipeline whose region names its files as seen from here."""
    return pipeline.model_copy(update={"region": _region_beside(pipeline.region, source)})


def _region_beside(region: "RegionTable", source: Path) -> "RegionTable":
    from pcnav.config.region import OWN_MASKS

    changes = {
        key: str(source.parent / file)
        for key, file in (("masks", region.masks), ("background", region.background))
        if file is not None and file != OWN_MASKS
    }
    return region.model_copy(update=changes)
