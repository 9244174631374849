"""How large the package is, how it hangs together, and how dense its lines are, by `python -m scripts.house`.

Characters of code are the figure to hold: tokens without comments, docstrings and white space, so that plain layout,
comments and examples cost nothing. Lines, constants and the rest say how it reads.
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from types import CodeType, FrameType
from typing import Any, NamedTuple

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
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in NO_CODE:
            code.update(range(token.start[0], token.end[0] + 1))
    return len(code - documentation(ast.parse(source)))


def documentation(tree: ast.Module) -> set[int]:
    """Lines of docstrings, those of attributes included."""
    words: set[int] = set()
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            words.update(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    return words


class Density(NamedTuple):
    """How densely the modules of a folder are written."""

    characters: int
    """Characters of code"""
    code: int
    """Lines of code"""
    documentation: int
    """Lines of docstrings"""
    comments: int
    """Lines with a comment"""
    unformatted: int
    """Places where the formatter is switched off"""
    line: float
    """Characters of a line of code, with its indentation, in the mean"""
    functions: list[int]
    """Lines of each function, its docstring left out"""
    many_arguments: int
    """Functions with more than 7 parameters"""
    constants: int
    """Names in capitals that modules define"""
    packed: int
    """Assignments of three or more values to as many names"""
    modules: list[tuple[int, str]]
    """Lines and path of each module, the longest first"""


def density(folder: Path) -> Density:
    """Measure the modules of a folder."""
    characters = code = documented = comments = unformatted = width = 0
    many = constants = packed = 0
    functions: list[int] = []
    modules: list[tuple[int, str]] = []
    for path in folder.rglob("*.py"):
        source = path.read_text(encoding="utf-8")
        tree, lines = ast.parse(source), source.splitlines()
        words, used = documentation(tree), set[int]()
        for token in tokenize.generate_tokens(io.StringIO(source).readline):
            if token.type == tokenize.COMMENT:
                comments += 1
                unformatted += "fmt: " in token.string
            if token.type not in NO_CODE and token.start[0] not in words:
                used.update(range(token.start[0], token.end[0] + 1))
                characters += len(token.string)
        code += len(used)
        documented += len(words)
        width += sum(len(lines[number - 1]) for number in used)
        modules.append((len(lines), str(path.relative_to(ROOT))))
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                own = set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
                functions.append(len(own & used))
                arguments = node.args
                many += len(arguments.posonlyargs + arguments.args + arguments.kwonlyargs) > 7
            if isinstance(node, ast.Assign) and isinstance(node.value, ast.Tuple):
                packed += any(
                    isinstance(target, ast.Tuple) and len(target.elts) >= 3
                    for target in node.targets
                )
        constants += sum(name.isupper() for name in defined_names(tree))
    return Density(
        characters,
        code,
        documented,
        comments,
        unformatted,
        width / code,
        sorted(functions),
        many,
        constants,
        packed,
        sorted(modules, reverse=True),
    )


def defined_names(tree: ast.Module) -> list[str]:
    """Names that a module defines at its top level, imports left out."""
    names: list[str] = []
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.append(node.name)
        targets = node.targets if isinstance(node, ast.Assign) else []
        targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
        for target in targets:
            parts = target.elts if isinstance(target, ast.Tuple) else [target]
            names += [part.id for part in parts if isinstance(part, ast.Name)]
    return names


def density_figures(package: Density, tests: Density) -> dict[str, float]:
    """Figures of the density of the package, and the characters of its tests."""
    thousand = 1e-3 * package.code
    functions = package.functions
    return {
        "characters of code": package.characters,
        "characters of the tests' code": tests.characters,
        "characters of a line of code": round(package.line, 1),
        "lines of docstrings a line of code": round(package.documentation / package.code, 2),
        "comments a 1000 lines of code": round(package.comments / thousand),
        "places without the formatter": package.unformatted,
        "lines of a function, median": functions[len(functions) // 2],
        "lines of a function, 90 of 100 have at most": functions[len(functions) * 9 // 10],
        "functions of more than 60 lines": sum(lines > 60 for lines in functions),
        "functions with more than 7 parameters": package.many_arguments,
        "constants": package.constants,
        "assignments of three or more values": package.packed,
        "modules of more than 400 lines": sum(lines > 400 for lines, _ in package.modules),
        "modules of more than 600 lines": sum(lines > 600 for lines, _ in package.modules),
    }


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
        found = [
            node for node in tree.body if isinstance(node, ast.ImportFrom) and node.level == 1
        ]
        words = {f"{node.module or alias.name}." for node in found for alias in node.names}
        own = {other for other in names for word in words if word.startswith(f"{other}.")}
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


def figures() -> dict[str, float]:
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
    measured = density(ROOT / PACKAGE), density(ROOT / "tests")
    every = figures() | density_figures(*measured)
    print(tabulate(every.items(), headers=("", "value"), tablefmt="github"))
