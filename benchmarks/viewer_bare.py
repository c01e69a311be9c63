"""A bare viser script: ``python -m benchmarks.viewer_bare CLOUDS.npz HZ``.

It shows clouds that were computed before, one after the other, and does nothing else. The file
holds ``points`` (n, 3) m and ``colours`` (n, 3) of all frames together, ``ends`` (frames,) where
each frame ends, ``point_size`` m, and ``camera`` (7,): place, what it looks at, field of view. Its
settings are viser's own. It prints its port and serves until it is terminated.
"""

import sys
import time
from pathlib import Path

import numpy as np
import viser


def main(clouds: Path, hz: float) -> None:
    """Serve the clouds of a file, so many a second."""
    with np.load(clouds) as told:
        points, colours, ends = told["points"], told["colours"], told["ends"]
        point_size, seen_from = float(told["point_size"]), told["camera"].tolist()
    starts = np.concatenate([[0], ends[:-1]])
    frames = [
        (points[a:b].astype(np.float32), colours[a:b]) for a, b in zip(starts, ends, strict=True)
    ]
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    camera = server.initial_camera
    camera.position, camera.look_at = tuple(seen_from[:3]), tuple(seen_from[3:6])
    camera.up, camera.fov = (0.0, -1.0, 0.0), seen_from[6]
    cloud = server.scene.add_point_cloud("/cloud", *frames[0], point_size=point_size)
    print(f"port: {server.get_port()}", flush=True)
    k, due = 0, time.monotonic()
    while True:
        k, due = (k + 1) % len(frames), due + 1.0 / hz
        with server.atomic():
            cloud.points, cloud.colors = frames[k]
        time.sleep(max(due - time.monotonic(), 0.0))


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]))
