"""Linear algebra on one thread: many runs at once do not fight, and all sum in one order."""

import os
from collections.abc import Iterator
from contextlib import contextmanager

THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
# A process that starts workers is given these as well, by dask.
_SET_BY_DASK = ("MALLOC_TRIM_THRESHOLD_", "PYTHONHASHSEED")


@contextmanager
def one_thread_each() -> Iterator[None]:
    """Libraries loaded within, and processes started within, keep to one thread each.

    The libraries read these variables as they are loaded, so one that is loaded already in this
    process keeps the threads that it has.
    """
    names = (*THREAD_VARIABLES, *_SET_BY_DASK)
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is not None:
                os.environ[name] = value
            else:
                os.environ.pop(name, None)
