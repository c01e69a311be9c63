"""BOP: the results of the BOP challenge's pose tasks, as bop_toolkit scores them."""

import re
from pathlib import Path

import numpy as np

from pcnav.core.errors import InputError
from pcnav.recordings.bop_scene import OBJECT_ID
from pcnav.runs.export.content import Export, Files

ABOUT = (
    "scene_id,im_id,obj_id,score,R,t,time a line: R the nine numbers of R_cam_model row by row, t "
    "in mm, score the share of the frame's pixels that the pose explains (1 where the estimator "
    "does not tell), time -1 (not measured). scene_id is the number that names the scene's folder, "
    "else 1; obj_id the one that --object named, else 1. bop_toolkit wants the name "
    "METHOD_DATASET-SPLIT.csv."
)
HEADER = "scene_id,im_id,obj_id,score,R,t,time"
_MM = 1000.0


def write_bop_csv(export: Export) -> Files:
    """A line a pose. Raises `InputError` where the recording does not number its images."""
    frames, poses = export.poses()
    recording = export.recording
    if recording is None:
        expected = "expected the recording, whose images the lines are of; --sequence says where"
        raise InputError(export.source, "recording", expected)
    scores = export.run.notes.get("inlier_ratio")
    scene = scene_number(recording.path)
    target = OBJECT_ID if recording.object_id is None else recording.object_id
    lines = [HEADER]
    for frame, T in zip(frames.tolist(), poses, strict=True):
        score = 1.0 if scores is None or np.isnan(scores[frame]) else float(scores[frame])
        R, t = (" ".join(map(repr, x.ravel().tolist())) for x in (T[:3, :3], _MM * T[:3, 3]))
        image = _number(recording.files[frame], export)
        lines.append(f"{scene},{image},{target},{score!r},{R},{t},-1")
    return {"": ("\n".join(lines) + "\n").encode()}


def scene_number(path: Path) -> int:
    """The number that names the folder of a scene; 1 where its name is none."""
    name = path.resolve().name
    return int(name) if re.fullmatch(r"\d{1,9}", name) else 1


def image_number(file: str) -> int | None:
    """The number that names an image; None without any."""
    found = re.search(r"\d+", Path(file).name)
    return None if found is None else int(found[0])


def _number(file: str, export: Export) -> int:
    number = image_number(file)
    if number is None:
        expected = f"expected images that are numbered, got {file}"
        raise InputError(export.source, "recording", expected)
    return number
