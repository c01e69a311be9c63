"""Records of runs that never were: errors of a known distribution, for what is made of records."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

import pcnav
from pcnav.batch.axes import GridCase, GridRun, grid_case
from pcnav.batch.grid import grid_runs
from pcnav.batch.record import RunRecord
from pcnav.core.arrays import FloatArray
from pcnav.dynamics.blocks import MASS_CENTRE_LAYOUT

FRAMES = 40
ESTIMATORS = ("pcnav", "open3d_icp")
DEGREES = {block.name: block.size for block in MASS_CENTRE_LAYOUT.blocks}
DEGREES["all"] = MASS_CENTRE_LAYOUT.size
"""Of the squared normalised errors."""


def cases(
    satellites: Sequence[str] = ("boxsat", "cubesat6u"),
    ranges_m: Sequence[float] = (10.0, 20.0, 40.0),
    sigmas_m: Sequence[float] = (0.01, 0.02),
    estimators: Sequence[str] = ESTIMATORS,
) -> list[GridCase]:
    """All combinations of some axes."""
    return [
        grid_case(
            (
                ("satellite", satellite),
                ("range_m", range_m),
                ("range_sigma_m", sigma_m),
                ("estimator", estimator),
            )
        )
        for satellite in satellites
        for range_m in ranges_m
        for sigma_m in sigmas_m
        for estimator in estimators
    ]


def errors(generator: np.random.Generator, typical: float, frames: int) -> FloatArray:
    """(frames,) error norms of one run: its own level, and frames that hang together."""
    level = typical * np.exp(0.2 * generator.normal())
    walk = np.convolve(generator.normal(size=frames + 9), np.ones(10) / np.sqrt(10.0), "valid")
    return level * np.exp(0.3 * walk)


def record(
    run: GridRun,
    factor: float = 1.0,
    frames: int = FRAMES,
    failure: str | None = None,
    version: str = pcnav.__version__,
) -> RunRecord:
    """A run whose errors grow with range and noise; ``factor`` makes the position worse."""
    command = f"pcnav table grid.toml --case '{run.case.name}' --run {run.index} -o again"
    versions = {"pcnav": version, "numpy": np.__version__}
    if failure is not None:
        return RunRecord(run, {}, {}, failure, versions, command)
    values = {name: value for name, value in run.case.settings if isinstance(value, int | float)}
    estimator = str(dict(run.case.settings)["estimator"])
    filtered = estimator == "pcnav"
    level = (
        values.get("range_sigma_m", 0.01)
        * values.get("range_m", 10.0)
        / (1000.0 if filtered else 200.0)
    )
    generator = np.random.default_rng([run.seed, len(estimator)])
    position = factor * errors(generator, level, frames)
    attitude = errors(generator, 3.0 * level, frames)
    columns: dict[str, FloatArray | list[str]] = {
        "time_s": np.arange(frames) * np.float64(0.5),
        "status": ["acquiring"] * 2 + ["locked"] * (frames - 2),
        "position_error_m": position,
        "attitude_error_deg": attitude,
        "position_sym_error_m": position,
        "attitude_sym_error_deg": attitude,
        "add_m": 1.1 * position,
        "add_s_m": 0.8 * position,
        "frame_ms": 20.0 * np.exp(0.1 * generator.normal(size=frames)),
    }
    if filtered:
        columns |= _filter_columns(generator, level, attitude, frames)
    return RunRecord(run, columns, _values(generator, position, filtered), None, versions, command)


def records(
    runs: Sequence[GridRun],
    factor: float = 1.0,
    failures: Mapping[str, str] | None = None,
) -> Iterator[RunRecord]:
    """Records of runs; ``failures`` are messages by `GridRun.key`."""
    for run in runs:
        yield record(run, factor, failure=(failures or {}).get(run.key))


def some_runs(count: int = 5, seed: int = 1, **axes: Sequence) -> list[GridRun]:
    """So many runs of every case."""
    return grid_runs(cases(**axes), count, seed)


def _filter_columns(
    generator: np.random.Generator, level: float, attitude: FloatArray, frames: int
) -> dict[str, FloatArray]:
    columns: dict[str, FloatArray] = {}
    for block, degrees in DEGREES.items():
        columns[f"nees_{block}"] = generator.chisquare(degrees, frames)
    columns["nis_dof"] = np.full(frames, 50.0)
    columns["nis"] = generator.chisquare(50.0, frames)
    columns["velocity_error_m_s"] = errors(generator, 0.1 * level, frames)
    columns["rate_error_deg_s"] = errors(generator, 0.2 * level, frames)
    columns["com_error_m"] = errors(generator, level, frames)
    columns["inertia_ratio_error"] = errors(generator, 0.1 * level, frames)
    columns["crb_position_m"] = np.full(frames, 0.9 * level)
    columns["crb_attitude_deg"] = 0.95 * attitude
    return columns


def _values(
    generator: np.random.Generator, position: FloatArray, filtered: bool
) -> dict[str, float]:
    degrees = {f"nees_{block}_dof": float(size) for block, size in DEGREES.items()}
    return {
        **degrees,
        "time_to_lock_s": 1.0 if filtered else 0.0,
        "share_locked_right": 0.95,
        "share_locked_wrong": 0.0,
        "share_unlocked": 0.05,
        "frames_lost": 0.0,
        "ate_rmse_m": float(np.sqrt(np.mean(position**2))),
        "rpe_translation_rmse_m": float(np.sqrt(np.mean(np.diff(position) ** 2))),
        "rpe_rotation_rmse_deg": 0.1,
        "ms_per_frame": float(20.0 * np.exp(0.1 * generator.normal())),
        "peak_memory_mb": 400.0,
        "frames": float(len(position)),
    }
