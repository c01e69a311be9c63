"""A grid of cases ready to run: every run with its seed, and a look at all that the runs need."""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import tomli_w

from pcnav.batch.axes import RANGE_AXIS, SATELLITE_AXIS
from pcnav.batch.basis import GridBasis, stated_pipeline
from pcnav.batch.case import ESTIMATOR_AXIS, BatchRun, Case, batch_runs, shown_value
from pcnav.batch.grid_file import GridFile, cases_of, read_grid_file
from pcnav.config.pipeline_file import Pipeline
from pcnav.config.shipped import shipped_grid_names, shipped_pipeline
from pcnav.core.errors import InputError
from pcnav.recordings.depth_png import MAXIMUM_UNITS


@dataclass(frozen=True)
class GridPlan:
    """A grid file with all its cases."""

    file: GridFile
    cases: tuple[Case, ...]
    """In the order of the file."""
    basis: GridBasis

    @property
    def name(self) -> str:
        """Of the batch."""
        return self.file.batch.name

    @cached_property
    def runs(self) -> list[BatchRun]:
        """Every run of every case, case after case."""
        return batch_runs(self.cases, self.file.batch.runs, self.file.batch.seed)

    def run_named(self, case: str, index: int) -> BatchRun:
        """One run by the name of its case and its index.

        The name's words may come in any order; those that tell the case from all others are
        enough. Raises `InputError` in one line.
        """
        source, runs = self.basis.source, self.file.batch.runs
        words = set(case.split())
        found = [each for each in self.cases if words <= set(each.name.split())]
        if len(found) != 1:
            told = f"{len(found)} cases fit, like {found[0]}" if found else "no case fits"
            expected = f'expected words that name one case, as "{self.cases[0]}"; {told}'
            raise InputError(source, "--case", expected)
        if not 0 <= index < runs:
            raise InputError(source, "--run", f"expected a number from 0 to {runs - 1}")
        return batch_runs(found, runs, self.file.batch.seed)[index]

    def command(self, run: BatchRun) -> str:
        """What repeats a run alone."""
        return self.basis.command(run)

    def check(self) -> None:
        """Look at all that the cases need before the first of them runs.

        Raises `InputError` for a mesh, a pipeline or a library that is missing or unusable, and
        for a distance at which the camera would be inside the satellite, or the satellite beyond
        what a depth image can store.
        """
        # They bring Open3D, which a look at a grid alone does not need.
        from pcnav.estimators.names import EstimatorName
        from pcnav.estimators.registry import ESTIMATORS
        from pcnav.target.satellite import load_target

        source = self.basis.source
        for name in dict.fromkeys(str(case.value(ESTIMATOR_AXIS)) for case in self.cases):
            library = ESTIMATORS[EstimatorName(name)].library
            if library is not None:
                library(f"the estimator {name} of {source}")
        meshes = {case: self.basis.mesh_of(case) for case in self.cases}
        radius_m = {mesh: 0.5 * load_target(mesh).diameter_m for mesh in set(meshes.values())}
        for case, mesh in meshes.items():
            _, pipeline = self.basis.pipeline_of(case)
            range_m = dict(case.axes).get(RANGE_AXIS)
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
        pipelines = dict(map(basis.pipeline_of, self.cases))
        meshes = {path.name: path for path in map(basis.mesh_of, self.cases)}
        as_run: dict[str, object] = {
            "pipelines_sha256": {name: _pipeline_digest(pipelines[name]) for name in pipelines},
            "meshes_sha256": {name: _mesh_digest(path) for name, path in meshes.items()},
        }
        named = {str(dict(case.axes).get(SATELLITE_AXIS, "")) for case in self.cases}
        named.add(basis.pipeline_name or "")
        if any((basis.folder / name).is_file() for name in named):
            as_run["folder"] = str(basis.folder)
        table = self.file.model_dump(mode="json", exclude_none=True, exclude={"as_run"})
        table["grid"] = [
            {key: axes for key, axes in each.items() if axes} for each in table["grid"]
        ]
        return tomli_w.dumps(table | {"as_run": as_run})


def read_grid(path: Path, source: str | None = None) -> GridPlan:
    """Read a grid file and all its cases. Raises `InputError`.

    ``source`` is what the user called it; None takes the path.
    """
    file = read_grid_file(path)
    batch, folder = file.batch, path.resolve().parent
    if file.as_run.folder is not None:
        folder = Path(file.as_run.folder)
    name = batch.pipeline
    pipeline = None if name is None else stated_pipeline(name, folder, path)
    basis = GridBasis(source or str(path), folder, batch.frames, batch.duration_s, name, pipeline)
    cases = cases_of(file, path)
    if name is None and SATELLITE_AXIS not in dict(cases[0].axes):
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


def _pipeline_digest(pipeline: Pipeline) -> str:
    # The mesh has a digest of its own, and may lie elsewhere on another machine.
    content = pipeline.model_dump_json(exclude={"target_mesh"})
    return hashlib.sha256(content.encode()).hexdigest()


def _mesh_digest(path: Path) -> str:
    """Of a mesh and of the file of names and mass properties beside it, where there is one."""
    digest = hashlib.sha256(path.read_bytes())
    sidecar = path.with_suffix(".toml")
    if sidecar.is_file():
        digest.update(sidecar.read_bytes())
    return digest.hexdigest()
