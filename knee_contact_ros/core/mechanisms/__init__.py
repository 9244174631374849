"""Knee mechanisms by the names that the parameter `translation.mechanism` uses."""

from __future__ import annotations

from collections.abc import Callable

from knee_contact_ros.core.mechanisms.base import Mechanism
from knee_contact_ros.core.mechanisms.hinge import Hinge
from knee_contact_ros.core.mechanisms.parallel_mechanism import ParallelMechanism
from knee_contact_ros.core.mechanisms.table import Table


def parallel_mechanism() -> Table:
    """Return the translation of the parallel mechanism with its published geometry."""
    return ParallelMechanism().table


MECHANISMS: dict[str, Callable[..., Mechanism]] = {
    "hinge": Hinge,
    "ball_and_socket": Hinge,  # in the plane both are a fixed axis
    "parallel_mechanism": parallel_mechanism,
    "table": Table,
}

__all__ = ["MECHANISMS", "Hinge", "Mechanism", "ParallelMechanism", "Table"]
