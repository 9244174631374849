"""Where Numba cannot be used, the node computes plainly, and says so once."""

from __future__ import annotations

from collections.abc import Callable

from tests.ros.conftest import NodeProcess, Peer
from tests.ros.series import send_all


def test_a_node_without_numba_answers_uncompiled(peer: Peer, start_node: Callable[..., NodeProcess]) -> None:
    node = start_node(without="numba")
    peer.wait_for_node()
    send_all(peer)
    code, said = node.stop()
    assert code == 0, said
    assert said.count("Numba cannot be used") == 1
    assert "40 ticks, 0 samples refused" in said
