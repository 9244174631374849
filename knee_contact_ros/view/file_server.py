"""An HTTP server of one file, for browsers and viewers on this machine."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any
from urllib.parse import quote, urlsplit

from knee_contact_ros.system.ports import LOCALHOST
from knee_contact_ros.view.visitors import is_allowed


@contextmanager
def served(path: Path, port: int, page: int) -> Iterator[str]:
    """Serve a file at a port of the loopback interface, and yield its address; pages of the port `page` may read it.

    Requests under a name that is not this machine's, or from a page of another site, are refused (403).

    Raises:
        OSError: the port is taken.
    """

    class Handler(_Handler):
        file = path
        ports = port, page

    with ThreadingHTTPServer((LOCALHOST, port), Handler) as server:
        Thread(target=server.serve_forever, name="file server", daemon=True).start()
        try:
            yield f"http://{LOCALHOST}:{port}{_place(path)}"
        finally:
            server.shutdown()


def _place(path: Path) -> str:
    """Return the path of the file's URL."""
    return f"/{quote(path.name)}"


class _Handler(BaseHTTPRequestHandler):
    file: Path
    ports: tuple[int, int]
    """Ports of this server and of the page that may read the file"""

    def do_HEAD(self) -> None:
        """Answer a HEAD request: the headers only."""
        self._begin()

    def do_GET(self) -> None:
        """Answer a GET request: the headers and the file."""
        if self._begin():
            with self.file.open("rb") as file, suppress(ConnectionError):  # who asked may have gone
                shutil.copyfileobj(file, self.wfile)

    def log_message(self, *_: Any) -> None:
        """Log nothing: the terminal is the user's."""

    def _begin(self) -> bool:
        """Send the headers, or an error; return whether the file may be sent."""
        port, page = self.ports
        if not is_allowed(self.headers.items(), port, [page]):
            self.send_error(403)
            return False
        if urlsplit(self.path).path != _place(self.file):
            self.send_error(404)
            return False
        self.send_response(200)
        self.send_header("Content-Type", "application/octet-stream")
        self.send_header("Content-Length", str(self.file.stat().st_size))
        if origin := self.headers.get("Origin"):
            self.send_header("Access-Control-Allow-Origin", origin)
            self.send_header("Vary", "Origin")
        self.end_headers()
        return True
