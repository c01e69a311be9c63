"""The same on the workers of a dask cluster that share a folder: a sketch, not run as a test.

Who reaches the port of a dask scheduler runs code on it: see docs/cluster.md for TLS.
"""

from pathlib import Path

from dask.distributed import Client, as_completed

import pcnav

SHARED = Path("/shared")


def navigate(recording: Path) -> str:
    """Runs on a worker."""
    pcnav.run(recording, SHARED / "results" / recording.name, overwrite=True, report=False)
    return recording.name


client = Client("tls://scheduler:8786", security=None)  # your own dask.distributed.Security
futures = client.map(navigate, sorted((SHARED / "recordings").iterdir()), pure=False)
for future in as_completed(futures):
    print(future.result() if future.status == "finished" else future.exception())
