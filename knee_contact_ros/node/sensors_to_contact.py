"""Both nodes, `knee_load` and `knee_contact`, in one process: the first hands its angles and answers to the second.

A message over a topic takes longer than estimate and contact together (decision 60). All topics are published as usual.
"""

from __future__ import annotations

from functools import partial

from knee_contact_ros.node.contact_session import CONTACT_NODE, ContactSession
from knee_contact_ros.node.kind import NodeKind
from knee_contact_ros.node.load_session import LOAD_NODE, LoadSession
from knee_contact_ros.node.subscription import HandedInputs, HandOver


def load_and_contact() -> tuple[NodeKind, NodeKind]:
    """Kinds of both nodes, `knee_load` first, connected within the process."""
    handed = HandedInputs(HandOver(), HandOver())
    return (
        LOAD_NODE._replace(session=partial(LoadSession, takers=handed)),
        CONTACT_NODE._replace(session=partial(ContactSession, handed=handed)),
    )
