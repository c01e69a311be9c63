"""Where the files lie that a run was made from, so that run and recording can move together.

A result's ``pipeline.toml`` names them as seen from its own folder, and says where that was when it
was written: a result that moved alone still finds what stayed.
"""

import os
from collections.abc import Callable
from pathlib import Path

from pcnav.config.pipeline_file import Pipeline
from pcnav.config.region import OWN_MASKS


def relocatable(pipeline: Pipeline, folder: Path) -> Pipeline:
    """A pipeline that names its files by absolute paths, as it is stored in a folder."""
    home = folder.resolve()

    def seen_from_home(path: str) -> str:
        try:
            return Path(os.path.relpath(path, home)).as_posix()
        except ValueError:  # On another drive.
            return path

    return _moved(pipeline, seen_from_home).model_copy(update={"written_to": str(home)})


def located(pipeline: Pipeline, folder: Path) -> Pipeline:
    """A pipeline that was stored in a folder, which names its files by absolute paths again.

    What does not lie where it is seen from the folder is looked for where it was seen from when
    the pipeline was written; what is nowhere keeps the path from the folder. One that no run wrote
    is returned as it is.
    """
    if pipeline.written_to is None:
        return pipeline
    homes = folder.resolve(), Path(pipeline.written_to)

    def seen_from_here(path: str) -> str:
        places = [Path(os.path.normpath(home / path)) for home in homes]
        return str(next((place for place in places if place.exists()), places[0]))

    return _moved(pipeline, seen_from_here).model_copy(update={"written_to": None})


def _moved(pipeline: Pipeline, seen: Callable[[str], str]) -> Pipeline:
    """With every path in it as it is seen from elsewhere."""
    region = pipeline.region
    files = {
        key: seen(path)
        for key, path in (("masks", region.masks), ("background", region.background))
        if path is not None and path != OWN_MASKS
    }
    changes: dict[str, object] = {
        key: seen(path)
        for key, path in (("sequence", pipeline.sequence), ("target_mesh", pipeline.target_mesh))
        if path is not None
    }
    if files:
        changes["region"] = region.model_copy(update=files)
    return pipeline.model_copy(update=changes)
