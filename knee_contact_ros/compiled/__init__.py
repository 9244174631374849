"""The compiled kernel: the same source as the plain one, the same bits, some hundred times quicker.

Imported only where something is compiled; nothing else waits for the compiler.
"""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numba

from knee_contact_ros.compiled.by_address import bind
from knee_contact_ros.compiled.functions import compiled_function
from knee_contact_ros.compiled.source_meaning import digest
from knee_contact_ros.compiled.turns import in_turn
from knee_contact_ros.core import ticks
from knee_contact_ros.core.model import Kernel, KneeModel
from knee_contact_ros.core.scene import Scene

__all__ = ["compiled", "compiled_function", "compiled_kernel"]


def compiled(model: KneeModel) -> KneeModel:
    """A model that computes what the given one does, with the compiled kernel.

    Compiling happens when the first run or stream of a new kind of scene begins and takes half a minute or more; what
    this machine has compiled before is loaded in about a second.
    """
    return replace(model, kernel=compiled_kernel())


@functools.cache
def compiled_kernel() -> Kernel:
    """The compiled functions."""
    return Kernel(_run, bind)


def _run(scene: Scene, *arrays: Any) -> None:
    """See `ticks.run`."""
    with in_turn(lambda: digest(str(numba.typeof(scene)))):
        compiled_function(ticks.run)(scene, *arrays)
