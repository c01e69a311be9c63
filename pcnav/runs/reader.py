"""Reads a result folder back, whatever estimator it is of and whether it is finished or not.

The files of a run that goes on are written through buffers of their own, so that each may end in
the middle of another frame: such a run is cut where the first of them ends.
"""

import zipfile
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import IO

import numpy as np

from pcnav.config.pipeline_file import read_pipeline
from pcnav.core.arrays import FloatArray, IntArray
from pcnav.core.errors import InputError
from pcnav.core.spatial import make_transform, rotation_from_xyzw
from pcnav.dynamics.blocks import (
    ATTITUDE,
    FILE_ORDER,
    MASS_CENTRE_LAYOUT,
    POSITION,
    Block,
    Layout,
)
from pcnav.dynamics.trajectory import Trajectory
from pcnav.files.csv_table import CsvTable, read_csv, read_header
from pcnav.files.npy_header import read_npy_header
from pcnav.files.regular_file import require_regular
from pcnav.runs.estimate import OWN_WORDS, Output
from pcnav.runs.nis_window import window_nis
from pcnav.runs.places import located
from pcnav.runs.records import (
    GATE_COLUMNS,
    MEASUREMENT_COLUMNS,
    OLDER_COLUMNS,
    POSE_COLUMNS,
    RECORD_SD_COLUMNS,
    SIZE_COLUMNS,
    WORD_COLUMNS,
    WORST_COLUMN,
    RectangleRecord,
)
from pcnav.runs.result_files import (
    COVARIANCES_FILE,
    FEATURE_COLUMNS,
    FEATURES_FILE,
    MEASUREMENTS_FILE,
    PIPELINE_FILE,
    POINT_COLUMNS,
    POINTS_FILE,
    POSES_FILE,
    RAW_COVARIANCES_FILE,
    SEGMENT_COLUMNS,
    SEGMENTS_FILE,
    STATES_FILE,
)
from pcnav.runs.run import FeatureTable, PointTable, Run, Segment

# NumPy and zipfile raise the last for a compression they do not know.
_DAMAGED_ARCHIVE = (
    OSError,
    KeyError,
    ValueError,
    EOFError,
    zipfile.BadZipFile,
    NotImplementedError,
)
_RENAMED = {"explained": "inlier_ratio"}
"""Columns as they were called up to release 0.1."""
_TOLD_BY = {
    "com_x_m": "depth",
    "p_x": "principal_axes",
    "hypothesis": "inertia_bank",
    "outcome": "image_motion",
    "sd_measured_rad": "attitude_inertia",
}
"""Columns that tell the estimator where no pipeline file does."""
_TUM_FIELDS = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
_NORM_TOLERANCE = 1e-3


def read_run(folder: Path | str, *, with_covariance: bool = False) -> Run:
    """The run stored in a result folder: finished, going on or killed.

    ``with_covariance`` also loads the covariances where the run is finished, 3 kB a frame of 20
    states; without it only their diagonals, as standard deviations. Raises `InputError` when a
    file is missing or damaged.
    """
    folder = Path(folder)
    is_finished = not (folder / RAW_COVARIANCES_FILE).is_file()
    path = folder / STATES_FILE
    header = read_header(path)
    output = _output_of(path, header)
    texts = ("status", *(name for name in header if name in OWN_WORDS))
    table = read_csv(path, header or ("time_s", "status"), texts, growing=not is_finished)
    run = _with_poses(folder, _run_of(folder, table, output, is_finished))
    if with_covariance and is_finished:
        covariance = _read_covariances(folder, run.trajectory)
        run = replace(run, trajectory=replace(run.trajectory, covariance=covariance))
    return replace(run, segments=_segments(folder, run))


