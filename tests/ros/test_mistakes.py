"""Mistakes of newcomers that a live node sees: each is told in /diagnostics, with the likely cause.

The other commands are in tests/hostile/test_mistakes.py.
"""

from __future__ import annotations

import re

import numpy as np
from lifecycle_msgs.msg import Transition

from tests.hostile.test_mistakes import WAYS, by_bag
from tests.model.test_inputs import Columns, gait
from tests.ros.conftest import Peer, Start, change_state

PACE = re.compile("deadline|behind|wait for the other topic|silent for|no answer")
"""What a busy machine may add, or a walk that is over"""


def walk(peer: Peer, time: np.ndarray, angle: np.ndarray, load: np.ndarray) -> None:
    """Send a walk to a node that begins anew, when each side has heard that the other one is there again."""
    assert change_state(peer, Transition.TRANSITION_DEACTIVATE)
    peer.wait_until(lambda: not peer.angle.get_subscription_count() and not peer.force.get_subscription_count())
    for transition in (
        Transition.TRANSITION_CLEANUP, Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE,
    ):  # fmt: skip
        assert change_state(peer, transition)
    peer.wait_for_node()
    peer.told.clear()
    peer.contacts.clear()
    for stamp, flexion, axial in zip(np.rint(1e9 * time).astype(np.int64).tolist(), angle, load, strict=True):
        peer.send(stamp, float(flexion), float(axial))
        peer.executor.spin_once(timeout_sec=0.0)


def test_each_mistake_is_told_live(peer: Peer, start_node: Start) -> None:
    start_node("-p", "pairing.wait:=5.0")
    peer.wait_for_node()
    right: Columns = gait()
    walk(peer, *right)
    peer.wait_until(lambda: peer.diagnostics.get("knee_contact: ticks", {}).get("ticks") == str(len(right[0])))
    assert {words for each in peer.told for words in each.split("; ") if not PACE.search(words)} == {"ok"}
    for change, words in list(WAYS[by_bag].values())[::4]:  # a few of each kind
        walk(peer, *change(*right))
        peer.wait_until(lambda words=words: re.search(words, "; ".join(peer.told)))
