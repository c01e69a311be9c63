"""What is no file is refused at once, whoever reads it: a pipe would be waited for for ever."""

import os
import signal
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from pcnav.core.errors import InputError
from pcnav.files.csv_table import read_csv, read_header
from pcnav.files.regular_file import read_bytes
from pcnav.files.toml_file import read_toml
from pcnav.recordings.bop_scene import read_scene_camera
from pcnav.recordings.depth_image import read_depth_image
from pcnav.recordings.depth_png import read_depth_png
from pcnav.recordings.timed_poses import read_timed_poses

pytestmark = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no such files")


@pytest.fixture(autouse=True)
def impatient() -> Iterator[None]:
    """A test that waits fails."""

    def fail(*_: object) -> None:
        raise TimeoutError("it is waited for")

    before = signal.signal(signal.SIGALRM, fail)
    signal.alarm(10)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("a.png", read_depth_png),
        *((f"a{suffix}", read_depth_image) for suffix in (".png", ".npy", ".tiff")),
        ("a.csv", lambda path: read_csv(path, ("time_s",))),
        ("a.csv", read_header),
        ("a.toml", read_toml),
        ("a.json", read_scene_camera),
        ("a.txt", read_timed_poses),
    ],
)
def test_a_pipe_is_one_line(tmp_path: Path, name: str, read: Callable[[Path], object]) -> None:
    path = tmp_path / name
    os.mkfifo(path)
    with pytest.raises(InputError, match="this is a pipe, a socket or a device"):
        read(path)


def test_a_device_and_what_grows_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="a pipe, a socket or a device"):
        read_bytes(Path("/dev/zero"), 1000)
    (tmp_path / "long").write_bytes(b"a" * 1001)
    with pytest.raises(InputError, match="at most 1,000 bytes, it has 1,001"):
        read_bytes(tmp_path / "long", 1000)


def test_a_small_file_takes_little_memory_however_large_it_might_be(tmp_path: Path) -> None:
    path = tmp_path / "small.pcd"
    path.write_bytes(b"0123456789")
    tracemalloc.start()
    try:
        assert read_bytes(path, 4_000_000_000) == b"0123456789"
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()
    assert read_bytes(path, 10) == b"0123456789"
    with pytest.raises(InputError, match="at most 9 bytes"):
        read_bytes(path, 9)
    # It tells no size, and has one.
    assert read_bytes(Path("/proc/self/status"), 1_000_000).startswith(b"Name:")


def test_a_message_is_one_printable_line_of_bounded_length() -> None:
    error = InputError("a\x1b[2J\nb", "x" * 10**6, "expected\r\n\t one\u202e " + "y" * 10**6)
    assert str(error).isprintable() and len(str(error)) < 2000
    assert str(error).startswith("a [2J b: xxx")
