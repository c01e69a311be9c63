"""Playing a recording: one page that holds it, and nothing else."""

import base64
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import viser

from pcnav.core.errors import InputError

_PORTS_TRIED = 100


def recording_page(recording: bytes) -> bytes:
    """A page of its own that plays a .viser recording."""
    page = Path(viser.__file__).parent / "client" / "build" / "index.html"
    html = page.read_text(encoding="utf-8")
    # As viser's own pages of a scene are made: the player looks for these two.
    data = base64.b64encode(recording).decode("ascii")
    script = (
        f'<script>window.__VISER_EMBED_DATA__="{data}";'
        "window.__VISER_EMBED_CONFIG__={darkMode:true};</script>"
    )
    end = html.index("</head>")
    return (html[:end] + script + html[end:]).encode("utf-8")


def serve_recording(path: Path, host: str, port: int) -> ThreadingHTTPServer:
    """A server of that page alone; a taken port moves up. Raises `InputError`."""
    try:
        page = recording_page(path.read_bytes())
    except OSError as error:
        raise InputError(path, "file", f"expected a readable file ({error.strerror})") from error

    class Handler(BaseHTTPRequestHandler):
        """Answers every request but for the page with: not found."""

        def do_GET(self) -> None:
            if self.path != "/":
                self.send_error(HTTPStatus.NOT_FOUND)
                return
            self.send_response(HTTPStatus.OK)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(page)))
            self.end_headers()
            self.wfile.write(page)

        def log_message(self, format: str, *args: object) -> None:
            """Say nothing of every request."""

    for tried in range(port, port + _PORTS_TRIED):
        try:
            return ThreadingHTTPServer((host, tried), Handler)
        except OSError:
            continue
    raise InputError("pcnav view", "--port", f"expected a free port from {port} on")
