"""pcnav: pose, motion, mass centre and inertia of a tumbling satellite from depth frames.

The names below are what programs use; each is imported when it is first asked for, so that
``import pcnav`` costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pcnav.config.pipeline_file import Pipeline as Pipeline
    from pcnav.config.pipeline_file import read_pipeline as read_pipeline
    from pcnav.core.errors import InputError as InputError
    from pcnav.estimators.interface import Given as Given
    from pcnav.estimators.registry import ESTIMATORS as ESTIMATORS
    from pcnav.estimators.registry import make_estimator as make_estimator
    from pcnav.evaluation.metrics import evaluate as evaluate
    from pcnav.pipeline import run as run
    from pcnav.recordings.opening import open_recording as open_recording
    from pcnav.recordings.opening import open_sequence as open_sequence
    from pcnav.recordings.truth import read_truth as read_truth
    from pcnav.runs.reader import read_run as read_run
    from pcnav.target.satellite import load_target as load_target

__version__ = "0.1.0"

_HOMES = {
    "Pipeline": "pcnav.config.pipeline_file",
    "read_pipeline": "pcnav.config.pipeline_file",
    "InputError": "pcnav.core.errors",
    "Given": "pcnav.estimators.interface",
    "ESTIMATORS": "pcnav.estimators.registry",
    "make_estimator": "pcnav.estimators.registry",
    "evaluate": "pcnav.evaluation.metrics",
    "run": "pcnav.pipeline",
    "open_recording": "pcnav.recordings.opening",
    "open_sequence": "pcnav.recordings.opening",
    "read_truth": "pcnav.recordings.truth",
    "read_run": "pcnav.runs.reader",
    "load_target": "pcnav.target.satellite",
}
"""Public names and the modules they stand in."""


def __dir__() -> list[str]:
    return [*globals(), *_HOMES]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
