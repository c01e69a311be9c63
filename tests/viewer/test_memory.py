"""Memory that was taken for a moment is given back."""

import subprocess
import sys
from pathlib import Path

import pytest

_THREADS_THAT_COME_AND_GO = """
import threading
import numpy as np
from pcnav.viewer.memory import give_back_large_arrays

def resident_mb():
    told = dict(line.split(":", 1) for line in open("/proc/self/status"))
    return float(told["VmRSS"].split()[0]) * 1024e-6

give_back_large_arrays()
before, kept, held = resident_mb(), [], threading.Barrier(6)

def work():
    # Each size is freed before the next is asked for; small ones that stay lie above them.
    for megabytes in (2, 6, 12, 20, 24):
        large = np.ones(megabytes * 2**17)
        kept.append(np.ones(100))
        del large
    held.wait()

threads = [threading.Thread(target=work) for _ in range(6)]
[thread.start() for thread in threads]
[thread.join() for thread in threads]
print(resident_mb() - before)
"""


@pytest.mark.skipif(not Path("/proc/self/status").is_file(), reason="memory is not told here")
def test_large_arrays_of_threads_are_given_back() -> None:
    command = [sys.executable, "-c", _THREADS_THAT_COME_AND_GO]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    # Six threads held 24 MB each.
    assert float(done.stdout) < 15.0
