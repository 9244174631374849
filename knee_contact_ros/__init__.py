"""Live tibiofemoral contact from streamed gait.

`load_model` returns a model, `solve` the answers to a recorded gait, `estimate_load` a load from sensors, `uncertainty`
standard deviations of the answers, `sweep` the outcomes of many knees, `sensitivity` which parameters matter, `paired`
differences between conditions, and `calibrate` parameters fitted to measurements. None of them needs ROS;
docs/how-to/python.md shows them.
"""

from importlib import import_module
from pkgutil import extend_path
from typing import Any

# The generated message modules lie in another folder when this package runs from its source tree.
__path__ = extend_path(__path__, __name__)
__version__ = "1.0.0"
__all__ = [
    "Gait",
    "Results",
    "UsageError",
    "calibrate",
    "estimate_load",
    "load_model",
    "paired",
    "sensitivity",
    "solve",
    "sweep",
    "uncertainty",
]

# `__init__.pyi` says the same to type checkers.
_PLACES = {
    "Gait": "offline.gait",
    "Results": "results",
    "UsageError": "system.errors",
    "calibrate": "lab.calibrate",
    "estimate_load": "offline.notebooks",
    "load_model": "offline.load_model",
    "paired": "lab.paired",
    "sensitivity": "lab.sensitivity",
    "solve": "offline.notebooks",
    "sweep": "lab.sweep",
    "uncertainty": "lab.uncertainty",
}


def __getattr__(name: str) -> Any:
    """Import on first use, so that importing the messages alone costs nothing more."""
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"{__name__}.{_PLACES[name]}"), name)
    return value


def __dir__() -> list[str]:
    """The public names."""
    return [*__all__, "__version__"]
