"""Runs a sequence and prints its peak memory as JSON: ``SEQUENCE PIPELINE.toml RESULT``."""

import json
import platform
import resource
import sys
from pathlib import Path

from pcnav.config.pipeline_file import read_pipeline
from pcnav.pipeline import run
from pcnav.runs.estimate import Estimate


def main(sequence: Path, pipeline: Path, out: Path) -> None:
    """Run it, noting the peak after the last frame and at the end."""
    tracked = {"frames": 0, "bytes": 0}

    def note(_: Estimate, done: int, total: int) -> None:
        if done == total:
            tracked.update(frames=total, bytes=_peak_bytes())

    run(sequence, out, read_pipeline(pipeline), on_estimate=note)
    answer = {
        "frames": tracked["frames"],
        "tracking_bytes": tracked["bytes"],
        "whole_bytes": _peak_bytes(),
    }
    print(json.dumps(answer))


def _peak_bytes() -> int:
    """Peak resident memory of this process so far."""
    if platform.system() == "Linux":
        # What getrusage says starts here from the peak of the process that started this one.
        status = Path("/proc/self/status").read_text(encoding="ascii").split()
        return 1024 * int(status[status.index("VmHWM:") + 1])
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    # Bytes on macOS, kilobytes elsewhere.
    return peak if platform.system() == "Darwin" else 1024 * peak


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:]))
