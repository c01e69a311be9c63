"""A run of a few frames and what talks to its server, shared by the tests of the web view."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
import viser
import zstandard
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.typing import Subprotocol

from pcnav.config.pipeline_file import Pipeline
from pcnav.navigation import RunSummary
from pcnav.pipeline import run
from pcnav.runs.estimate import Estimate
from pcnav.simulation.depth import Scene
from pcnav.target.satellite import load_target
from pcnav.viewer.live import LiveView
from pcnav.viewer.loaded_run import LoadedRun
from pcnav.viewer.loading import load_run

FRAMES = 12
CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (0.0, 0.0, 0.0),
    "fov": 0.7,
    "near": 0.01,
    "far": 1000.0,
    "image_height": 600,
    "image_width": 800,
    "look_at": (0.0, 0.0, 1.0),
    "up_direction": (0.0, -1.0, 0.0),
}
"""What a page says of where its camera is."""
_PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")


def small_pipeline() -> Pipeline:
    """A box satellite that turns before the camera."""
    return Pipeline.model_validate(
        {
            "scenario": {"frames": FRAMES},
            "orbit": {"r_hill_m": (20.0, 0.0, 0.0)},
            "camera": {"horizontal_fov_deg": 32.0, "width_px": 128, "height_px": 128},
            "body": {
                "omega_body_deg_s": (1.0, -1.0, 2.0),
                "attitude_rotvec_deg": (25.0, 40.0, -30.0),
            },
        }
    )


@pytest.fixture(scope="session")
def run_folder(tmp_path_factory: pytest.TempPathFactory, repository: Path) -> Path:
    """A result folder, beside the sequence that it was made from."""
    base = tmp_path_factory.mktemp("viewer")
    pipeline = small_pipeline()
    target = load_target(repository / "meshes" / "boxsat.obj")
    Scene.showing(target, pipeline).write(base / "sequence")
    run(base / "sequence", base / "result", pipeline)
    return base / "result"


@pytest.fixture(scope="session")
def loaded(run_folder: Path) -> LoadedRun:
    """The same, as the view has it."""
    return load_run(run_folder)


def watched(
    recording: Path,
    out: Path,
    pipeline: Pipeline,
    view: LiveView,
    on_frame: Callable[[int], None] = lambda done: None,
    estimator: str | None = None,
) -> RunSummary:
    """A run that a view is told of; ``on_frame`` is told how many frames it has been shown."""

    def show(estimate: Estimate, done: int, _: int) -> None:
        view.add(estimate)
        on_frame(done)

    return run(
        recording,
        out,
        pipeline,
        estimator=estimator,
        on_start=lambda as_run, output: view.expect(out.name, as_run, output),
        on_estimate=show,
    )


def connected(port: int) -> Connection:
    """A page as far as the server knows: what it says and is sent, without a browser."""
    page = connect(f"ws://127.0.0.1:{port}", subprotocols=[_PROTOCOL], max_size=None)
    page.send(msgspec.msgpack.encode(CAMERA))
    return page


def messages_in(data: bytes) -> list[dict[str, Any]]:
    """What viser sends: two lengths of 8 bytes, compressed messages, and arrays."""
    n = int.from_bytes(data[8:16], "little")
    text = zstandard.ZstdDecompressor().decompress(data[16 : 16 + n])
    return list(msgspec.msgpack.decode(text)["messages"])
