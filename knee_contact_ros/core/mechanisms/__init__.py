"""The knee mechanisms by the name that the parameter uses."""

from __future__ import annotations

from collections.abc import Callable

from knee_contact_ros.core.mechanisms.base import Mechanism
from knee_contact_ros.core.mechanisms.hinge import Hinge
from knee_contact_ros.core.mechanisms.parallel_mechanism import ParallelMechanism
from knee_contact_ros.core.mechanisms.table import Table


def parallel_mechanism() -> Table:
    """The translation of the parallel mechanism with the published geometry."""
    return ParallelMechanism().table


MECHANISMS: dict[str, Callable[..., Mechanism]] = {
    "hinge": Hinge,
    "ball_and_socket": Hinge,  # in the plane both are a fixed axis
    "parallel_mechanism": parallel_mechanism,
    "table": Table,
}

__all__ = ["MECHANISMS", "Hinge", "Mechanism", "ParallelMechanism", "Table"]
