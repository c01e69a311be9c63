"""Peak memory of a part of a process."""

import math
import sys
from pathlib import Path

_STATUS, _CLEAR = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_RESET_PEAK = "5"
_MB = 1e6


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
