"""Which images of a BOP data set are asked for which objects: its targets file."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from pcnav.core.errors import InputError
from pcnav.files.regular_file import read_bytes

TARGETS_FILE = "test_targets_bop19.json"
"""In the folder of the data set; it is about the scenes of its test split."""
_TEST = "test"
_MAX_BYTES = 200_000_000
_Number = Annotated[int, Field(ge=0, le=999_999_999)]


class _Entry(BaseModel):
    # The number of instances, and what other producers add.
    model_config = ConfigDict(frozen=True, extra="ignore", strict=True)

    scene_id: _Number
    im_id: _Number
    obj_id: _Number


_ENTRIES = TypeAdapter(list[_Entry])


@dataclass(frozen=True)
class SceneTargets:
    """What is asked of one scene."""

    images: Mapping[int, frozenset[int]]
    """By obj_id, the numbers of the images in which it is asked for."""

    @property
    def objects(self) -> tuple[int, ...]:
        """In order."""
        return tuple(sorted(self.images))


def targets_of(scene: Path) -> SceneTargets | None:
    """What the data set of a scene asks of it; None where no targets file is about it.

    Raises `InputError` for a targets file that is none.
    """
    place = scene.resolve()
    path = place.parent.parent / TARGETS_FILE
    is_test = place.parent.name.partition("_")[0] == _TEST
    if not (is_test and place.name.isascii() and place.name.isdecimal() and path.is_file()):
        return None
    try:
        entries = _ENTRIES.validate_json(read_bytes(path, _MAX_BYTES))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "file"
        raise InputError(path, where, f"expected a list of targets ({first['msg']})") from error
    images: dict[int, set[int]] = {}
    for entry in entries:
        if entry.scene_id == int(place.name):
            images.setdefault(entry.obj_id, set()).add(entry.im_id)
    return SceneTargets({number: frozenset(asked) for number, asked in images.items()})
