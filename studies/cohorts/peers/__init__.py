"""What a user would take instead for many knees at once: one file per tool, each with a function `methods`."""

from __future__ import annotations

from importlib import import_module
from importlib.util import find_spec
from typing import NamedTuple

from benchmarks.report import installed_version
from studies.cohorts.method import Method


class Peer(NamedTuple):
    """A tool: its name here, the module it is imported as, its name on PyPI, and the module that drives it."""

    name: str
    module: str
    distribution: str
    driver: str
    how: str
    """How the study uses it, for the page"""

    @property
    def installed(self) -> bool:
        """Whether it can be imported."""
        return find_spec(self.module) is not None

    @property
    def version(self) -> str:
        """Version of the tool, or a word for its absence."""
        return installed_version(self.distribution) or ("as it is here" if self.installed else "not installed")

    def methods(self) -> list[Method]:
        """List the methods of the tool."""
        return import_module(self.driver).methods()  # type: ignore[no-any-return]


OURS = Peer(
    "knee-contact", "knee_contact_ros", "knee_contact_ros", "studies.cohorts.ours",
    "The batch kernel of `sweep`, models built beforehand; gives contact point, force, error estimate "
    "and the rest besides the depth. \"As promised\" is the tolerance that a user asks for who has no reference",
)  # fmt: skip
PEERS = (
    Peer("SciPy, a loop", "scipy", "scipy", f"{__name__}.scipy_loop",
         "one call per knee; right-hand side in plain Python, or compiled by Numba"),
    Peer("SciPy, one system", "scipy", "scipy", f"{__name__}.scipy_system",
         "all knees as one system of equations: the right-hand side in NumPy, or a loop compiled by Numba"),
    Peer("CyRK", "CyRK", "CyRK", f"{__name__}.cyrk",
         "`nbsolve2_ivp` (C++) or `nbsolve_ivp` (Numba) for every knee in a compiled loop, `prange`"),
    Peer("numbalsoda", "numbalsoda", "numbalsoda", f"{__name__}.lsoda_and_dop853",
         "`lsoda`, `dop853` or `solve_ivp` for every knee in a compiled loop, `prange`"),
    Peer("diffrax", "diffrax", "diffrax", f"{__name__}.diffrax_vmap",
         "`diffeqsolve` under `vmap` and `jit`, 64 bits, on the threads that XLA takes; two cores are two processes"),
)  # fmt: skip
