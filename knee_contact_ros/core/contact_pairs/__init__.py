"""Contact pairs by the names of the tibial surface that the parameter `tibia.geometry` uses."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from knee_contact_ros.core.contact_pairs.base import Closest, ContactPair
from knee_contact_ros.core.contact_pairs.on_curve import CurveContact
from knee_contact_ros.core.contact_pairs.on_plane import OnPlane
from knee_contact_ros.core.contact_pairs.tibial_circle import TibialCircle
from knee_contact_ros.core.contact_pairs.tibial_profile import TibialProfile
from knee_contact_ros.core.geometries import Circle, Profile


def in_circle(femur: Circle | Profile, radius: float) -> CurveContact:
    """Return the contact of a femur with a concave circle of `radius` [m]."""
    return CurveContact(femur, TibialCircle(radius))


def on_profile(femur: Circle | Profile, x: NDArray[np.float64], y: NDArray[np.float64]) -> CurveContact:
    """Return the contact of a femur with a measured plateau through `x`, `y` [m].

    Raises:
        ValueError: see `TibialProfile`.
    """
    return CurveContact(femur, TibialProfile(x, y))


TIBIAL_GEOMETRIES: dict[str, Callable[..., ContactPair]] = {
    "plane": OnPlane,
    "circle": in_circle,
    "profile": on_profile,
}

__all__ = ["TIBIAL_GEOMETRIES", "Closest", "ContactPair", "CurveContact", "OnPlane"]
