"""A grid of cases ready to run: every run with its seed, and a look at all that the runs need."""

import hashlib
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import tomli_w

from pcnav.batch.axes import (
    ESTIMATOR_AXIS,
    RANGE_AXIS,
    SATELLITE_AXIS,
    GridCase,
    GridRun,
    named_axis,
    scenario_of,
    shown_value,
    with_axes,
)
from pcnav.batch.grid_file import GridFile, cases_of, read_grid_file
from pcnav.batch.monte_carlo import Run
from pcnav.config.pipeline_file import Pipeline, read_pipeline
from pcnav.config.shipped import (
    shipped_grid_names,
    shipped_mesh,
    shipped_mesh_names,
    shipped_pipeline,
    shipped_pipeline_names,
)
from pcnav.core.errors import InputError
from pcnav.estimators.registry import ESTIMATORS
from pcnav.recordings.depth_png import MAXIMUM_UNITS
from pcnav.recordings.recording import RecordingKind
from pcnav.target.mesh_files.reading import companion_files


@dataclass(frozen=True)
class GridBasis:
    """The part of a grid that all cases share; it finds the pipeline and the mesh of each.

    This is all of a grid that a run needs, so it is all that travels to another machine. Shipped
    files are those of the machine that runs; files of the user's own must be at the same place
    there.
    """

    source: str
    """What the grid is called: a path or a shipped name."""
    folder: Path
    """That paths in the grid are relative to."""
    frames: int | None
    """Of every run; None where the duration is stated."""
    duration_s: float | None
    pipeline_name: str | None
    """Of the pipeline under all cases; None takes the one shipped with each satellite."""
    pipeline: Pipeline | None
    """Its content."""

    def command(self, run: GridRun) -> str:
        """What repeats a run alone."""
        words = ("pcnav", "table", self.source, "--case", run.case.name, "--run", str(run.index))
        return shlex.join([*words, "-o", f"runs/{run.key}"])

    def shared_pipeline(self, case: GridCase) -> tuple[str, Pipeline]:
        """Name and content of the pipeline that a case is based on, none of its axes applied.

        Raises `InputError` where there is none.
        """
        if self.pipeline_name is not None and self.pipeline is not None:
            return self.pipeline_name, self.pipeline
        name = _satellite(case) or ""
        path = shipped_pipeline(name)
        if path is None:
            known = ", ".join(shipped_pipeline_names())
            expected = f"expected one of {known}, or batch.pipeline beside it, got {name}"
            raise InputError(self.source, SATELLITE_AXIS, expected)
        return name, read_pipeline(path)

    def kind_of(self, case: GridCase) -> RecordingKind:
        """The kind of recording that the pipeline of a case simulates."""
        _, pipeline = self.shared_pipeline(case)
        estimator = ESTIMATORS.get(str(pipeline.estimator.kind))
        lives_on = RecordingKind.DEPTH if estimator is None else estimator.takes[0]
        return pipeline.scenario.recording or lives_on

    def pipeline_of(self, case: GridCase) -> Pipeline:
        """The pipeline of a case: its axes applied, before a truth is drawn.

        Raises `InputError` for an axis that means nothing to its kind of recording, and for an
        estimator that does not live on it.
        """
        (name, pipeline), kind = self.shared_pipeline(case), self.kind_of(case)
        for axis, value in case.settings:
            if kind is not RecordingKind.DEPTH and named_axis(axis).only_depth:
                expected = f"expected none: {name} simulates {kind}, this axis is for depth frames"
                raise InputError(self.source, axis, expected)
            if axis == ESTIMATOR_AXIS and kind not in ESTIMATORS[str(value)].takes:
                fitting = [key for key, each in ESTIMATORS.items() if kind in each.takes]
                expected = f"expected some of {', '.join(fitting)} for {kind} ({name}), got {value}"
                raise InputError(self.source, axis, expected)
        pipeline, mesh = with_axes(pipeline, case, self.source), self.mesh_of(case)
        update = {"target_mesh": None if mesh is None else str(mesh)}
        # What the pipeline says of its own mesh does not hold for another one.
        own = _satellite(case) is None
        return pipeline.model_copy(
            update={**update, "mesh_unit": pipeline.mesh_unit if own else None}
        )

    def mesh_of(self, case: GridCase) -> Path | None:
        """The mesh of a case's satellite; None where its recording needs none.

        Raises `InputError` for depth frames without one, and for one that is not there.
        """
        satellite = _satellite(case)
        if satellite is None:
            name, pipeline = self.shared_pipeline(case)
            satellite = pipeline.target_mesh
            if satellite is None and self.kind_of(case) is not RecordingKind.DEPTH:
                return None
            if satellite is None:
                expected = f"expected this axis, as {name} has no target_mesh"
                raise InputError(self.source, SATELLITE_AXIS, expected)
        beside = self.folder / satellite
        found = beside if beside.is_file() else shipped_mesh(satellite)
        if found is None:
            known = ", ".join(shipped_mesh_names())
            expected = f"expected a mesh file or one of {known}, got {satellite}"
            raise InputError(self.source, SATELLITE_AXIS, expected)
        return found

    def frames_at(self, frame_rate_hz: float) -> int:
        """Frames of a run; two at least."""
        if self.frames is not None:
            return self.frames
        assert self.duration_s is not None, "a grid file states one of them"
        return max(2, round(self.duration_s * frame_rate_hz))


