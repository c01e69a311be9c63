"""A stranger's recording: nothing but a scene is let through, and nothing of it can run."""

import http.client
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import msgspec
import pytest
import zstandard

from pcnav.core.errors import InputError
from pcnav.viewer.playback import MAX_BYTES, read_recording, serve_recording

FRAME = {"type": "FrameMessage", "name": "/a", "props": {}}


def written(folder: Path, *messages: dict[str, Any], **about: object) -> Path:
    """A recording of some messages."""
    content = {
        "durationSeconds": 1.0,
        "messages": [(0.0, message) for message in messages],
        "viserVersion": "1.1.1",
        "binaryBufferLengths": [],
        **about,
    }
    payload = msgspec.msgpack.encode(content)
    inner = len(payload).to_bytes(8, "little") + payload
    return packed(folder, inner, len(inner))


def packed(folder: Path, inner: bytes, size: int) -> Path:
    path = folder / "a.viser"
    path.write_bytes(size.to_bytes(8, "little") + zstandard.ZstdCompressor().compress(inner))
    return path


@contextmanager
def served(path: Path) -> Iterator[int]:
    """The port of a recording's page."""
    server = serve_recording(path, "127.0.0.1", 0)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield server.server_port
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


def test_only_messages_that_draw_are_let_through(tmp_path: Path) -> None:
    read_recording(written(tmp_path, FRAME))
    for kind in ("RunJavascriptMessage", "GuiHtmlMessage", "GuiMarkdownMessage", "\n" * 500, None):
        path = written(tmp_path, FRAME, {"type": kind, "source": "alert(1)"})
        with pytest.raises(InputError, match="messages that draw a scene alone") as caught:
            serve_recording(path, "127.0.0.1", 0)
        assert len(str(caught.value)) < 300


def test_a_recording_that_is_none_or_unpacks_without_end_is_refused(tmp_path: Path) -> None:
    for content in (b"", b"viser", b"\xff" * 100, b"\x10" + b"\0" * 7 + b"no zstd frame at all"):
        path = tmp_path / "a.viser"
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"a whole \.viser recording"):
            read_recording(path)
    bomb = b"\0" * 50_000_000
    for size in (len(bomb), 100, MAX_BYTES + 1):
        with pytest.raises(InputError, match=r"a whole \.viser recording"):
            read_recording(packed(tmp_path, bomb, size))
    deep = b"\x91" * 100_000 + b"\x90"
    with pytest.raises(InputError, match="messages cannot be read"):
        inner = len(deep).to_bytes(8, "little") + deep
        read_recording(packed(tmp_path, inner, len(inner)))
    with pytest.raises(InputError, match="arrays do not end"):
        read_recording(written(tmp_path, FRAME, binaryBufferLengths=[1 << 40]))


def test_its_page_answers_its_own_name_alone_and_has_a_policy_without_scripts_of_it(
    tmp_path: Path,
) -> None:
    with served(written(tmp_path, FRAME)) as port:
        answers = {}
        for host in (f"127.0.0.1:{port}", f"localhost:{port}", f"evil.example:{port}", "[", ""):
            connection = http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)
            connection.request("GET", "/", headers={"Host": host})
            answer = connection.getresponse()
            answers[host.partition(":")[0]] = (answer.status, answer.headers)
            page = answer.read()
            connection.close()
            assert (b"__VISER_EMBED_DATA__=" in page) == (answer.status == 200)
    assert [status for status, _ in answers.values()] == [200, 200, 421, 421, 421]
    policy = answers["localhost"][1]["Content-Security-Policy"]
    assert "default-src 'none'" in policy and "sandbox allow-scripts" in policy
    scripts = next(each for each in policy.split("; ") if each.startswith("script-src"))
    assert "nonce-" in scripts
    assert not {"'unsafe-inline'", "'unsafe-eval'", "*", "http:", "data:"} & set(scripts.split())
