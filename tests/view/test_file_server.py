"""One file over HTTP: whole, for the page that may read it, on this machine."""

from __future__ import annotations

import os
from http.client import HTTPConnection
from pathlib import Path
from typing import NamedTuple
from urllib.parse import urlsplit

import pytest

from knee_contact_ros.system.ports import free_port
from knee_contact_ros.view.file_server import served


class Answer(NamedTuple):
    """What comes."""

    status: int
    content: bytes
    length: str | None
    """As announced"""
    reader: str | None
    """The page that may read it"""


def asked(
    address: str, place: str | None = None, origin: str = "", method: str = "GET", host: str | None = None
) -> Answer:
    """Ask the server of an address for it, or for another place, or by another name."""
    parts = urlsplit(address)
    connection = HTTPConnection(parts.netloc, timeout=30.0)
    headers = ({"Origin": origin} if origin else {}) | ({} if host is None else {"Host": host})
    connection.request(method, parts.path if place is None else place, headers=headers)
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
        for origin in ("http://example.org", "http://example.org:9999", "http://127.0.0.1:9998", "null"):
            assert asked(address, origin=origin)[0::3] == (403, None)


@pytest.mark.parametrize("name", ["example.org", "127.0.0.1.example.org", "localhost.", "127.0.0.2", ""])
def test_who_asks_by_another_name_is_refused(tmp_path: Path, name: str) -> None:
    """As a page does whose owner lets its name point to this machine."""
    path = tmp_path / "knee.rrd"
    path.write_bytes(b"knee")
    with served(path, free_port(), page=9999) as address:
        port = urlsplit(address).port
        for host in (f"{name}:{port}", name):
            for method in ("GET", "HEAD"):
                answer = asked(address, host=host, method=method)
                assert answer.status == 403
                assert b"knee" not in answer.content
        for host in (f"127.0.0.1:{port}", f"localhost:{port}", f"LOCALHOST:{port}", f"[::1]:{port}"):
            assert asked(address, host=host).content == b"knee"
        assert asked(address, host="127.0.0.1:1").status == 403


@pytest.mark.parametrize("place", ["/", "/other.rrd", "/../knee.rrd", "/knee.rrd/.."])
def test_nothing_else_is_served(tmp_path: Path, place: str) -> None:
    path = tmp_path / "knee.rrd"
    path.write_bytes(b"knee")
    (tmp_path / "other.rrd").write_bytes(b"other")
    with served(path, free_port(), page=9999) as address:
        assert asked(address, place).status == 404
