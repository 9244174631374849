"""What a node serves: viewers on this machine see it, pages of other sites do not."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import closing
from http.client import HTTPConnection
from ipaddress import ip_address

import psutil
import pytest

pytest.importorskip("rerun", reason="needs the extra viewer")
import rerun as rr

from knee_contact_ros import load_model
from knee_contact_ros.system.ports import LOCALHOST, free_port
from knee_contact_ros.view.gate import PATIENCE, Gate
from knee_contact_ros.view.outlets import Served
from knee_contact_ros.view.outlines import drawing_of
from knee_contact_ros.view.visitors import unguessable_address

TOLD = "a knee of somebody"
READ = "/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages"
"""What a viewer in a browser asks Rerun's server for"""


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    """That of a scene that is served."""
    number = free_port(LOCALHOST)
    served = Served(number, [drawing_of(load_model({}), "knee", 737.0)])
    served.recording.log("text", rr.TextLog(TOLD), static=True)
    served.flush()
    yield number
    served.close()
    with pytest.raises(ConnectionRefusedError):
        asked(number, {})


def asked(port: int, headers: dict[str, str], address: str = LOCALHOST) -> tuple[int, bool]:
    """The answer's code, and whether it tells what is served."""
    with closing(HTTPConnection(address, port, timeout=30.0)) as connection:
        web = {"Content-Type": "application/grpc-web+proto", "X-Grpc-Web": "1"}
        connection.request("POST", READ, bytes(5), web | headers)
        answer, told = connection.getresponse(), b""
        while answer.status == 200 and TOLD.encode() not in told:
            told += answer.read1()
        return answer.status, TOLD.encode() in told


def test_who_asks_this_machine_by_its_name_is_answered(port: int) -> None:
    for headers in ({}, {"Host": f"localhost:{port}"}, {"Origin": "http://localhost:9090"}):
        assert asked(port, headers) == (200, True)


def test_pages_of_other_sites_are_refused(port: int) -> None:
    for headers in (
        {"Host": f"example.org:{port}", "Origin": f"http://example.org:{port}"},
        {"Host": f"example.org:{port}"},
        {"Host": "127.0.0.1"},
        {"Origin": "http://example.org"},
        {"Origin": "null"},
        {"Origin": "https://app.rerun.io"},
    ):
        assert asked(port, headers) == (403, False), headers


def test_rerun_itself_listens_where_nobody_looks(port: int) -> None:
    """It would answer everybody."""
    places = [
        one.laddr for one in psutil.Process().net_connections("tcp")
        if one.status == psutil.CONN_LISTEN and one.laddr.ip != LOCALHOST
    ]  # fmt: skip
    assert places
    for place in places:
        assert place.ip.startswith("127.")
        assert asked(place.port, {"Host": "example.org"}, place.ip) == (200, True)


def test_a_gate_is_closed_with_visitors_in_it() -> None:
    with socket.create_server((LOCALHOST, 0)) as server:
        number = free_port(LOCALHOST)
        gate = Gate(number, server.getsockname())
        head = f"GET / HTTP/1.1\r\nHost: {LOCALHOST}:{number}\r\n\r\n".encode()
        with (
            socket.create_connection((LOCALHOST, number)) as silent,
            socket.create_connection((LOCALHOST, number)) as one,
        ):
            one.sendall(head)
            other, _ = server.accept()
            with other:
                assert other.recv(1000) == head
                other.sendall(b"answer")
                assert one.recv(1000) == b"answer"
                gate.close()
                one.settimeout(PATIENCE)
                assert one.recv(1000) == b""
                assert other.recv(1000) == b""
                silent.settimeout(PATIENCE)
                assert silent.recv(1000) == b""


def test_an_address_is_one_of_millions() -> None:
    """Of twenty, two are the same once in 86 000 times; each lies where only this machine can ask."""
    addresses = [ip_address(unguessable_address()) for _ in range(20)]
    assert len(set(addresses)) == 20
    assert all(address.is_loopback for address in addresses)
    assert len({address.packed[position] for address in addresses for position in (1, 2, 3)}) > 20