def read_records(folder: Path, until_s: float = np.inf) -> tuple[RectangleRecord, ...]:
    """What became of each rectangle of a run, in the order seen, up to a time.

    Raises `InputError`.
    """
    path, growing = folder / MEASUREMENTS_FILE, (folder / RAW_COVARIANCES_FILE).is_file()
    is_older = not {*GATE_COLUMNS, WORST_COLUMN} <= set(read_header(path))
    columns = OLDER_COLUMNS if is_older else MEASUREMENT_COLUMNS
    table = read_csv(path, columns, WORD_COLUMNS, growing=growing)
    poses = table.numbers(POSE_COLUMNS)
    T_cam_rect = make_transform(_rotations(path, poses[:, 3:7]), poses[:, 0:3])
    rows = zip(
        table.times().tolist(),
        table.words("rectangle"),
        *table.numbers(SIZE_COLUMNS).T.tolist(),
        T_cam_rect,
        table.numbers(RECORD_SD_COLUMNS),
        table.words("case"),
        table.words("outcome"),
        *(() if is_older else (*table.numbers(GATE_COLUMNS).T.tolist(), table.words(WORST_COLUMN))),
        strict=True,
    )
    records = (RectangleRecord(*row) for row in rows)
    return tuple(record for record in records if record.time_s <= until_s)


def count_outcomes(folder: Path) -> Counter[tuple[str, str]]:
    """How often each (rectangle, outcome) occurs in a result folder.

    The rectangle is empty where a segment was not recognised; a run that sees no rectangles has
    none. Raises `InputError`.
    """
    path, names = folder / MEASUREMENTS_FILE, ("rectangle", "outcome")
    if not path.is_file():
        return Counter()
    table = read_csv(path, names, names)
    return Counter(zip(*map(table.words, names), strict=True))


def read_points(folder: Path) -> PointTable | None:
    """The estimated points of every frame; None of a run without. Raises `InputError`."""
    path = folder / POINTS_FILE
    if not path.is_file():
        return None
    growing = (folder / RAW_COVARIANCES_FILE).is_file()
    table = read_csv(path, POINT_COLUMNS, growing=growing)
    return PointTable(table.times(), table.counts("feature"), table.numbers(POINT_COLUMNS[2:]))


def read_features(folder: Path) -> FeatureTable | None:
    """The features of a finished run; None of a run without. Raises `InputError`."""
    path = folder / FEATURES_FILE
    if not path.is_file():
        return None
    table = read_csv(path, FEATURE_COLUMNS)
    return FeatureTable(
        feature=table.counts("feature"),
        p_body=table.numbers(FEATURE_COLUMNS[1:4]),
        sd=table.numbers(FEATURE_COLUMNS[4:7]),
        frames_seen=table.counts("frames_seen"),
        frames_rejected=table.counts("frames_rejected"),
    )


def _output_of(path: Path, header: tuple[str, ...]) -> Output:
    """What a header says of values, deviations and notes. Raises `InputError` for half a block."""

    def has(names: tuple[str, ...]) -> bool:
        missing = [name for name in names if name not in header]
        if missing and len(missing) < len(names):
            raise InputError(path, "header", f"expected a column {missing[0]}")
        return not missing

    stated = tuple(block for block in MASS_CENTRE_LAYOUT.blocks if has(block.sd_columns))
    valued = tuple(block for block in FILE_ORDER if has(block.columns))
    for block in stated:
        if block not in valued:
            raise InputError(path, "header", f"expected a column {block.columns[0]}")
    bare = tuple(block for block in valued if block not in stated)
    output = Output(Layout(stated), bare, has_nis=has(("nis", "nis_dof")))
    own = tuple(name for name in header if name not in output.columns)
    return replace(output, notes=own)


