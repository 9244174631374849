"""Digests of what modules do, regardless of comments: kernels are kept under them, and survive edits of comments."""

from __future__ import annotations

import ast
import hashlib
from typing import Any


def source_meaning(source: bytes) -> str:
    """Give a digest of what a module does; comments, docstrings and line numbers do not count."""
    try:
        return digest(_as_tuples(_WithoutTexts().visit(ast.parse(source))))
    except (SyntaxError, ValueError, RecursionError):  # of no module that could be imported
        return digest(source)


def _as_tuples(part: Any) -> Any:
    """Give a syntax tree as tuples without empty fields, of which later versions of Python have more."""
    if isinstance(part, ast.AST):
        fields = [(name, _as_tuples(value)) for name, value in ast.iter_fields(part) if value not in (None, [])]
        return type(part).__name__, *fields
    return [_as_tuples(inner) for inner in part] if isinstance(part, list) else part


class _WithoutTexts(ast.NodeTransformer):
    """Removes constants that are statements: docstrings, and descriptions of what is defined before them."""

    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        return None if isinstance(node.value, ast.Constant) else node


def digest(of: Any) -> str:
    """Give sixteen hexadecimal digits for anything that is fully described by its `repr`."""
    return hashlib.sha256(repr(of).encode()).hexdigest()[:16]
