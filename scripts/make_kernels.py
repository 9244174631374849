"""Make the kernels that come with the package again, after a change of the model; two minutes.

`python -m scripts.make_kernels`
"""

from __future__ import annotations

import os
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from llvmlite import binding as llvm

from knee_contact_ros.compiled.layout import kind_of
from knee_contact_ros.compiled.machine_code import TYPES
from knee_contact_ros.compiled.shipped import FOLDER, SUFFIX, file_of, packed
from knee_contact_ros.core.contact_laws import CONTACT_LAWS
from knee_contact_ros.core.scene import Scene
from knee_contact_ros.parameters.build import load_model
from knee_contact_ros.system.resources import shipped_parameter_files

ANY_PROCESSOR = {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": ""}


SOURCES = [
    *shipped_parameter_files(),
    *({"contact.law": law} for law in CONTACT_LAWS),
    *(["mri_femur", {"contact.law": law}] for law in CONTACT_LAWS),
]
"""Parameters of knees whose kinds a kernel is shipped for"""


def scenes() -> dict[Path, Scene]:
    """Give a scene of every kind that a kernel is shipped for, by its file."""
    found = [load_model(source, compiled=False).scene for source in SOURCES]
    return {path: scene for scene in found if (path := file_of(kind_of(scene)))}


def main() -> None:
    """Write the files that are missing, and remove those of other models."""
    FOLDER.mkdir(exist_ok=True)
    os.environ |= ANY_PROCESSOR  # before Numba is imported
    wanted = scenes()
    missing = {path: scene for path, scene in wanted.items() if not path.exists()}
    with ProcessPoolExecutor() as processes:
        for path, code in zip(missing, processes.map(short_code, missing.values()), strict=True):
            content = packed(path, code)
            path.write_bytes(content)
            print(path.name, f"{len(content) / 1000:.0f} kB")
    for path in set(FOLDER.glob(f"*{SUFFIX}")) - set(wanted):
        path.unlink()


def short_code(scene: Scene) -> bytes:
    """Compile the kernel for a kind of scene, and give LLVM's code with short names."""
    from knee_contact_ros.compiled.compile_kernel import bitcode_of

    return without_names(bitcode_of(scene))


def without_names(code: bytes) -> bytes:
    """Give the same code with short names, which take most of the space otherwise."""
    module = llvm.parse_bitcode(code)
    for number, function in enumerate(module.functions):
        if function.is_declaration:
            continue
        if function.name not in TYPES:
            function.name = f"f{number}"
        for argument in function.arguments:
            argument.name = ""
        for block in function.blocks:
            block.name = ""
            for instruction in block.instructions:
                if str(instruction.type) != "void":
                    instruction.name = ""
    for number, variable in enumerate(module.global_variables):
        if not variable.is_declaration:
            variable.name = f"g{number}"
    module.verify()
    shorter: bytes = module.as_bitcode()
    return shorter


if __name__ == "__main__":
    sys.exit(main())
