"""A .viser recording, which may be a stranger's: checked, and served so that it can only be drawn.

The player would run scripts that a recording holds. So only messages that draw are let through, and
the page has a policy under which the player alone runs, in an origin of its own.
"""

import base64
import secrets
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import msgspec
import viser
import zstandard

from pcnav.core.errors import InputError
from pcnav.files.regular_file import read_bytes
from pcnav.viewer.server import is_own_host

MAX_BYTES = 300_000_000
"""Of a recording, packed or not: pcnav's own are of some 10 MB."""
_MAX_MESSAGE_BYTES = 50_000_000
_LENGTH_BYTES = 8
_PORTS_TRIED = 100
_PATIENCE_S = 30.0
"""For a request to be said: a browser says it at once."""
DRAWS = frozenset(
    f"{name}Message"
    for name in (
        *(
            "AmbientLight",
            "Arrow",
            "BackgroundImage",
            "BatchedAxes",
            "BatchedMeshes",
            "Box",
            "CameraFrustum",
        ),
        *("CatmullRomSpline", "CubicBezierSpline", "Cylinder", "DirectionalLight"),
        *("EnableLights", "EnvironmentMap", "Fog", "Frame", "Grid", "HemisphereLight"),
        *("Icosphere", "Label", "LineSegments", "Mesh", "PointCloud", "PointLight"),
        *("RectAreaLight", "RemoveSceneNode", "SceneNodeUpdate", "SetCameraFar", "SetCameraFov"),
        *("SetCameraLookAt", "SetCameraMaxOrbitDistance", "SetCameraMinOrbitDistance"),
        *("SetCameraNear", "SetCameraPosition", "SetCameraUpDirection", "SetOrientation"),
        *("SetPosition", "SetSceneNodeVisibility", "SpotLight", "ThemeConfiguration"),
    )
)
"""Messages that a recording may hold. None of them carries a program, a page or an address."""
_POLICY = "; ".join(
    (
        "default-src 'none'",
        "script-src 'nonce-{nonce}' 'wasm-unsafe-eval'",
        "style-src 'unsafe-inline'",
        "img-src data: blob:",
        "font-src data:",
        "connect-src data: blob:",
        "worker-src data: blob:",
        "base-uri 'none'",
        "form-action 'none'",
        "frame-ancestors 'none'",
        # An origin that no other page has, of this server or another.
        "sandbox allow-scripts",
    )
)
# The player packs its program into one script, which makes the one that it runs: that one alone is
# given the page's number as well.
_ADMIT = (
    '<script nonce="{nonce}">{{const make=document.createElement;'
    "document.createElement=function(name,...rest){{"
    'const made=make.call(document,name,...rest);if(name==="script"){{made.nonce="{nonce}";'
    "document.createElement=make;}}return made;}};}}</script>"
)


class _Recording(msgspec.Struct):
    durationSeconds: float
    messages: list[tuple[float, dict[str, Any]]]
    viserVersion: str
    binaryBufferLengths: list[int]


def read_recording(path: Path) -> bytes:
    """A .viser recording, checked to hold nothing but a scene.

    Raises `InputError` for a file that cannot be read, is damaged or too large, or has a message
    of another kind.
    """
    content = read_bytes(path, MAX_BYTES)
    inner = _unpacked(path, content)
    length = int.from_bytes(inner[:_LENGTH_BYTES], "little")
    if not 0 < length <= min(len(inner) - _LENGTH_BYTES, _MAX_MESSAGE_BYTES):
        raise _damaged(path, "its messages do not end")
    try:
        found = msgspec.msgpack.decode(
            inner[_LENGTH_BYTES : _LENGTH_BYTES + length], type=_Recording
        )
    except (msgspec.MsgspecError, ValueError, RecursionError) as error:
        raise _damaged(path, f"its messages cannot be read, {error}") from error
    room = len(inner) - _LENGTH_BYTES - length
    if any(each < 0 for each in found.binaryBufferLengths) or sum(found.binaryBufferLengths) > room:
        raise _damaged(path, "its arrays do not end")
    for _, message in found.messages:
        kind = message.get("type")
        if kind not in DRAWS:
            expected = f"expected messages that draw a scene alone, found {kind!r:.60}"
            raise InputError(path, "messages", expected)
    return content


def _unpacked(path: Path, content: bytes) -> bytes:
    size = int.from_bytes(content[:_LENGTH_BYTES], "little")
    if not _LENGTH_BYTES < size <= MAX_BYTES:
        raise _damaged(path, f"a size of {size} bytes where at most {MAX_BYTES:,} are read")
    try:
        with zstandard.ZstdDecompressor().stream_reader(content[_LENGTH_BYTES:]) as reader:
            inner = reader.read(size + 1)
    except zstandard.ZstdError as error:
        raise _damaged(path, f"it cannot be unpacked, {error}") from error
    if len(inner) != size:
        raise _damaged(path, "it is not of the size that it says")
    return inner


def _damaged(path: Path, reason: str) -> InputError:
    return InputError(path, "file", f"expected a whole .viser recording ({reason})")


def recording_page(recording: bytes, nonce: str) -> bytes:
    """A page of its own that plays a .viser recording; ``nonce`` lets its own scripts run."""
    page = Path(viser.__file__).parent / "client" / "build" / "index.html"
    html = page.read_text(encoding="utf-8").replace("<script", f'<script nonce="{nonce}"')
    # As viser's own pages of a scene are made: the player looks for these two.
    data = base64.b64encode(recording).decode("ascii")
    script = (
        f'<script nonce="{nonce}">window.__VISER_EMBED_DATA__="{data}";'
        "window.__VISER_EMBED_CONFIG__={darkMode:true};</script>"
    )
    start, end = html.index("<head>") + len("<head>"), html.index("</head>")
    admit = _ADMIT.format(nonce=nonce)
    return (html[:start] + admit + html[start:end] + script + html[end:]).encode("utf-8")


def serve_recording(path: Path, host: str, port: int) -> ThreadingHTTPServer:
    """A server of a recording's page alone; a taken port moves up. Raises `InputError`."""
    nonce = secrets.token_urlsafe(16)
    page, policy = recording_page(read_recording(path), nonce), _POLICY.format(nonce=nonce)

    class Handler(BaseHTTPRequestHandler):
        """Answers every request but for the page with: not found."""

        timeout = _PATIENCE_S

        def do_GET(self) -> None:
            if not is_own_host(self.headers.get("Host"), host):
                self.send_error(HTTPStatus.MISDIRECTED_REQUEST)
                return
            if self.path != "/":
                self.send_error(HTTPStatus.NOT_FOUND)
                return
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(page)))
            self.send_header("Content-Security-Policy", policy)
            self.send_header("X-Content-Type-Options", "nosniff")
            self.send_header("Referrer-Policy", "no-referrer")
            self.end_headers()
            self.wfile.write(page)

        def log_message(self, format: str, *args: object) -> None:
            """Say nothing of every request."""

    class Server(ThreadingHTTPServer):
        """One that says nothing of browsers that leave in the middle."""

        def handle_error(self, request: object, client_address: object) -> None:
            """A request that ends badly is the browser's affair."""

    for tried in range(port, port + _PORTS_TRIED):
        try:
            return Server((host, tried), Handler)
        except (OSError, OverflowError):
            continue
    raise InputError("pcnav view", "--port", f"expected a free port from {port} on")
