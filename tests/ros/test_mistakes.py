"""Mistakes of newcomers that a live node sees: each is told in /diagnostics, with the likely cause.

The other commands are in tests/hostile/test_mistakes.py.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
from lifecycle_msgs.msg import Transition

from tests.hostile.test_mistakes import WAYS, by_bag
from tests.model.test_inputs import Columns, gait
from tests.ros.conftest import NodeProcess, Peer, change_state

ANEW = (
    Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP, Transition.TRANSITION_CONFIGURE,
    Transition.TRANSITION_ACTIVATE,
)  # fmt: skip


def walk(peer: Peer, time: np.ndarray, angle: np.ndarray, load: np.ndarray) -> None:
    """Send a walk to a node that begins anew."""
    assert all(change_state(peer, transition) for transition in ANEW)
    peer.spin(0.3)
    peer.wait_for_node()  # which hears nothing before it is known that it listens again
    peer.problems.clear()
    peer.contacts.clear()
    for stamp, flexion, axial in zip(np.rint(1e9 * time).astype(np.int64).tolist(), angle, load, strict=True):
        peer.send(stamp, float(flexion), float(axial))
        peer.executor.spin_once(timeout_sec=0.0)


def test_each_mistake_is_told_live(peer: Peer, start_node: Callable[..., NodeProcess]) -> None:
    start_node()
    peer.wait_for_node()
    right: Columns = gait()
    walk(peer, *right)
    peer.wait_until(lambda: len(peer.contacts) == len(right[0]))
    peer.spin(1.5)
    silent = {"knee_contact: answers", "knee_contact: joint_states", "knee_contact: joint_reaction_force"}
    told = {words for part, words in peer.problems.items() if part not in silent}
    assert {words for words in told if "the node is behind" not in words} == {"ok"}  # as it is on a busy machine
    for change, words in list(WAYS[by_bag].values())[::4]:  # a few of each kind
        walk(peer, *change(*right))
        peer.wait_until(lambda words=words: re.search(words, "; ".join(peer.problems.values())))
