"""What is particular to the process of a run: threads of its linear algebra, and its memory."""

import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_RESET_PEAK = "5"
_MB = 1e6


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Libraries loaded within, and processes started within, keep to one thread each.

    Many runs at once then do not fight, and all sum in one order. The libraries read these
    variables as they are loaded, so one that is loaded already in this process keeps the threads
    that it has.
    """
    before = {name: os.environ.get(name) for name in _THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(_THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is not None:
                os.environ[name] = value
            else:
                os.environ.pop(name, None)


def reset_peak_memory() -> None:
    """Forget the peak so far, where the system allows it: Linux does."""
    try:
        _CLEAR.write_text(_RESET_PEAK, encoding="ascii")
    except OSError:
        return


def peak_memory_mb() -> float:
    """Largest resident memory of this process since `reset_peak_memory`, MB of 1e6 bytes.

    Where the peak cannot be reset, since the process began; nan where the system does not tell.
    """
    try:
        lines = _STATUS.read_text(encoding="ascii").splitlines()
        peak = next(line for line in lines if line.startswith("VmHWM"))
        return float(peak.split()[1]) * 1024.0 / _MB
    except (OSError, StopIteration):
        return _lifetime_peak_mb()


def _lifetime_peak_mb() -> float:
    if sys.platform == "win32":
        return math.nan
    import resource

    unit = 1.0 if sys.platform == "darwin" else 1024.0
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / _MB
