"""The models of a BOP data set: their files, in millimetres, and what it says of their symmetry."""

import json
import re
from pathlib import Path
from typing import NoReturn

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import nearest_orthogonal, orthonormality_error
from pcnav.recordings.bop_scene import SCENE_CAMERA_FILE
from pcnav.recordings.frame_checks import ROTATION_TOLERANCE

_FOLDERS = ("models", "models_cad", "models_fine", "models_eval", "models_reconst")
"""Finest first: those for evaluation are thinned out."""
_MODEL = re.compile(r"obj_(\d{6})\.ply")
_INFO_FILE = "models_info.json"
_MAX_BYTES = 10_000_000


def model_of(scene: Path, object_id: int | None) -> Path | None:
    """The model of an object in the data set that a scene belongs to; None where there is none.

    Without an object that of the only one of the data set.
    """
    data_set = scene.resolve().parent.parent
    for folder in (data_set / name for name in _FOLDERS):
        if not folder.is_dir():
            continue
        matches = (_MODEL.fullmatch(file.name) for file in sorted(folder.iterdir()))
        models = {int(match[1]): folder / match[0] for match in matches if match is not None}
        if object_id in models:
            return models[object_id]
        if object_id is None and len(models) == 1:
            return next(iter(models.values()))
    return None


def is_models(path: Path) -> bool:
    """Whether a folder holds the models of a data set: a PLY may be a cloud, too."""
    return path.is_dir() and any(_MODEL.fullmatch(file.name) for file in path.iterdir())


def scenes_of(path: Path) -> tuple[Path, ...]:
    """Scenes below a folder of them, or of several such folders: a split, or a data set."""
    if not path.is_dir():
        return ()
    found = (path.glob(f"{below}/{SCENE_CAMERA_FILE}") for below in ("*", "*/*"))
    return tuple(sorted(file.parent for files in found for file in files))


def refuse_data_set(path: Path, *_: object) -> NoReturn:
    """Raises `InputError`, which says what scenes a data set has."""
    scenes = [scene.relative_to(path).as_posix() for scene in scenes_of(path)]
    expected = "expected one scene of the data set"
    last = "" if len(scenes) == 1 else f" to {scenes[-1]}"
    got = f"it has {len(scenes)} ({scenes[0]}{last})"
    raise InputError(path, "scene", f"{expected}, such as {path / scenes[0]}; {got}")


def stated_symmetries(model: Path) -> tuple[FloatArray, int] | None:
    """(n, 4, 4) discrete symmetries, the identity first, m, and how many axes the model is round
    about, as models_info.json beside a model says; None where it says nothing.

    Raises `InputError`.
    """
    path, match = model.parent / _INFO_FILE, _MODEL.fullmatch(model.name)
    if match is None or not path.is_file():
        return None
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise ValueError(f"over {_MAX_BYTES:,} bytes")
        entry = json.loads(path.read_text(encoding="utf-8")).get(str(int(match[1])))
        if entry is None:
            return None
        rows = np.array(entry.get("symmetries_discrete", []), dtype=np.float64)
        T = np.concatenate([np.eye(4)[None], rows.reshape(-1, 4, 4)])
        round_about = len(entry.get("symmetries_continuous", []))
    except (OSError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(path, match[1], f"expected what BOP says of a model ({error})") from error
    if not (orthonormality_error(T[:, :3, :3]) <= ROTATION_TOLERANCE).all():
        expected = "expected rigid transforms, sixteen numbers each"
        raise InputError(path, f"{int(match[1])}.symmetries_discrete", expected)
    T[:, :3, :3] = nearest_orthogonal(T[:, :3, :3])
    T[:, :3, 3] /= 1000.0
    return T, round_about
