"""Whether a run is computed by the compiled kernel or the plain one: whichever is expected to answer sooner.

Both give the same bits. Nothing here imports the compiler before it is wanted.
"""

from __future__ import annotations

import functools
import logging
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from importlib import import_module
from typing import Any, NamedTuple

from knee_contact_ros.core.contact_pairs import CurveContact
from knee_contact_ros.core.contact_pairs.tibial_circle import TibialCircle
from knee_contact_ros.core.geometries import Circle
from knee_contact_ros.core.model import PLAIN, Kernel, KneeModel
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.core.ticks import Memory
from knee_contact_ros.core.types import Rows
from knee_contact_ros.system.terminal import busy

_log = logging.getLogger(__name__)


class Cost(NamedTuple):
    """Processor time, measured (docs/decisions/0061-first-use.md)."""

    tick: float
    """[s] of a tick by the plain kernel"""
    compiling: float
    """[s] of compiling"""


COSTS = (Cost(0.3e-3, 15.0), Cost(2e-3, 18.0), Cost(5e-3, 20.0))
"""By how many measured surfaces the contact is searched for on; a tick is some times cheaper on smooth ones, dearer on
noisy ones"""
LOADING = 0.1
"""[s] of loading what was compiled before"""


def cost_of(scene: Scene) -> Cost:
    """What the kind of scene costs: between curves, the contact is searched for, and found at once between circles."""
    curves = (scene.pair.femur, scene.pair.tibia) if isinstance(scene.pair, CurveContact) else ()
    return COSTS[sum(not isinstance(curve, Circle | TibialCircle) for curve in curves)]


def worth_compiling(scene: Scene, ticks: int) -> bool:
    """Whether so many ticks are answered sooner by the compiled kernel, with what it takes to have it."""
    cost = cost_of(scene)
    plain = ticks * cost.tick
    if plain < LOADING and _KERNEL not in sys.modules:
        return False
    return _is_kept(scene) or (plain > cost.compiling and compiler_works())


@functools.cache
def compiler_works() -> bool:
    """Whether Numba can be used; if not, that is told once, and what is not kept is computed by the plain kernel."""
    try:
        import_module("numba")
    except Exception as error:  # what it finds wrong with Python, NumPy or its own libraries has many names
        _log.warning(
            "knee_contact_ros: Numba cannot be used (%s: %s); nothing is compiled, which gives the same answers, some "
            "hundred times slower", type(error).__name__, " ".join(str(error).split()),
        )  # fmt: skip
        return False
    return True


def chosen(model: KneeModel) -> KneeModel:
    """The same model with the kernel chosen anew for every run.

    A stream, which does not know its length, takes the compiled kernel if it need not be compiled.
    """
    return replace(model, kernel=CHOSEN)


def forced(model: KneeModel) -> KneeModel:
    """The same model with the compiled kernel, whatever that takes, if there can be one; that is told on stderr."""
    return replace(model, kernel=_compiled(model.scene))


def _run(scene: Scene, memory: Memory, durations: Any, *columns: Any) -> None:
    kernel = _compiled(scene) if worth_compiling(scene, len(durations)) else PLAIN
    kernel.run(scene, memory, durations, *columns)


def _bind(scene: Scene, memory: Memory, answer: Rows) -> Callable[..., None]:
    kernel = _compiled(scene) if _is_kept(scene) else PLAIN
    return kernel.bind(scene, memory, answer)


CHOSEN = Kernel(_run, _bind)
"""Picks one of the two"""
_KERNEL = "knee_contact_ros.compiled.kernel"


def _is_kept(scene: Scene) -> bool:
    try:
        from knee_contact_ros.compiled.kernel import is_kept
    except Exception:  # LLVM's library is as Numba is, and that is told once something shall be compiled
        return False
    return is_kept(scene)


def _compiled(scene: Scene) -> Kernel:
    if not (_is_kept(scene) or compiler_works()):
        return PLAIN
    from knee_contact_ros.compiled.kernel import compiled_kernel

    return compiled_kernel(telling_of(scene))


def telling_of(scene: Scene) -> Callable[[], AbstractContextManager[None]]:
    """What tells a person that a kind of scene is compiled, as long as it is."""
    return telling(cost_of(scene))


@functools.cache
def telling(cost: Cost) -> Callable[[], AbstractContextManager[None]]:
    """What tells a person that something is compiled, as long as it is."""
    return functools.partial(_told, cost)


def _told(cost: Cost) -> AbstractContextManager[None]:
    return busy(f"knee_contact_ros: compiling for this kind of knee, once (some {cost.compiling:.0f} s)")
