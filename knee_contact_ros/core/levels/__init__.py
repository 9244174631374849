"""The levels of the model by the name that `fidelity.level` uses."""

from __future__ import annotations

from knee_contact_ros.core.levels.auto import Auto
from knee_contact_ros.core.levels.dynamic import Dynamic
from knee_contact_ros.core.levels.first_order import FirstOrder
from knee_contact_ros.core.levels.prescribed_height import PrescribedHeight
from knee_contact_ros.core.levels.quasi_static import QuasiStatic
from knee_contact_ros.core.scene import Level

LEVELS: dict[str, Level] = {
    "quasi_static": QuasiStatic(),
    "first_order": FirstOrder(),
    "dynamic": Dynamic(),
    "auto": Auto(),
}

__all__ = ["LEVELS", "Level", "PrescribedHeight"]
