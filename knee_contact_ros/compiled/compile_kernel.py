"""Compile the kernel of a kind of scene to LLVM's code, by Numba."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
from llvmlite import binding as llvm
from numba import carray, types
from numba.core.compiler import Flags, compile_extra
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target

from knee_contact_ros.compiled.functions import MAKING, register
from knee_contact_ros.compiled.inner import InnerCompiler
from knee_contact_ros.compiled.machine_code import RUN, TICK
from knee_contact_ros.compiled.scene_memory import scene_at
from knee_contact_ros.core import ticks
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.core.ticks import MEMORY
from knee_contact_ros.core.types import ROW

ARGUMENTS = types.CPointer(types.voidptr), types.int64, *[types.float64] * 4
ONE_TICK = -1
"""Given instead of a number of ticks: compute one tick, whose sample is among the arguments"""
CALLED_BY_C = """
define i32 @{run}(ptr %addresses, i64 %number, double %duration, double %angle, double %load, double %height) {{
  %answer = alloca ptr
  %raised = alloca ptr
  %status = call i32 @"{inner}"(ptr %answer, ptr %raised, ptr %addresses, i64 %number, double %duration, double %angle,
                                double %load, double %height)
  ret i32 %status
}}
define void @{tick}(ptr %addresses, double %duration, double %angle, double %load, double %height) {{
  call i32 @{run}(ptr %addresses, i64 {one}, double %duration, double %angle, double %load, double %height)
  ret void
}}
declare i32 @"{inner}"(ptr, ptr, ptr, i64, double, double, double, double)
"""
"""LLVM code of the functions that are called by C, around Numba's function, whose first two arguments are places for
the result and for an exception; the only exception possible is that memory runs out"""


@global_compiler_lock
def bitcode_of(scene: Scene) -> bytes:
    """Compile the kernel for a kind of scene; give LLVM's optimised code of the functions of `machine_code.Native`."""
    register()
    kind = numba.typeof(scene)
    read_scene, run = scene_at(kind), ticks.run

    def call(addresses: Any, number: int, duration: float, angle: float, load: float, height: float) -> None:
        count = max(number, 1) if number != 0 else 0
        durations, angles = carray(addresses[2], count, np.float64), carray(addresses[3], count, np.float64)
        loads, heights = carray(addresses[4], count, np.float64), carray(addresses[5], count, np.float64)
        if number < 0:
            durations[0], angles[0], loads[0], heights[0] = duration, angle, load, height
        memory, answers = carray(addresses[1], 1, MEMORY), carray(addresses[6], count, ROW)
        run(read_scene(addresses[0]), memory, durations, angles, loads, heights, answers)

    flags, context = Flags(), cpu_target.target_context
    options = {name: value for name, value in MAKING.items() if name != "pipeline_class"} | {"no_cpython_wrapper": True}
    cpu_target.options.parse_as_flags(flags, options)
    cpu_target.typing_context.refresh()
    context.refresh()
    made = compile_extra(
        cpu_target.typing_context, context, call, ARGUMENTS, types.void, flags, {}, None, InnerCompiler
    )
    library = context.codegen().create_library(RUN)
    whole = library._final_module
    called_by_c = CALLED_BY_C.format(run=RUN, tick=TICK, one=ONE_TICK, inner=made.fndesc.mangled_name)
    whole.link_in(llvm.parse_assembly(called_by_c))
    whole.link_in(made.library._get_module_for_linking())
    for part in (*whole.functions, *whole.global_variables):  # LLVM removes what has no callers left, and inlines more
        if not part.is_declaration and part.name not in (RUN, TICK):
            part.linkage = "internal"
    library._optimize_final_module()
    optimised: bytes = library._final_module.as_bitcode()
    return optimised
