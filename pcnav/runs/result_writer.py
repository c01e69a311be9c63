"""Writes a result folder frame by frame: memory does not grow with the length of the run.

A result folder is either whole or not there: see `pcnav.files.new_folder`.
"""

import csv
import json
import math
import shutil
import zipfile
from array import array
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import TracebackType
from typing import Self, TextIO

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import xyzw_from_rotation
from pcnav.dynamics.state import STATE_SIZE, NavigationState
from pcnav.files.new_folder import new_folder
from pcnav.recordings.truth import STATE_COLUMNS
from pcnav.runs.results import (
    COVARIANCES_FILE,
    MEASUREMENT_COLUMNS,
    MEASUREMENTS_FILE,
    POSE_COLUMNS,
    POSES_FILE,
    SD_COLUMNS,
    SD_ORDER,
    STATES_FILE,
    TRACK_COLUMNS,
    FrameEstimate,
    RectangleRecord,
)

_RAW_COVARIANCES_FILE = "covariances.partial"


class ResultWriter:
    """Streams a run to a result folder; a context manager.

    Leaving the ``with`` block normally puts the folder in place, leaving it by an exception
    removes all that was written and keeps an earlier folder as it was. Usage::

        with ResultWriter(folder) as writer:
            for estimate in run:
                writer.add(estimate)
            staging = writer.finish_tables()
            track = read_track(staging)
            writer.write_json(METRICS_FILE, ...)

    Raises `InputError` on entry when the folder holds anything and ``overwrite`` is false, or
    when it holds something other than an earlier run.
    """

    def __init__(self, folder: Path, overwrite: bool = False) -> None:
        self._place = new_folder(folder, overwrite, STATES_FILE)
        self._open_files = ExitStack()
        self._estimate_times = array("d")
        self._finished = False

    def __enter__(self) -> Self:
        with ExitStack() as begun:
            self._staging = begun.enter_context(self._place)
            begun.enter_context(self._tables())
            self._begun = begun.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._begun.__exit__(kind, error, trace)

    def add(self, estimate: FrameEstimate) -> None:
        """Append one frame. Only between entry and `finish_tables`."""
        if self._finished:
            raise RuntimeError("frames cannot be added after finish_tables()")
        self._states.writerow(_state_row(estimate))
        self._measurements.writerows(_measurement_row(record) for record in estimate.records)
        if estimate.T_cam_model is not None and estimate.covariance is not None:
            pose = [estimate.time_s, *_pose_fields(estimate.T_cam_model)]
            self._poses.write(" ".join(repr(float(value)) for value in pose) + "\n")
            P = np.ascontiguousarray(estimate.covariance, dtype=np.float64)
            if P.shape != (STATE_SIZE, STATE_SIZE):
                raise ValueError(f"frame {estimate.index}: covariance of shape {P.shape}")
            self._covariances.write(P.tobytes())
            self._estimate_times.append(estimate.time_s)

    def finish_tables(self) -> Path:
        """Complete the streamed files; the folder returned can then be read and added to.

        It is temporary: it takes its final name when the ``with`` block ends.
        """
        if not self._finished:
            self._finished = True
            self._open_files.close()
            self._pack_covariances()
        return self._staging

    def write_text(self, name: str, text: str) -> None:
        """Write a text file of the result folder."""
        (self._staging / name).write_text(text, encoding="utf-8")

    def write_json(self, name: str, content: Mapping[str, object]) -> None:
        """Write a JSON file of the result folder. Raises ``ValueError`` on nan and infinity."""
        self.write_text(name, json.dumps(content, indent=2, allow_nan=False) + "\n")

    @contextmanager
    def _tables(self) -> Iterator[None]:
        """Open files, completed where the block ends well and closed in any case."""
        with self._open_files as files:
            states = files.enter_context(_new_text_file(self._staging / STATES_FILE))
            measurements = files.enter_context(_new_text_file(self._staging / MEASUREMENTS_FILE))
            self._poses = files.enter_context(_new_text_file(self._staging / POSES_FILE))
            raw_covariances = (self._staging / _RAW_COVARIANCES_FILE).open("wb")
            self._covariances = files.enter_context(raw_covariances)
            self._states = csv.writer(states, lineterminator="\n")
            self._states.writerow(TRACK_COLUMNS)
            self._measurements = csv.writer(measurements, lineterminator="\n")
            self._measurements.writerow(MEASUREMENT_COLUMNS)
            yield
            self.finish_tables()

    def _pack_covariances(self) -> None:
        """Copy the raw covariances behind the header that needed to know their count."""
        raw = self._staging / _RAW_COVARIANCES_FILE
        shape = (len(self._estimate_times), STATE_SIZE, STATE_SIZE)
        header = {"descr": "<f8", "fortran_order": False, "shape": shape}
        with zipfile.ZipFile(self._staging / COVARIANCES_FILE, "w") as archive:
            with raw.open("rb") as source, archive.open("P.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array_header_1_0(member, header)
                shutil.copyfileobj(source, member)
            with archive.open("time_s.npy", "w") as member:
                np.lib.format.write_array(member, np.frombuffer(self._estimate_times, dtype="<f8"))
        raw.unlink()


def _new_text_file(path: Path) -> TextIO:
    return path.open("w", encoding="utf-8", newline="")


def _state_row(estimate: FrameEstimate) -> list[float | int | str]:
    """One row of states.csv; the csv module writes a float with all its digits."""
    row: list[float | int | str] = []
    if estimate.state is None or estimate.covariance is None:
        row += [float(estimate.time_s), *[""] * len(STATE_COLUMNS[1:] + SD_COLUMNS)]
    else:
        # Rounding may leave a variance that should be zero slightly below it.
        sd = np.sqrt(np.maximum(np.diagonal(estimate.covariance), 0.0))
        row += _motion(estimate.time_s, estimate.state) + sd[SD_ORDER].tolist()
    return [
        *row,
        estimate.status,
        _field(estimate.nis),
        int(estimate.nis_dof),
        _field(estimate.window_nis),
        _field(estimate.inlier_ratio),
        int(estimate.n_rectangles),
    ]


def _field(value: float) -> float | str:
    """A number, or the empty field of "no value"."""
    return "" if math.isnan(value) else float(value)


def _measurement_row(record: RectangleRecord) -> list[float | str]:
    pose: list[float] | list[str] = [""] * len(POSE_COLUMNS)
    if np.isfinite(record.T_cam_rect).all():
        pose = _pose_fields(record.T_cam_rect)
    return [
        float(record.time_s),
        record.rectangle,
        float(record.length_m),
        float(record.width_m),
        *pose,
        *(float(sd) for sd in record.sd),
        record.case,
        record.outcome,
    ]


def _pose_fields(T: FloatArray) -> list[float]:
    """Position and scalar-last quaternion of a (4, 4) pose."""
    return [float(value) for value in (*T[:3, 3], *xyzw_from_rotation(T[:3, :3]))]


def _motion(time_s: float, state: NavigationState) -> list[float]:
    """22 numbers, in the order of `STATE_COLUMNS`."""
    parts = (state.r_hill, state.v_hill, xyzw_from_rotation(state.R_world_body), state.omega_body)
    numbers = np.concatenate([[time_s], *parts, state.com_model, state.inertia_ratios])
    return [float(number) for number in numbers]
