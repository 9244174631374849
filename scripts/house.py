"""How large the package is and how it hangs together, by `python -m scripts.house`."""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import grimp
from tabulate import tabulate

ROOT = Path(__file__).parents[1]
PACKAGE = "knee_contact_ros"
NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENCODING,
    tokenize.ENDMARKER,
}


def code_lines(source: str) -> int:
    """Lines of a module that hold more than a comment or a docstring, an attribute's included."""
    words: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            words.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in NO_CODE:
            code.update(range(token.start[0], token.end[0] + 1))
    return len(code - words)


def lines_in(folder: Path) -> tuple[int, int, int]:
    """Modules, all lines, and lines of code."""
    sources = [path.read_text(encoding="utf-8") for path in folder.rglob("*.py")]
    return (
        len(sources),
        sum(len(source.splitlines()) for source in sources),
        sum(map(code_lines, sources)),
    )


def room(module: str) -> str:
    """The part of the package in which a module lies; empty for the root."""
    parts = module.split(".")
    return parts[1] if len(parts) > 2 or (ROOT / PACKAGE / parts[-1]).is_dir() else ""


def floors_of(below: dict[str, set[str]]) -> tuple[int, int]:
    """Floors of the rooms, which import those `below`, and 0; or, if there is a circle, 0 and 1."""
    sorter, floors = TopologicalSorter({one: rooms for one, rooms in below.items() if one}), 0
    try:
        sorter.prepare()
    except CycleError:
        return 0, 1
    while rooms := sorter.get_ready():
        sorter.done(*rooms)
        floors += 1
    return floors, 0


def longest_chain(folder: Path) -> int:
    """Number of modules in the longest chain of a room's own imports, those on first use left out."""
    names = {path.stem for path in folder.glob("*.py")} - {"__init__"}

    @cache
    def below(name: str) -> int:
        tree = ast.parse((folder / f"{name}.py").read_text(encoding="utf-8"))
        found = [node for node in tree.body if isinstance(node, ast.ImportFrom) and node.module]
        words = {f"{node.module}.{alias.name}" for node in found for alias in node.names}
        own = {
            other
            for other in names
            for word in words
            if f"{PACKAGE}.{folder.name}.{other}." in f"{word}."
        }
        return 1 + max(map(below, own - {name}), default=0)

    return max(map(below, names), default=0)


def entered_in_a_tick() -> tuple[int, int]:
    """Functions that an uncompiled tick enters, and the files that they are in: most of any tick of gait."""
    from benchmarks.gait import gait
    from knee_contact_ros import load_model

    stream, most = load_model("healthy", compiled=False).stream(), (0, 0)
    for time, angle, load in zip(*gait("right"), strict=True):
        entered: set[CodeType] = set()

        def note(
            frame: FrameType, event: str, _argument: Any, entered: set[CodeType] = entered
        ) -> None:
            if event == "call":
                entered.add(frame.f_code)

        sys.setprofile(note)
        stream.tick(time, angle, load)
        sys.setprofile(None)
        most = max(most, (len(entered), len({code.co_filename for code in entered})))
    return most


def public_names(source: str) -> set[str]:
    """Return the public names that a module defines at its top level; imported ones are not among them."""
    names: set[str] = set()
    for node in ast.parse(source).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found = [each for target in targets for each in ast.walk(target)]
            names.update(
                each.id
                for each in found
                if isinstance(each, ast.Name) and isinstance(each.ctx, ast.Store)
            )
    return {name for name in names if not name.startswith("_")}


def names_with_several_definitions() -> dict[str, list[str]]:
    """Return the public names that several modules of the package define, with these modules."""
    modules: dict[str, list[str]] = {}
    for path in sorted((ROOT / PACKAGE).rglob("*.py")):
        for name in public_names(path.read_text(encoding="utf-8")):
            modules.setdefault(name, []).append(str(path.relative_to(ROOT / PACKAGE)))
    return {name: found for name, found in sorted(modules.items()) if len(found) > 1}


def figures() -> dict[str, int]:
    """Figures of the package by their names."""
    modules, lines, code = lines_in(ROOT / PACKAGE)
    tests, _, test_code = lines_in(ROOT / "tests")
    graph = grimp.build_graph(PACKAGE, cache_dir=None)
    inner = [module for module in graph.modules if module != PACKAGE]
    importers = {module: graph.find_modules_that_directly_import(module) for module in inner}
    packages = {module for module in inner if graph.find_children(module)}
    arrows = [
        (room(one), room(module))
        for module in inner
        for one in importers[module]
        if room(one) != room(module)
    ]
    floors, circles = floors_of(
        {one: {lower for upper, lower in arrows if upper == one and lower} for one, _ in arrows}
    )
    sources = [
        p.read_text(encoding="utf-8")
        for p in (ROOT / PACKAGE).rglob("*.py")
        if p.name != "__init__.py"
    ]
    model_modules, _, model_code = lines_in(ROOT / PACKAGE / "model")
    functions, files = entered_in_a_tick()
    return {
        "modules": modules,
        "modules at the root": len(
            [p for p in (ROOT / PACKAGE).glob("*.py") if p.name != "__init__.py"]
        ),
        "lines": lines,
        "lines of code": code,
        "rooms": len({room(module) for module in inner} - {""}),
        "floors": floors,
        "circles of rooms": circles,
        "imports between rooms": len(arrows),
        "modules of less than 25 lines of code": sum(
            code_lines(source) < 25 for source in sources
        ),
        "modules with one importer": sum(
            len(importers[module]) == 1 for module in inner if module not in packages
        ),
        "public names with several definitions": len(names_with_several_definitions()),
        "modules of the model": model_modules,
        "lines of code of the model": model_code,
        "longest chain of imports in the model": longest_chain(ROOT / PACKAGE / "model"),
        "functions that an uncompiled tick enters": functions,
        "files that they are in": files,
        "test modules": tests,
        "test lines of code": test_code,
    }


if __name__ == "__main__":
    for name, modules in names_with_several_definitions().items():
        print(f"{name}: {', '.join(modules)}")
    print(tabulate(figures().items(), headers=("", "value"), tablefmt="github"))
