"""Femoral geometries by the names that the parameter `femur.geometry` uses."""

from __future__ import annotations

from knee_contact_ros.core.geometries.base import FemoralGeometry
from knee_contact_ros.core.geometries.circle import Circle
from knee_contact_ros.core.geometries.profile import Profile

GEOMETRIES: dict[str, type[Circle] | type[Profile]] = {"circle": Circle, "profile": Profile}

__all__ = ["GEOMETRIES", "Circle", "FemoralGeometry", "Profile"]
