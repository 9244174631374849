"""The recipe "A new command" of CONTRIBUTING: a step that is left out turns a test red that names it.

Its test of bad input is asked for in `test_bad_input.py`, its damaged bags in `tests/hostile/test_commands.py`.
"""

import ast
import re
from importlib import import_module
from pathlib import Path

import click
import pytest

from knee_contact_ros.commands.main import knee_contact
from tests import ROOT

CHANGELOG = (ROOT / "CHANGELOG.rst").read_text(encoding="utf-8")
OLD_OPTIONS = Path(__file__).with_name("options_of_1.0.0.txt")
"""Options from before this rule that the changelog does not name: a line for each command"""
COMMANDS = ROOT / "knee_contact_ros" / "commands"
WITH_WORK = {"about", "demo", "player", "replay", "tables", "view", "watch"}
"""Modules of `commands/` that do more than declare commands: they drive ROS and viewers, and print"""
DECLARING = ("live", "offline", "lab")
"""Modules of `commands/` that declare commands"""
HELPERS = {"merged_bags"}
"""Functions beside commands that do work: a folder of links, in which several bags are one"""
MAX_STATEMENTS = 30
NUMERIC = ("numpy", "scipy", "pandas", "polars", "xarray")
REDUCTIONS = {"max", "min", "mean", "sum", "argmax", "argmin", "std"}


@pytest.mark.parametrize("name", knee_contact.commands)
def test_the_changelog_names_the_command_and_its_options(name):
    assert re.search(rf"``(knee-contact )?{name}\b", CHANGELOG), (
        f"no line of CHANGELOG.rst names the command ``{name}``"
    )
    old = dict(line.split(" ", 1) for line in OLD_OPTIONS.read_text().splitlines())
    options = {
        option
        for parameter in knee_contact.commands[name].params
        if isinstance(parameter, click.Option)
        for option in parameter.opts
        if option.startswith("--") and not re.search(rf"{option}(?![\w-])", CHANGELOG)
    }
    unnamed = options - set(old.get(name, "").split())
    assert not unnamed, f"no line of CHANGELOG.rst names {unnamed} of the command {name}"


@pytest.mark.parametrize("name", knee_contact.commands)
def test_a_test_calls_the_command(name):
    others = {Path(__file__), Path(__file__).with_name("test_bad_input.py")}
    tests = {*(ROOT / "tests").rglob("test_*.py")} - {*others, *(ROOT / "tests/hostile").iterdir()}
    assert any(
        re.search(rf"""["']{name}["' ]""", path.read_text(encoding="utf-8")) for path in tests
    ), f"no test calls the command {name} with good input"


def work_in(function):
    """Return what in a command is work, and not a call of another room: arithmetic, fields of answers, libraries."""
    nodes = [node for statement in function.body for node in ast.walk(statement)]
    found = []
    for node in nodes:
        match node:
            case ast.BinOp(op=op) if not isinstance(op, ast.BitOr):
                found.append(node)
            case ast.AugAssign(value=ast.Constant() | ast.Name() | ast.Attribute()):
                found.append(node)
            case ast.Subscript(slice=ast.Constant(value=str()), ctx=ast.Load()):
                found.append(node)
            case ast.Call(func=ast.Name(id=name)) if name in ("max", "min"):
                found.append(node)
            case ast.Call(func=ast.Attribute(attr=name)) if name in REDUCTIONS:
                found.append(node)
            case ast.Import(names=[ast.alias(name=module)]) | ast.ImportFrom(module=str(module)):
                if module.startswith(NUMERIC):
                    found.append(node)
    size = sum(isinstance(node, ast.stmt) for node in nodes)
    too_long = [f"{size} statements, more than {MAX_STATEMENTS}"] if size > MAX_STATEMENTS else []
    return [f"line {node.lineno}: {ast.unparse(node)}" for node in found] + too_long


def functions_in(path):
    """Return the functions of a module, of which some are commands; methods of click's classes are left out."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [node for node in tree.body if isinstance(node, ast.FunctionDef)]


@pytest.mark.parametrize("name", DECLARING)
def test_a_command_does_no_work_itself(name):
    """It reads its options, calls another room, and says what that has returned; nor does a function beside it."""
    for function in functions_in(COMMANDS / f"{name}.py"):
        work = [] if function.name in HELPERS else work_in(function)
        assert not work, (
            f"{name}.py: {function.name} does work, which belongs into another room "
            f"(CONTRIBUTING.md, A new command): {work}"
        )


def test_every_command_is_in_a_group():
    for name in (*DECLARING, *WITH_WORK):
        module = import_module(f"knee_contact_ros.commands.{name}")
        declared = {one.name for one in vars(module).values() if isinstance(one, click.Command)}
        missing = declared - knee_contact.commands.keys()
        assert not missing, (
            f"{missing} of commands/{name}.py: a group of GROUPS in main.py names it"
        )


def test_modules_with_work_are_known():
    others = {path.stem for path in COMMANDS.glob("*.py")} - WITH_WORK
    new = others - {"__init__", "main", "options", *DECLARING}
    assert not new, f"commands/{new}: what a command does lies in another room (CONTRIBUTING.md)"
