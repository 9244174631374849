"""What a module does, as a digest: kernels are kept under that, so that a comment compiles nothing anew."""

from __future__ import annotations

import hashlib
from types import CodeType
from typing import Any


def source_meaning(source: bytes) -> str:
    """A digest of what a module does; its comments, docstrings and the places of its lines do not count."""
    try:
        return digest(_meaning(compile(source, "", "exec", optimize=2, dont_inherit=True)))
    except (SyntaxError, ValueError):  # of no module that could be imported
        return digest(source)


def _meaning(code: CodeType) -> tuple[Any, ...]:
    """All of a piece of bytecode but the lines it comes from."""
    constants = [_meaning(one) if isinstance(one, CodeType) else _constant(one) for one in code.co_consts]
    counts = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
    names = code.co_name, code.co_names, code.co_varnames, code.co_freevars, code.co_cellvars
    handlers = getattr(code, "co_exceptiontable", b"")  # Python 3.10 has them in the code
    return code.co_code, handlers, counts, names, constants


def _constant(value: object) -> str:
    """In words that are the same in every process, as those of a set are not."""
    return repr(sorted(map(repr, value)) if isinstance(value, frozenset) else value)


def digest(of: Any) -> str:
    """Sixteen digits for anything whose `repr` says all of it."""
    return hashlib.sha256(repr(of).encode()).hexdigest()[:16]
