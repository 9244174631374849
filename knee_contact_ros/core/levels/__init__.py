"""Levels of the model by the names that the parameter `fidelity.level` uses."""

from __future__ import annotations

from knee_contact_ros.core.scene import AUTO, DYNAMIC, FIRST_ORDER, QUASI_STATIC

LEVELS = {"quasi_static": QUASI_STATIC, "first_order": FIRST_ORDER, "dynamic": DYNAMIC, "auto": AUTO}

__all__ = ["LEVELS"]
