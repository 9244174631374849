"""Live tibiofemoral contact from streamed gait: `load_model` gives the model without ROS."""

from __future__ import annotations

from pkgutil import extend_path
from typing import TYPE_CHECKING, Any

# The generated message modules lie in another folder when this package runs from its source tree.
__path__ = extend_path(__path__, __name__)
__version__ = "0.2.0"
__all__ = ["UsageError", "load_model"]

if TYPE_CHECKING:
    from knee_contact_ros.parameters.build import load_model
    from knee_contact_ros.system.errors import UsageError


def __getattr__(name: str) -> Any:
    """Import on first use, so that importing the messages alone costs nothing more."""
    if name == "load_model":
        from knee_contact_ros.parameters.build import load_model

        return load_model
    if name == "UsageError":
        from knee_contact_ros.system.errors import UsageError

        return UsageError
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
