"""One file over HTTP: whole, for the page that may read it, on this machine."""

from __future__ import annotations

import os
from http.client import HTTPConnection
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

import pytest

from knee_contact_ros.view.file_server import served
from tests.viewer import free_port


class Answer(NamedTuple):
    """What comes."""

    status: int
    content: bytes
    length: str | None
    """As announced"""
    reader: str | None
    """The page that may read it"""


def asked(address: str, place: str | None = None, origin: str = "", method: str = "GET") -> Answer:
    """Ask the server of an address for it, or for another place."""
    parts = urlsplit(address)
    connection = HTTPConnection(parts.netloc, timeout=30.0)
    connection.request(method, parts.path if place is None else place, headers={"Origin": origin})
    answer = connection.getresponse()
    content, headers = answer.read(), answer.headers
    connection.close()
    return Answer(answer.status, content, headers["Content-Length"], headers["Access-Control-Allow-Origin"])


def test_a_file_is_served_until_the_end(tmp_path: Path) -> None:
    path, data = tmp_path / "a knee.rrd", os.urandom(300_000)
    path.write_bytes(data)
    with served(path, free_port(), page=9999) as address:
        assert address.startswith("http://127.0.0.1:")
        assert asked(address) == (200, data, "300000", None)
        assert asked(address, method="HEAD") == (200, b"", "300000", None)
        assert asked(address, "/a%20knee.rrd?again=1").content == data
    with pytest.raises(ConnectionRefusedError):
        asked(address)


def test_only_our_page_may_read_it(tmp_path: Path) -> None:
    path = tmp_path / "knee.rrd"
    path.write_bytes(b"knee")
    with served(path, free_port(), page=9999) as address:
        for origin in ("http://127.0.0.1:9999", "http://localhost:9999"):
            assert asked(address, origin=origin).reader == origin
        assert asked(address, origin="http://example.org").reader is None


@pytest.mark.parametrize("place", ["/", "/other.rrd", "/../knee.rrd", "/knee.rrd/.."])
def test_nothing_else_is_served(tmp_path: Path, place: str) -> None:
    path = tmp_path / "knee.rrd"
    path.write_bytes(b"knee")
    (tmp_path / "other.rrd").write_bytes(b"other")
    with served(path, free_port(), page=9999) as address:
        assert asked(address, place).status == 404
