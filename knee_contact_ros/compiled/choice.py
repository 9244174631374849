"""The choice between the compiled kernel and the plain one for a run: whichever is expected to be faster.

Both give the same bits. Nothing here imports the compiler before it is needed.
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
    """Processor time of a kind of scene, as measured (docs/decisions/0061-first-use.md)."""

    tick: float
    """Time [s] of a tick by the plain kernel"""
    compiling: float
    """Time [s] of compiling"""


COSTS = (Cost(0.3e-3, 15.0), Cost(2e-3, 18.0), Cost(5e-3, 20.0))
"""Costs by the number of measured surfaces on which the contact is searched for; a tick is up to some times cheaper on
smooth surfaces, and more expensive on noisy ones"""
SHIPPED = 1.0
"""Time [s] of making machine code of a kernel that comes with the package"""
LOADING = 0.1
"""Time [s] of loading what was compiled before"""


def cost_of(scene: Scene) -> Cost:
    """Give the cost of a kind of scene: between curves the contact is searched for, between circles it is not."""
    curves = (scene.pair.femur, scene.pair.tibia) if isinstance(scene.pair, CurveContact) else ()
    return COSTS[sum(not isinstance(curve, Circle | TibialCircle) for curve in curves)]


def worth_compiling(scene: Scene, ticks: int) -> bool:
    """Whether the compiled kernel computes so many ticks sooner, including the time to load or compile it."""
    cost = cost_of(scene)
    plain = ticks * cost.tick
    if plain < LOADING and _KERNEL not in sys.modules:
        return False
    if _is_kept(scene):
        return True
    return plain > SHIPPED if _is_shipped(scene) else plain > cost.compiling and compiler_works()


@functools.cache
def compiler_works() -> bool:
    """Whether Numba can be used; if not, warn once: scenes without a kept or shipped kernel run plainly."""
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
    """Give the same model, which chooses the kernel anew for every run.

    A stream, whose length is not known, takes the compiled kernel if that is kept or comes with the package.
    """
    return replace(model, kernel=CHOSEN)


def forced(model: KneeModel) -> KneeModel:
    """Give the same model with the compiled kernel, however long compiling takes, if there can be one.

    A line on stderr says when something is compiled.
    """
    return replace(model, kernel=_compiled(model.scene))


def _run(scene: Scene, memory: Memory, durations: Any, *columns: Any) -> None:
    kernel = _compiled(scene) if worth_compiling(scene, len(durations)) else PLAIN
    kernel.run(scene, memory, durations, *columns)


def _bind(scene: Scene, memory: Memory, answer: Rows) -> Callable[..., None]:
    kernel = _compiled(scene) if _is_kept(scene) or _is_shipped(scene) else PLAIN
    return kernel.bind(scene, memory, answer)


CHOSEN = Kernel(_run, _bind)
"""A kernel that chooses between the compiled and the plain one"""
_KERNEL = "knee_contact_ros.compiled.kernel"


def _is_kept(scene: Scene) -> bool:
    try:
        from knee_contact_ros.compiled.kernel import is_kept
    except Exception:  # without LLVM's library Numba does not work either, of which `compiler_works` warns
        return False
    return is_kept(scene)


def _is_shipped(scene: Scene) -> bool:
    try:
        from knee_contact_ros.compiled.kernel import is_shipped
    except Exception:  # as above
        return False
    return is_shipped(scene)


def _compiled(scene: Scene) -> Kernel:
    if not (_is_kept(scene) or _is_shipped(scene) or compiler_works()):
        return PLAIN
    from knee_contact_ros.compiled.kernel import compiled_kernel

    return compiled_kernel(announcement_for(scene))


def announcement_for(scene: Scene) -> Callable[[], AbstractContextManager[None]]:
    """Give a function that makes the context which tells a person that a kind of scene is being compiled."""
    return announcement(cost_of(scene))


@functools.cache
def announcement(cost: Cost) -> Callable[[], AbstractContextManager[None]]:
    """Give a function that makes the context which tells a person how long something is going to be compiled."""
    text = f"knee_contact_ros: compiling for this kind of knee, once (some {cost.compiling:.0f} s)"
    return functools.partial(busy, text)