def _run_of(folder: Path, table: CsvTable, output: Output, is_finished: bool) -> Run:
    time_s, n = table.times(), len(table.words("status"))
    layout = output.layout
    values = {block.name: _values(table, block) for block in output.blocks}
    sd = np.full((n, layout.size), np.nan)
    for block in layout.blocks:
        sd[:, layout.slice_of(block)] = table.numbers(block.sd_columns)
    _require_whole(table, layout)
    trajectory = Trajectory(time_s, layout, values, sd if layout.blocks else None)
    nis, dof = np.full(n, np.nan), np.zeros(n, dtype=np.intp)
    if output.has_nis:
        nis, dof = table.numbers(("nis",))[:, 0], table.counts("nis_dof")
    stated = "window_nis" in table.values
    window = table.numbers(("window_nis",))[:, 0] if stated else None
    pipeline = folder / PIPELINE_FILE
    as_run = located(read_pipeline(pipeline), folder) if pipeline.is_file() else None
    header = {*table.values, *table.texts}
    told = next((name for column, name in _TOLD_BY.items() if column in header), "")
    notes = {_RENAMED.get(name, name): name for name in output.notes if name in table.values}
    return Run(
        name=folder.resolve().name,
        folder=folder,
        estimator=told if as_run is None else str(as_run.estimator.kind),
        pipeline=as_run,
        trajectory=trajectory,
        status=table.words("status"),
        nis=nis,
        nis_dof=dof,
        window_nis=window_nis(nis, dof, trajectory.has_estimate) if window is None else window,
        notes={name: table.numbers((column,))[:, 0] for name, column in notes.items()},
        words={name: table.words(name) for name in output.notes if name in table.texts},
        is_finished=is_finished,
    )


def _values(table: CsvTable, block: Block) -> FloatArray:
    numbers = table.numbers(block.columns)
    return _rotations(table.path, numbers) if block is ATTITUDE else numbers


def _require_whole(table: CsvTable, layout: Layout) -> None:
    if layout.blocks:
        known = np.isfinite(table.numbers((*layout.columns, *layout.sd_columns)))
        table.require(
            np.asarray(known.all(axis=1) | ~known.any(axis=1)),
            "expected all of the state or none of it",
        )


def _rotations(path: Path, quaternions_xyzw: FloatArray, first_line: int = 2) -> FloatArray:
    """(n, 3, 3) rotations, nan where the quaternion is nan."""
    R = np.full((len(quaternions_xyzw), 3, 3), np.nan)
    known = np.isfinite(quaternions_xyzw).all(axis=1)
    lengths = np.linalg.norm(quaternions_xyzw[known], axis=1)
    wrong = np.abs(lengths - 1.0) > _NORM_TOLERANCE
    if wrong.any():
        line = np.flatnonzero(known)[np.argmax(wrong)] + first_line
        raise InputError(path, f"line {line}", "expected a unit quaternion in q_x, q_y, q_z, q_w")
    if known.any():
        R[known] = rotation_from_xyzw(quaternions_xyzw[known])
    return R


def _with_poses(folder: Path, run: Run) -> Run:
    """The run with the poses of its estimates, which poses.tum repeats the times of."""
    trajectory, layout = run.trajectory, run.trajectory.layout
    if layout.blocks and POSITION not in layout:
        return run
    path = folder / POSES_FILE
    rows = _tum_rows(path, growing=not run.is_finished)
    if layout.blocks:
        frames = np.flatnonzero(trajectory.has_estimate)
    else:
        frames = np.flatnonzero(np.isin(run.time_s, rows[:, 0]))
    if not run.is_finished:
        if len(frames) > len(rows):
            # states.csv is ahead: the run ends before the first estimate without a pose.
            run = _cut(run, int(frames[len(rows)]))
            trajectory, frames = run.trajectory, frames[: len(rows)]
        rows = rows[: len(frames)]
    if not np.array_equal(rows[:, 0], run.time_s[frames]):
        expected = f"expected the times of the {len(frames)} estimates in {STATES_FILE}"
        raise InputError(path, "timestamp", expected)
    T = np.full((len(run), 4, 4), np.nan)
    if len(rows):
        T[frames] = make_transform(_rotations(path, rows[:, 4:], first_line=1), rows[:, 1:4])
    return replace(run, trajectory=replace(trajectory, T_cam_target=T))


def _cut(run: Run, n: int) -> Run:
    """The first frames of a run."""
    return replace(
        run,
        trajectory=run.trajectory.at(slice(n)),
        status=run.status[:n],
        nis=run.nis[:n],
        nis_dof=run.nis_dof[:n],
        window_nis=run.window_nis[:n],
        notes={name: values[:n] for name, values in run.notes.items()},
        words={name: words[:n] for name, words in run.words.items()},
    )


