"""The compiled functions in place of the plain ones. To import this takes half a second."""

from __future__ import annotations

import functools
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numba
import numpy as np

from knee_contact_ros.compiled.by_address import bind
from knee_contact_ros.compiled.cache import kernel_folder
from knee_contact_ros.compiled.functions import compiled_function
from knee_contact_ros.compiled.source_meaning import digest
from knee_contact_ros.compiled.turns import Told, in_turn
from knee_contact_ros.core import ticks
from knee_contact_ros.core.model import Kernel, KneeModel
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.core.types import blank

__all__ = ["compiled", "compiled_function", "compiled_kernel", "is_kept", "kernel_folder"]


def compiled(model: KneeModel, told: Told = nullcontext) -> KneeModel:
    """A model that computes what the given one does, with the compiled kernel.

    Compiling happens when the first run or stream of a new kind of scene begins and takes half a minute or a minute;
    what this machine has compiled before is loaded in a second or two. `told` makes the context in which is compiled.
    """
    return replace(model, kernel=compiled_kernel(told))


@functools.cache
def compiled_kernel(told: Told = nullcontext) -> Kernel:
    """The compiled functions."""
    return Kernel(functools.partial(_run, told), functools.partial(bind, told=told))


def is_kept(scene: Scene, *, only_on_disk: bool = False) -> bool:
    """Whether the kernel for a kind of scene has been compiled: in this process, or on this machine and kept."""
    function: Any = compiled_function(ticks.run)
    numbers = [np.zeros(1) for _ in range(4)]
    kinds = tuple(map(function.typeof_pyval, (scene, np.zeros(1, ticks.MEMORY), *numbers, blank(1))))
    kept = kinds in function.overloads and not only_on_disk
    return kept or function._cache.holds(kinds, function.targetctx)


def _run(told: Told, scene: Scene, *arrays: Any) -> None:
    """See `ticks.run`."""
    with in_turn(lambda: digest(str(numba.typeof(scene))), told):
        compiled_function(ticks.run)(scene, *arrays)