@dataclass(frozen=True)
class GridPlan:
    """A grid file with all its cases."""

    file: GridFile
    cases: tuple[GridCase, ...]
    """In the order of the file."""
    basis: GridBasis

    @cached_property
    def runs(self) -> list[GridRun]:
        """Every run of every case, case after case."""
        return grid_runs(self.cases, self.file.batch.runs, self.file.batch.seed)

    def run_named(self, case: str, index: int) -> GridRun:
        """One run by the name of its case and its index.

        The name's words may come in any order; those that tell the case from all others are
        enough. Raises `InputError` in one line.
        """
        source, runs = self.basis.source, self.file.batch.runs
        found = case_named(source, self.cases, case)
        if not 0 <= index < runs:
            raise InputError(source, "--run", f"expected a number from 0 to {runs - 1}")
        return grid_runs([found], runs, self.file.batch.seed)[index]

    def check(self) -> None:
        """Look at all that the cases need before the first of them runs.

        Raises `InputError` for a mesh, a pipeline or a library that is missing or unusable, for an
        axis or an estimator that does not fit, and for a distance at which the camera would be
        inside the satellite, or the satellite beyond what a depth image can store.
        """
        # It brings Open3D, which a look at a grid alone does not need.
        from pcnav.target.satellite import load_target

        source = self.basis.source
        names = (str(dict(case.settings)[ESTIMATOR_AXIS]) for case in self.cases)
        for name in dict.fromkeys(names):
            library = ESTIMATORS[name].library
            if library is not None:
                library(f"the estimator {name} of {source}")
        radius_m: dict[Path, float] = {}
        for case in self.cases:
            mesh, pipeline = self.basis.mesh_of(case), self.basis.pipeline_of(case)
            if mesh is None or self.basis.kind_of(case) is not RecordingKind.DEPTH:
                continue
            if mesh not in radius_m:
                radius_m[mesh] = 0.5 * load_target(mesh, pipeline.mesh_unit).diameter_m
            range_m = dict(case.settings).get(RANGE_AXIS)
            if range_m is None:
                continue
            farthest_m = MAXIMUM_UNITS * pipeline.noise.quantisation_m - radius_m[mesh]
            if not radius_m[mesh] < float(range_m) <= farthest_m:
                span = (
                    f"above {radius_m[mesh]:.3g} m (half of {mesh.stem}) up to {farthest_m:.3g} m"
                )
                expected = f"expected {span} (16 bits of depth), got {shown_value(range_m)}"
                raise InputError(source, RANGE_AXIS, expected)

    def to_toml(self) -> str:
        """The grid as run: a grid file, with a digest of every pipeline and mesh that it stands on.

        Batches with the same text are the same batch.
        """
        basis = self.basis
        pipelines = dict(map(basis.shared_pipeline, self.cases))
        meshes = {path.name: path for path in map(basis.mesh_of, self.cases) if path is not None}
        as_run: dict[str, object] = {
            "pipelines_sha256": {name: pipeline_digest(pipelines[name]) for name in pipelines},
            "meshes_sha256": {name: mesh_digest(path) for name, path in meshes.items()},
        }
        named = {*map(_satellite, self.cases), basis.pipeline_name}
        if any((basis.folder / name).is_file() for name in named if name):
            as_run["folder"] = str(basis.folder)
        table = self.file.model_dump(mode="json", exclude_none=True, exclude={"as_run"})
        table["grid"] = [
            {key: axes for key, axes in each.items() if axes} for each in table["grid"]
        ]
        return tomli_w.dumps(table | {"as_run": as_run})


