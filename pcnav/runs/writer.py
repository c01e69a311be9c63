"""Writes a result folder frame by frame: memory does not grow with the length of the run.

A result folder is either whole or not there: see `pcnav.files.new_folder`. Numbers are stored with
the fewest digits that read back to the same float64; an empty field means "no value".
"""

import csv
import json
import math
import shutil
import zipfile
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self, TextIO

import numpy as np

from pcnav.core.arrays import FloatArray
from pcnav.core.spatial import xyzw_from_rotation
from pcnav.dynamics.blocks import ATTITUDE, Block
from pcnav.files.new_folder import Place, new_place
from pcnav.runs.estimate import Estimate, FeaturePoint, FeatureUse, Note, Output
from pcnav.runs.feature_outcomes import FEATURE_OUTCOME_COLUMNS
from pcnav.runs.nis_window import NisWindow
from pcnav.runs.records import MEASUREMENT_COLUMNS, pose_fields, rows_of
from pcnav.runs.result_files import (
    COVARIANCES_FILE,
    FEATURE_COLUMNS,
    FEATURE_OUTCOMES_FILE,
    FEATURES_FILE,
    MEASUREMENTS_FILE,
    POINT_COLUMNS,
    POINTS_FILE,
    POSES_FILE,
    RAW_COVARIANCES_FILE,
    RESULT_FILES,
    SEGMENT_COLUMNS,
    SEGMENTS_FILE,
    STATES_FILE,
)


class RunWriter:
    """Streams a run to a result folder; a context manager.

    Leaving the ``with`` block normally puts the folder in place, leaving it by an exception
    removes all that was written and keeps an earlier folder as it was. Usage::

        with RunWriter(folder, estimator.output) as writer:
            for frame in recording:
                writer.add(estimator.step(frame))
            staging = writer.finish_tables()
            run = read_run(staging)
            writer.write_json(METRICS_FILE, ...)

    Raises `InputError` on entry when the folder holds anything and ``overwrite`` is false, or
    when it holds something other than an earlier run.
    """

    def __init__(self, folder: Path, output: Output, overwrite: bool = False) -> None:
        self.folder = folder
        self._new = new_place(folder, overwrite, STATES_FILE)
        self._output = output
        self._tables: _Tables | None = None

    def __enter__(self) -> Self:
        with ExitStack() as begun:
            self._place: Place = begun.enter_context(self._new)
            self._tables = begun.enter_context(_Tables(self.staging, self._output))
            self._begun = begun.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            self.finish_tables()
        self._begun.__exit__(kind, error, trace)

    @property
    def staging(self) -> Path:
        """Where the files are while it is written; its name is the folder's in the end."""
        return self._place.path

    def appear(self) -> None:
        """Put the folder in place while it is still written, an earlier one replaced: whatever is
        written from then on stays, however the process ends. Raises `InputError`."""
        self._place.appear(RESULT_FILES)
        if self._tables is not None:
            self._tables.folder = self.staging

    def flush(self) -> None:
        """Hand what was written to the system: then it stays when this process is killed."""
        if self._tables is not None:
            self._tables.flush()

    def add(self, estimate: Estimate) -> Estimate:
        """Append one frame; what is returned has the NIS of its window, too.

        Only between entry and `finish_tables`. Raises ``ValueError`` for an estimate that does not
        have all that its estimator's output says, or nothing of it.
        """
        if self._tables is None:
            raise RuntimeError("frames cannot be added after finish_tables()")
        return self._tables.add(estimate)

    def revise(self, estimates: Iterable[Estimate]) -> None:
        """Write the tables anew: the estimator knows better now that it has seen all frames."""
        if self._tables is None:
            raise RuntimeError("frames cannot be revised after finish_tables()")
        self._tables.close()
        with _Tables(self.staging, self._output) as self._tables:
            for estimate in estimates:
                self._tables.add(estimate)

    def finish_tables(self) -> Path:
        """Complete the streamed files; the folder returned can then be read and added to.

        It is temporary: it takes its final name when the ``with`` block ends.
        """
        if self._tables is not None:
            self._tables.finish()
            self._tables = None
        return self.staging

    def write_text(self, name: str, text: str) -> None:
        """Write a text file of the result folder."""
        (self.staging / name).write_text(text, encoding="utf-8")

    def write_json(self, name: str, content: Mapping[str, object]) -> None:
        """Write a JSON file of the result folder. Raises ``ValueError`` on nan and infinity."""
        self.write_text(name, json.dumps(content, indent=2, allow_nan=False) + "\n")


