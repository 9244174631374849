"""Both nodes in one process, `knee_load` and `knee_contact`: the one hands its inputs and answers to the other.

A hop over a topic takes longer than estimate and contact together (decision 60). All topics are published as before.
"""

from __future__ import annotations

from functools import partial

from knee_contact_ros.node.contact_session import CONTACT_NODE, ContactSession
from knee_contact_ros.node.kind import NodeKind
from knee_contact_ros.node.load_session import LOAD_NODE, LoadSession
from knee_contact_ros.node.subscription import HandedInputs, HandOver


def load_and_contact() -> tuple[NodeKind, NodeKind]:
    """Both kinds of node, joined."""
    handed = HandedInputs(HandOver(), HandOver())
    return (
        LOAD_NODE._replace(session=partial(LoadSession, takers=handed)),
        CONTACT_NODE._replace(session=partial(ContactSession, handed=handed)),
    )