def case_named(source: str, cases: Sequence[GridCase], name: str) -> GridCase:
    """The case that has some words in its name. Raises `InputError` unless it is one."""
    words = set(name.split())
    found = [each for each in cases if words <= set(each.name.split())]
    if len(found) != 1:
        fit = f"{len(found)} cases fit, like {found[0]}" if found else "no case fits"
        expected = f'expected words that name one case, as "{cases[0]}"; {fit}'
        raise InputError(source, "--case", expected)
    return found[0]


def grid_runs(cases: Iterable[GridCase], runs: int, seed: int) -> list[GridRun]:
    """So many runs of every case, case after case."""
    return [
        Run(case, index, grid_seed(seed, case, index)) for case in cases for index in range(runs)
    ]


def grid_seed(seed: int, case: GridCase, index: int) -> int:
    """Seed of a run: of the batch's seed, the case's scenario and the run's index alone.

    Never of the place in the batch: a run alone is the run in the batch, and all estimators of a
    scenario meet the same frames.
    """
    digest = hashlib.sha256(scenario_of(case).encode()).digest()
    words = np.frombuffer(digest, dtype="<u4").tolist()
    sequence = np.random.SeedSequence([seed, *words], spawn_key=(index,))
    return int(sequence.generate_state(1)[0])


def read_grid(path: Path, source: str | None = None) -> GridPlan:
    """Read a grid file and all its cases. Raises `InputError`.

    ``source`` is what the user called it; None takes the path.
    """
    file = read_grid_file(path)
    batch = file.batch
    folder = path.resolve().parent if file.as_run.folder is None else Path(file.as_run.folder)
    pipeline = None if batch.pipeline is None else _stated_pipeline(batch.pipeline, folder, path)
    basis = GridBasis(
        source or str(path), folder, batch.frames, batch.duration_s, batch.pipeline, pipeline
    )
    cases = cases_of(file, path)
    if pipeline is None and _satellite(cases[0]) is None:
        expected = f"expected a pipeline, or the axis {SATELLITE_AXIS} in [base] or [[grid]]"
        raise InputError(path, "batch.pipeline", expected)
    return GridPlan(file, cases, basis)


def named_grid(name: str) -> GridPlan:
    """A grid by path or shipped name. Raises `InputError`."""
    path = Path(name)
    if not path.is_file():
        shipped = shipped_pipeline(name)
        if shipped is None:
            known = ", ".join(shipped_grid_names())
            raise InputError(path, "grid", f"expected a TOML file or one of: {known}")
        path = shipped
    return read_grid(path, name)


def _stated_pipeline(name: str, folder: Path, grid: Path) -> Pipeline:
    """The pipeline that a grid names, its mesh as an absolute path where it is a file.

    Raises `InputError`, naming the grid where there is no such pipeline.
    """
    beside = folder / name
    path = beside if beside.is_file() else shipped_pipeline(name)
    if path is None:
        known = ", ".join(shipped_pipeline_names())
        raise InputError(grid, "batch.pipeline", f"expected a file or one of {known}, got {name}")
    pipeline = read_pipeline(path)
    mesh = path.parent / (pipeline.target_mesh or "")
    if not mesh.is_file():
        return pipeline
    return pipeline.model_copy(update={"target_mesh": str(mesh.resolve())})


def _satellite(case: GridCase) -> str | None:
    value = dict(case.settings).get(SATELLITE_AXIS)
    return None if value is None else str(value)


def pipeline_digest(pipeline: Pipeline) -> str:
    """Of its content."""
    # The mesh has a digest of its own, and may lie elsewhere on another machine.
    content = pipeline.model_dump_json(exclude={"target_mesh"})
    return hashlib.sha256(content.encode()).hexdigest()


def mesh_digest(path: Path) -> str:
    """Of a mesh, of the files it consists of and the TOML beside it, where there are any."""
    beside = (path.with_suffix(".toml"), *companion_files(path))
    content = path.read_bytes() + b"".join(each.read_bytes() for each in beside if each.is_file())
    return hashlib.sha256(content).hexdigest()
