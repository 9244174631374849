"""What a user would take instead of this package: one module per tool, each with a function `solvers`."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import NamedTuple

from knee_contact_ros.tools.work_precision.solver import Solver


class Peer(NamedTuple):
    """A tool: its name, the module it is imported as, its name on PyPI, and the modules here that drive it."""

    name: str
    module: str
    distribution: str
    drivers: tuple[str, ...]
    extra: str = "trade"
    """Extra of this package that installs it"""

    @property
    def installed(self) -> bool:
        """Whether it can be imported."""
        return find_spec(self.module) is not None

    def entries(self) -> list[Entry]:
        """List all solvers of the tool, without importing it."""
        return [entry for driver in self.drivers for entry in entries(f"{__name__}.{driver}")]


class Entry(NamedTuple):
    """A solver, and the module in which another process finds it."""

    driver: str
    solver: Solver


def entries(driver: str) -> list[Entry]:
    """List the solvers of a module."""
    return [Entry(driver, solver) for solver in import_module(driver).solvers()]


COMPILED = ("CyRK", "numbalsoda", "diffrax")
"""Peers whose right-hand side is compiled, and called by what is compiled"""
PEERS = (
    Peer("SciPy", "scipy", "scipy", ("scipy_ivp", "scipy_odeint", "scipy_events")),
    Peer("CVODE", "sksundae", "scikit-sundae", ("cvode",)),
    Peer("MuJoCo", "mujoco", "mujoco", ("mujoco_passive",)),
    Peer("Exudyn", "exudyn", "exudyn", ("exudyn_symbolic",)),
    Peer("Drake", "pydrake", "drake", ("drake_symbolic",)),
    Peer("OpenSim", "opensim", "opensim", ("opensim_expression",)),
    Peer("CyRK", "CyRK", "CyRK", ("cyrk_compiled",), "peers"),
    Peer("numbalsoda", "numbalsoda", "numbalsoda", ("numbalsoda_compiled", "numbalsoda_events"), "peers"),
    Peer("diffrax", "diffrax", "diffrax", ("diffrax_jit",), "peers"),
)
