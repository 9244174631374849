"""What a module does, as a digest: kernels are kept under that, so that a comment compiles nothing anew."""

from __future__ import annotations

import ast
import hashlib
from typing import Any


def source_meaning(source: bytes) -> str:
    """A digest of what a module does; its comments, docstrings and the places of its lines do not count."""
    try:
        return digest(ast.dump(_WithoutTexts().visit(ast.parse(source))))
    except (SyntaxError, ValueError, RecursionError):  # of no module that could be imported
        return digest(source)


class _WithoutTexts(ast.NodeTransformer):
    """Leaves out constants that stand alone: docstrings, and words about what stands before."""

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        return None if isinstance(node.value, ast.Constant) else node


def digest(of: Any) -> str:
    """Sixteen digits for anything whose `repr` says all of it."""
    return hashlib.sha256(repr(of).encode()).hexdigest()[:16]
