"""pcnav: pose, motion, mass centre and inertia of a tumbling satellite from depth frames.

The names below are what programs use; each is imported when it is first asked for, so that
``import pcnav`` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pcnav.config.pipeline_file import Pipeline, read_pipeline
    from pcnav.core.camera import PinholeCamera
    from pcnav.core.errors import InputError
    from pcnav.estimators.interface import Given
    from pcnav.estimators.registry import ESTIMATORS, make_estimator
    from pcnav.evaluation.metrics import evaluate
    from pcnav.pipeline import run
    from pcnav.recordings.calibration import Calibration
    from pcnav.recordings.opening import open_recording, open_sequence
    from pcnav.recordings.truth import read_truth
    from pcnav.runs.estimate import Estimate
    from pcnav.runs.reader import read_run
    from pcnav.runs.status import Status
    from pcnav.target.satellite import Target, load_target
    from pcnav.tracker import Tracker

__version__ = "0.1.0"

__all__ = [
    "ESTIMATORS",
    "Calibration",
    "Estimate",
    "Given",
    "InputError",
    "PinholeCamera",
    "Pipeline",
    "Status",
    "Target",
    "Tracker",
    "evaluate",
    "load_target",
    "make_estimator",
    "open_recording",
    "open_sequence",
    "read_pipeline",
    "read_run",
    "read_truth",
    "run",
]

_HOMES = {
    "ESTIMATORS": "pcnav.estimators.registry",
    "Calibration": "pcnav.recordings.calibration",
    "Estimate": "pcnav.runs.estimate",
    "Given": "pcnav.estimators.interface",
    "InputError": "pcnav.core.errors",
    "PinholeCamera": "pcnav.core.camera",
    "Pipeline": "pcnav.config.pipeline_file",
    "Status": "pcnav.runs.status",
    "Target": "pcnav.target.satellite",
    "Tracker": "pcnav.tracker",
    "evaluate": "pcnav.evaluation.metrics",
    "load_target": "pcnav.target.satellite",
    "make_estimator": "pcnav.estimators.registry",
    "open_recording": "pcnav.recordings.opening",
    "open_sequence": "pcnav.recordings.opening",
    "read_pipeline": "pcnav.config.pipeline_file",
    "read_run": "pcnav.runs.reader",
    "read_truth": "pcnav.recordings.truth",
    "run": "pcnav.pipeline",
}
"""Public names and the modules they stand in."""


def __dir__() -> list[str]:
    return [*globals(), *_HOMES]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
