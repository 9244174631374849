"""Kernels that come with the package: the usual kinds of knee need no compiler.

A file holds LLVM's code, optimised, for a kind of scene and one version of the model. Machine code for the processor at
hand is made of it in a second. If the model has been changed, the file is not found and the kind is compiled; `python
-m scripts.make_kernels` makes the files again. A file begins with a line with its name: a kernel for another kind would
read a scene wrongly.
"""

from __future__ import annotations

import platform
from pathlib import Path
from typing import Any

from knee_contact_ros.compiled.keeping import model_meaning, name_of
from knee_contact_ros.compiled.kernel_folder import DoubtError
from knee_contact_ros.compiled.layout import named_tuples, words_of

FOLDER = Path(__file__).with_name("kernels")
SUFFIX = ".bc.xz"
MACHINE = "x86_64"


def name_of_kind(kind: Any) -> str | None:
    """Give the beginning of the names of files for a kind of scene; None if another process could not find it again."""
    return name_of("knee", named_tuples(kind), words_of(kind))


def file_of(kind: Any) -> Path | None:
    """Give the file for a kind of scene and this model, whether it exists or not; see `name_of_kind` for None."""
    name = name_of_kind(kind)
    return None if name is None else FOLDER / f"{name}{model_meaning()}{SUFFIX}"


def is_there(kind: Any) -> bool:
    """Whether a usable kernel for a kind of scene comes with the package."""
    try:
        return bitcode(kind) is not None
    except DoubtError:  # `bitcode` tells whoever wants to use it
        return False


def bitcode(kind: Any) -> bytes | None:
    """Give LLVM's code of the kernel for a kind of scene; None if it does not come with the package for this machine.

    Raises:
        DoubtError: the file cannot be read, is damaged, or has been made for another kind.
    """
    path = _existing_file(kind)
    if path is None:
        return None
    try:
        import lzma
    except ImportError:  # Python may have been built without it
        raise DoubtError(path, "cannot be read: this Python has no lzma") from None
    try:
        name, _, code = lzma.decompress(path.read_bytes()).partition(b"\n")
    except (OSError, EOFError, lzma.LZMAError) as error:
        raise DoubtError(path, f"cannot be read: {error}") from None
    if name != path.name.encode():
        raise DoubtError(path, "is of another kind of knee")
    return code


def _existing_file(kind: Any) -> Path | None:
    """Give the file for a kind of scene; None if there is none for this kind of machine."""
    if platform.machine() != MACHINE:
        return None
    try:
        path = file_of(kind)
    except OSError:  # sources that cannot be read
        return None
    return path if path and path.is_file() else None


def packed(path: Path, code: bytes) -> bytes:
    """Give the content of a file with LLVM's code of a kernel."""
    import lzma

    return lzma.compress(path.name.encode() + b"\n" + code, preset=9 | lzma.PRESET_EXTREME)
