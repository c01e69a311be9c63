"""A batch of recordings that lie in files: which there are, and what all of their runs need."""

import hashlib
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import tomli_w

from pcnav.batch.axes import (
    ESTIMATOR_AXIS,
    OBJECT_AXIS,
    RECORDING_AXIS,
    AxisValue,
    GridCase,
    GridRun,
    grid_case,
)
from pcnav.batch.grid import case_named, mesh_digest, pipeline_digest
from pcnav.batch.monte_carlo import Run
from pcnav.config.length_unit import LengthUnit
from pcnav.config.pipeline_file import Pipeline
from pcnav.core.errors import InputError
from pcnav.estimators.choice import depth_estimator
from pcnav.estimators.registry import ESTIMATORS
from pcnav.recordings.bop_models import is_models, refuse_data_set, scenes_of
from pcnav.recordings.bop_targets import targets_of
from pcnav.recordings.opening import format_of
from pcnav.recordings.recording import RecordingKind
from pcnav.runs.result_files import STATES_FILE

_DEPTH = (RecordingKind.DEPTH,)
_MAX_FILES = 1_000_000


@dataclass(frozen=True)
class RecordingsBasis:
    """What all runs share, and what a run on another machine is sent."""

    source: str
    """What the folder is called."""
    places: Mapping[str, Path]
    """Of the recordings, by the names that cases have; the same on every machine."""
    pipeline: Pipeline
    mesh: Path | None = None
    """Of the target; None takes what each recording says."""
    mesh_unit: LengthUnit | None = None
    words: tuple[str, ...] = ()
    """Options on the command line that lead here."""

    def command(self, run: GridRun) -> str:
        """What repeats a run alone."""
        words = ("pcnav", "table", self.source, *self.words, "--case", run.case.name)
        return shlex.join([*words, "-o", f"runs/{run.key}"])


@dataclass(frozen=True)
class RecordingsPlan:
    """Recordings by estimators: one run of each."""

    basis: RecordingsBasis
    cases: tuple[GridCase, ...]

    @cached_property
    def runs(self) -> list[GridRun]:
        """In the order of the recordings."""
        return [Run(case, 0, 0) for case in self.cases]

    def run_named(self, case: str, index: int) -> GridRun:
        """A run by words of its case's name. Raises `InputError` unless they tell one."""
        found = case_named(self.basis.source, self.cases, case)
        if index:
            raise InputError(self.basis.source, "--run", "expected 0: a recording is run once")
        return Run(found, 0, 0)

    def check(self) -> None:
        """Raises `InputError` for an estimator whose library is missing."""
        names = (str(dict(case.settings)[ESTIMATOR_AXIS]) for case in self.cases)
        for name in dict.fromkeys(names):
            library = ESTIMATORS[name].library
            if library is not None:
                library(f"the estimator {name} of {self.basis.source}")

    def to_toml(self) -> str:
        """What is run, with a digest of all that it stands on: the same text is the same batch."""
        basis = self.basis
        recordings = {name: _files_digest(path) for name, path in basis.places.items()}
        as_run: dict[str, object] = {
            "pipeline_sha256": pipeline_digest(basis.pipeline),
            "recordings_sha256": recordings,
        }
        if basis.mesh is not None:
            as_run["mesh_sha256"] = mesh_digest(basis.mesh)
            as_run["mesh_unit"] = str(basis.mesh_unit or "as the file says")
        cases = [case.name for case in self.cases]
        return tomli_w.dumps({"source": basis.source, "cases": cases, "as_run": as_run})


def recordings_plan(
    folder: Path,
    estimators: Sequence[str],
    pipeline: Pipeline,
    *,
    objects: Sequence[int] = (),
    mesh: Path | None = None,
    mesh_unit: LengthUnit | None = None,
    words: Sequence[str] = (),
) -> RecordingsPlan:
    """The recordings of depth frames below a folder, each by each estimator.

    ``objects`` are the targets in the scenes of a BOP data set, each a case of its own; without any
    those that its targets file asks for in each scene. Raises `InputError` for a folder without
    recordings and for an estimator of something else.
    """
    for name in estimators:
        depth_estimator(name, str(folder))
    if len(set(estimators)) < len(estimators):
        raise InputError(folder, "--estimator", "expected every estimator once")
    places = {_name(folder, path): path.resolve() for path in recordings_below(folder)}
    if not places:
        expected = "expected that of a batch, with batch.json, or recordings of depth frames in it"
        raise InputError(folder, "folder", expected)
    basis = RecordingsBasis(str(folder), places, pipeline, mesh, mesh_unit, tuple(words))
    cases = []
    for name, place in places.items():
        for target in objects or _targets(place) or (None,):
            axes: list[tuple[str, AxisValue]] = [(RECORDING_AXIS, name)]
            if target is not None:
                axes.append((OBJECT_AXIS, target))
            cases += [grid_case([*axes, (ESTIMATOR_AXIS, each)]) for each in estimators]
    return RecordingsPlan(basis, tuple(cases))


def _targets(place: Path) -> tuple[int, ...]:
    """The objects that a data set asks for in a scene."""
    found = targets_of(place)
    return () if found is None else found.objects


def recordings_below(folder: Path) -> tuple[Path, ...]:
    """The folder, where it is a recording itself; else those in it, and in its splits of scenes.

    Results of runs are none.
    """
    if is_models(folder):
        return ()
    form = format_of(folder, _DEPTH)
    if form is not None and form.read is not refuse_data_set:
        return (folder,)
    found = []
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or is_models(path):
            continue
        # A split of a data set is a folder of scenes.
        found += [each for each in (path, *scenes_of(path)) if _is_recording(each)]
    return tuple(found)


def _is_recording(path: Path) -> bool:
    form = format_of(path, _DEPTH)
    is_one = form is not None and form.read is not refuse_data_set
    return is_one and not (path / STATES_FILE).exists()


def _name(folder: Path, path: Path) -> str:
    """Words that stand in a case's name have no blanks."""
    inside = path.relative_to(folder).as_posix()
    name = path.resolve().name if inside == "." else inside
    return "_".join(name.split())


def _files_digest(path: Path) -> str:
    """Of the names and sizes of a recording's files: its images are not read for it."""
    files = [path] if path.is_file() else sorted(p for p in path.rglob("*") if p.is_file())
    lines = [f"{p.relative_to(path).as_posix()} {p.stat().st_size}" for p in files[:_MAX_FILES]]
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()