def _tum_rows(path: Path, *, growing: bool) -> FloatArray:
    """(n, 8) numbers of a file of timed poses."""
    require_regular(path)
    try:
        lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
        whole = [line for line in lines if line.endswith("\n") or not growing]
        rows = [[float(word) for word in line.split()] for line in whole if line[:1] != "#"]
    except OSError as error:
        raise InputError(path, "file", f"expected a readable file ({error.strerror})") from error
    except ValueError as error:
        raise InputError(path, "file", f"expected rows of numbers ({error})") from error
    if any(len(row) != len(_TUM_FIELDS) for row in rows):
        raise InputError(path, "file", f"expected {' '.join(_TUM_FIELDS)} in every line")
    found = np.array(rows).reshape(-1, len(_TUM_FIELDS))
    finite = np.isfinite(found).all(axis=1)
    if not finite.all():
        raise InputError(path, f"line {int(np.argmin(finite)) + 1}", "expected finite numbers")
    return found


def _segments(folder: Path, run: Run) -> tuple[Segment, ...]:
    """From segments.csv; up to release 0.1 the rows of a run on images alone told them."""
    path = folder / SEGMENTS_FILE
    if path.is_file():
        table = read_csv(path, SEGMENT_COLUMNS, growing=not run.is_finished)
        attitudes = _rotations(path, table.numbers(SEGMENT_COLUMNS[1:]))
        pairs = zip(table.times().tolist(), attitudes, strict=True)
        return tuple(Segment(time_s, R) for time_s, R in pairs)
    if "segment" not in run.notes:
        return ()
    known = np.flatnonzero(run.has_estimate)
    _, first = np.unique(run.notes["segment"][known], return_index=True)
    attitudes = run.trajectory[ATTITUDE]
    return tuple(Segment(float(run.time_s[k]), attitudes[k]) for k in known[first])


def _read_covariances(folder: Path, trajectory: Trajectory) -> FloatArray | None:
    """(n, k, k) covariances, nan in frames without an estimate."""
    path, size = folder / COVARIANCES_FILE, trajectory.layout.size
    if not path.is_file() and POSITION not in trajectory.layout:
        # Poses alone have none, and runs on attitudes and images had none up to release 0.1.
        return None
    frames: IntArray = np.flatnonzero(trajectory.has_estimate)
    expected = f"expected ({len(frames)}, {size}, {size}) at the times of {STATES_FILE}"
    covariance = np.full((len(trajectory), size, size), np.nan)
    try:
        require_regular(path)
        with zipfile.ZipFile(path) as archive, archive.open("time_s.npy") as file:
            # What it states is compared before memory is allocated by it.
            if read_npy_header(file) != ((len(frames),), False, np.dtype(np.float64)):
                raise InputError(path, "P", expected)
            times = np.frombuffer(file.read(8 * len(frames)))
            if not np.array_equal(times, trajectory.time_s[frames]):
                raise InputError(path, "P", expected)
        with zipfile.ZipFile(path) as archive, archive.open("P.npy") as file:
            matrices = _matrices(file, size)
            # Block by block: a long run is not held twice.
            for rows in np.array_split(frames, max(1, len(frames) // 512)):
                covariance[rows] = matrices(len(rows))
            if file.read(1):
                raise InputError(path, "P", expected)
    except InputError:
        raise
    except _DAMAGED_ARCHIVE as error:
        raise InputError(path, "file", f"expected the arrays P and time_s ({error})") from error
    return covariance


def _matrices(file: IO[bytes], size: int) -> Callable[[int], FloatArray]:
    """Reads the (n, size, size) of an open .npy file by so many matrices a call."""
    shape, fortran, dtype = read_npy_header(file)
    if shape[1:] != (size, size) or fortran or dtype != np.float64:
        raise ValueError(f"P is {shape} {dtype}")

    def read(n: int) -> FloatArray:
        data = file.read(8 * n * size * size)
        if len(data) != 8 * n * size * size:
            raise ValueError("P ends early")
        return np.frombuffer(data).reshape(n, size, size)

    return read