class _Tables:
    """The tables of a run while it goes on; closed in any case where the block ends."""

    def __init__(self, folder: Path, output: Output) -> None:
        self.folder, self._output = folder, output
        self._files = ExitStack()
        self._opened: list[IO[Any]] = []
        self._window = NisWindow()
        self._times = array("d")
        self._seen: Counter[int] = Counter()
        self._rejected: Counter[int] = Counter()
        self._points: Mapping[int, FeaturePoint] = {}
        self._quaternion: FloatArray | None = None
        layout = output.layout
        rows = [np.arange(layout.size)[layout.slice_of(b)] for b in layout.in_file_order]
        self._sd_order = np.concatenate([np.zeros(0, dtype=np.intp), *rows])
        self._csv: dict[str, Any] = {}
        self._states = self._table(STATES_FILE, output.columns)
        if output.has_records:
            self._records = self._table(MEASUREMENTS_FILE, MEASUREMENT_COLUMNS)
        if output.has_features:
            self._point_rows = self._table(POINTS_FILE, POINT_COLUMNS)
        if output.has_feature_outcomes:
            self._outcomes = self._table(FEATURE_OUTCOMES_FILE, FEATURE_OUTCOME_COLUMNS)
        if output.has_poses:
            self._poses = self._text(POSES_FILE)
        raw = (folder / RAW_COVARIANCES_FILE).open("wb")
        self._covariances = self._files.enter_context(raw)
        self._opened.append(raw)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._files.close()

    def flush(self) -> None:
        for file in self._opened:
            file.flush()

    def add(self, estimate: Estimate) -> Estimate:
        self._check(estimate)
        window = self._window.follow(estimate.has_estimate, estimate.nis, estimate.nis_dof)
        if estimate.window_nis is None:
            estimate = replace(estimate, window_nis=window)
        self._states.writerow(self._state_row(estimate))
        if estimate.new_axes is not None:
            quaternion = xyzw_from_rotation(estimate.new_axes)
            table = self._table(SEGMENTS_FILE, SEGMENT_COLUMNS)
            table.writerow([float(estimate.time_s), *quaternion.tolist()])
        if self._output.has_records:
            self._records.writerows(rows_of(estimate.records))
        if self._output.has_features:
            self._add_features(float(estimate.time_s), estimate.features)
        outcomes = estimate.features.outcomes
        if self._output.has_feature_outcomes and outcomes is not None:
            self._outcomes.writerows(outcomes.rows(float(estimate.time_s)))
        if estimate.T_cam_target is not None and self._output.has_poses:
            pose = [float(estimate.time_s), *pose_fields(estimate.T_cam_target)]
            self._poses.write(" ".join(map(repr, pose)) + "\n")
        if estimate.covariance is not None:
            P = np.ascontiguousarray(estimate.covariance, dtype=np.float64)
            self._covariances.write(P.tobytes())
            self._times.append(estimate.time_s)
        return estimate

    def finish(self) -> None:
        """Close the streamed files and add what can only be written at the end."""
        self.close()
        if self._output.has_features:
            with self._text(FEATURES_FILE) as file:
                table = csv.writer(file, lineterminator="\n")
                table.writerow(FEATURE_COLUMNS)
                table.writerows(self._feature_rows())
        if self._output.layout.blocks:
            self._pack_covariances()
        (self.folder / RAW_COVARIANCES_FILE).unlink()

    def _text(self, name: str) -> TextIO:
        file = (self.folder / name).open("w", encoding="utf-8", newline="")
        self._opened.append(file)
        return self._files.enter_context(file)

    def _table(self, name: str, columns: Sequence[str]) -> Any:
        """A CSV file, begun when it is first asked for."""
        if name not in self._csv:
            file = self._text(name)
            self._csv[name] = csv.writer(file, lineterminator="\n")
            self._csv[name].writerow(columns)
            # Who looks at a run that has just begun must know what its columns are.
            file.flush()
        return self._csv[name]

    def _check(self, estimate: Estimate) -> None:
        layout, P = self._output.layout, estimate.covariance
        given = [block.name in estimate.values for block in layout.blocks]
        if layout.blocks:
            given.append(P is not None)
        if self._output.has_poses:
            given.append(estimate.T_cam_target is not None)
        at = f"estimate at {estimate.time_s} s"
        if any(given) and not all(given):
            raise ValueError(f"{at}: values, covariance and pose must be given together")
        if P is not None and P.shape != (layout.size, layout.size):
            raise ValueError(f"{at}: covariance of shape {P.shape}")

    def _state_row(self, estimate: Estimate) -> list[object]:
        row: list[object] = [float(estimate.time_s)]
        for block in self._output.blocks:
            row += self._fields(block, estimate.values.get(block.name))
        P = estimate.covariance
        if P is None:
            row += [""] * len(self._sd_order)
        else:
            # Rounding may leave a variance that should be zero slightly below it.
            sd = np.sqrt(np.maximum(np.diagonal(P), 0.0))
            row += sd[self._sd_order].tolist()
        row.append(str(estimate.status))
        if self._output.has_nis:
            row += [_field(estimate.nis), int(estimate.nis_dof), _field(estimate.window_nis)]
        return row + [_field(estimate.notes.get(name)) for name in self._output.notes]

    def _fields(self, block: Block, value: FloatArray | None) -> list[object]:
        if value is None:
            return [""] * len(block.columns)
        if block is ATTITUDE:
            value = self._signed(xyzw_from_rotation(value))
        return [_field(each) for each in value.tolist()]

    def _signed(self, quaternion: FloatArray) -> FloatArray:
        before = self._quaternion
        if self._output.follows_signs and before is not None and quaternion @ before < 0.0:
            quaternion = -quaternion
        self._quaternion = quaternion
        return quaternion

    def _add_features(self, time_s: float, features: FeatureUse) -> None:
        self._seen.update(features.seen)
        self._rejected.update(features.rejected)
        self._point_rows.writerows(
            [time_s, number, *point.p_body.tolist()] for number, point in features.points.items()
        )
        self._points = features.points or self._points

    def _feature_rows(self) -> Iterator[list[object]]:
        for number in sorted(self._seen.keys() | self._points.keys()):
            values: list[object] = [""] * 6
            point = self._points.get(number)
            if point is not None:
                sd = np.sqrt(np.maximum(np.diagonal(point.covariance), 0.0))
                values = [*point.p_body.tolist(), *sd.tolist()]
            yield [number, *values, self._seen[number], self._rejected[number]]

    def _pack_covariances(self) -> None:
        """Copy the raw covariances behind the header that needed to know their count."""
        size = self._output.layout.size
        header = {"descr": "<f8", "fortran_order": False, "shape": (len(self._times), size, size)}
        with zipfile.ZipFile(self.folder / COVARIANCES_FILE, "w") as archive:
            raw = (self.folder / RAW_COVARIANCES_FILE).open("rb")
            with raw, archive.open("P.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array_header_1_0(member, header)
                shutil.copyfileobj(raw, member)
            with archive.open("time_s.npy", "w") as member:
                np.lib.format.write_array(member, np.frombuffer(self._times, dtype="<f8"))


def _field(value: Note) -> Note:
    """A number or a word, or the empty field of "no value"."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return float(value) if isinstance(value, float) else value
