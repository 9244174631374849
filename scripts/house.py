"""How large the package is and how it hangs together, by `python scripts/house.py`."""

from __future__ import annotations

import ast
import io
import tokenize
from pathlib import Path

import grimp
from tabulate import tabulate

ROOT = Path(__file__).parents[1]
PACKAGE = "knee_contact_ros"
NO_CODE = {
    tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING,
    tokenize.ENDMARKER,
}  # fmt: skip


def code_lines(source: str) -> int:
    """Lines of a module that hold more than a comment or a docstring, an attribute's included."""
    words: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            words.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in NO_CODE:
            code.update(range(token.start[0], token.end[0] + 1))
    return len(code - words)


def lines_in(folder: Path) -> tuple[int, int, int]:
    """Modules, all lines, and lines of code."""
    sources = [path.read_text(encoding="utf-8") for path in folder.rglob("*.py")]
    return len(sources), sum(len(source.splitlines()) for source in sources), sum(map(code_lines, sources))


def room(module: str) -> str:
    """The part of the package in which a module lies; empty for the root."""
    parts = module.split(".")
    return parts[1] if len(parts) > 2 or (ROOT / PACKAGE / parts[-1]).is_dir() else ""


def figures() -> dict[str, int]:
    """Figures of the package by their names."""
    modules, lines, code = lines_in(ROOT / PACKAGE)
    tests, _, test_code = lines_in(ROOT / "tests")
    graph = grimp.build_graph(PACKAGE, cache_dir=None)
    inner = [module for module in graph.modules if module != PACKAGE]
    importers = {module: graph.find_modules_that_directly_import(module) for module in inner}
    packages = {module for module in inner if graph.find_children(module)}
    between = sum(room(one) != room(module) for module in inner for one in importers[module])
    return {
        "modules": modules,
        "modules at the root": len([p for p in (ROOT / PACKAGE).glob("*.py") if p.name != "__init__.py"]),
        "lines": lines,
        "lines of code": code,
        "rooms": len({room(module) for module in inner} - {""}),
        "imports between rooms": between,
        "modules with one importer": sum(len(importers[module]) == 1 for module in inner if module not in packages),
        "test modules": tests,
        "test lines of code": test_code,
    }


if __name__ == "__main__":
    print(tabulate(figures().items(), headers=("", "value"), tablefmt="github"))
