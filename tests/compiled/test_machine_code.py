"""Kernels that LLVM loads by itself: what they call is known, and Numba is not imported."""

from __future__ import annotations

import subprocess
import sys

import pytest
from llvmlite import binding as llvm

from knee_contact_ros.compiled.machine_code import RUN, TICK, loaded
from knee_contact_ros.parameters.build import load_model

KERNEL = f"""
declare double @{{called}}(double)
define i32 @{RUN}(i64 %addresses, i64 %number, double %a, double %b, double %c, double %d) {{{{
  %found = call double @{{called}}(double %a)
  %whole = fptosi double %found to i32
  ret i32 %whole
}}}}
define void @{TICK}(i64 %addresses, double %a, double %b, double %c, double %d) {{{{
  ret void
}}}}
"""


def object_code(source: str) -> bytes:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(jit=True)
    code: bytes = machine.emit_object(llvm.parse_assembly(source))
    return code


def test_a_kernel_calls_functions_of_c() -> None:
    assert loaded(object_code(KERNEL.format(called="cbrt"))).run(0, 0, 27.0, 0.0, 0.0, 0.0) == 3


def test_a_kernel_that_calls_what_is_nowhere_is_refused() -> None:
    with pytest.raises(LookupError, match="calls nowhere_at_all"):
        loaded(object_code(KERNEL.format(called="nowhere_at_all")))


def test_code_without_a_kernel_is_refused() -> None:
    with pytest.raises(LookupError, match="no kernel"):
        loaded(object_code("define void @other() {\n  ret void\n}"))


USE = """
import sys
import knee_contact_ros
knee_contact_ros.load_model(compiled=True).stream().tick(0.0, 0.1, 700.0)
print("numba" in sys.modules)
"""


@pytest.mark.xdist_group("kernel for kelvin_voigt")
def test_a_kept_kernel_is_used_without_numba() -> None:
    load_model(compiled=True).stream()
    used = subprocess.run([sys.executable, "-c", USE], capture_output=True, text=True, check=True).stdout
    assert used == "False\n"
