"""A recording of rerun holds cloud, poses, numbers and events at their frames."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pcnav.core import _extras
from pcnav.viewer.export import Share, exported, file_name
from pcnav.viewer.layers import shot_of
from pcnav.viewer.loaded_run import LoadedRun, all_events
from pcnav.viewer.render_options import RenderOptions
from tests.viewer.conftest import FRAMES

LAST = FRAMES - 1


class Recorded:
    """In place of rerun: what was logged, by place and frame."""

    ViewCoordinates = SimpleNamespace(RDF="RDF")

    def __init__(self) -> None:
        self.logged: dict[tuple[str, int], list[Any]] = {}
        self.frame = -1

    def RecordingStream(self, *_: object, **__: object) -> "Recorded":
        return self

    def memory_recording(self) -> SimpleNamespace:
        return SimpleNamespace(drain_as_bytes=lambda: b"all")

    def set_time(self, name: str, sequence: int = -1, duration: float = 0.0) -> None:
        self.frame = sequence if name == "frame" else self.frame

    def log(self, place: str, what: Any, static: bool = False) -> None:
        self.logged.setdefault((place, -1 if static else self.frame), []).append(what)

    def flush(self) -> None:
        """Nothing waits."""

    def new_entity_path(self, parts: list[str]) -> str:
        return "/".join(parts)

    def __getattr__(self, kind: str) -> Any:
        def made(*values: Any, **named: Any) -> SimpleNamespace:
            image = SimpleNamespace(kind=kind, values=values, **named)
            image.compress = lambda **_: image
            return image

        return made


def test_what_is_recorded_is_what_the_view_shows(
    loaded: LoadedRun, monkeypatch: pytest.MonkeyPatch
) -> None:
    told, stub = list[int](), Recorded()
    monkeypatch.setattr(_extras, "rerun", lambda _: stub)
    content = exported(
        Share.RRD, (loaded,), 0, RenderOptions(), on_frame=lambda done, _: told.append(done)
    )
    assert content == b"all" and told == list(range(1, FRAMES + 1))
    assert file_name(Share.RRD, (loaded,), 3) == "result.rrd"
    shot, pose = shot_of(loaded, LAST), loaded.pose(LAST)
    assert shot is not None and pose is not None
    np.testing.assert_array_equal(stub.logged["camera/points", LAST][0].values[0], shot.points)
    placed = stub.logged["camera/run_1", LAST][0]
    np.testing.assert_array_equal(placed.translation, pose[:3, 3])
    np.testing.assert_array_equal(placed.mat3x3, pose[:3, :3])
    # No estimate in the first frame: the mesh is taken away.
    assert stub.logged["camera/run_1", 0][0].kind == "Clear"
    inliers = loaded.run.notes["inlier_ratio"][LAST]
    assert stub.logged["plots/result/inlier ratio", LAST][0].values == (inliers,)
    events = [
        each for (place, _), found in stub.logged.items() if place == "events" for each in found
    ]
    assert len(events) == len(all_events((loaded,)))
    assert ("camera/run_1/edges", -1) in stub.logged and ("image", LAST) in stub.logged


@pytest.mark.study
def test_rerun_itself_takes_it(loaded: LoadedRun) -> None:
    pytest.importorskip("rerun")
    content = exported(Share.RRD, (loaded,), 0, RenderOptions())
    assert content[:3] == b"RRF" and len(content) > 50_000
