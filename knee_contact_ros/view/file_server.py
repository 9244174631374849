"""One file for browsers and viewers on this machine, over HTTP."""

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
    """Serve a file on the loopback interface; gives its address. Pages of the port `page` may read it, others may not.

    Who asks under another name than this machine's, or for a page of another site, is refused (403).

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
    return f"/{quote(path.name)}"


class _Handler(BaseHTTPRequestHandler):
    file: Path
    ports: tuple[int, int]
    """Ours, and that of the page"""

    def do_HEAD(self) -> None:
        """Tell that it is there, and how large."""
        self._begin()

    def do_GET(self) -> None:
        """Give it."""
        if self._begin():
            with self.file.open("rb") as file, suppress(ConnectionError):  # who asked may have gone
                shutil.copyfileobj(file, self.wfile)

    def log_message(self, *_: Any) -> None:
        """Say nothing on the terminal."""

    def _begin(self) -> bool:
        """Send what comes before the file; whether it is the file that was asked for, and may be given."""
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
