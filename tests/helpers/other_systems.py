"""What Windows and macOS lack of Python's library, and processes of the package that lack it, too.

The names are those of typeshed, whose conditions on `sys.platform` hold the notes on availability in Python's
documentation. Modules are those that the documentation calls unavailable on Windows, or that need ROS.
"""

import ast
import json
import os
import sys
from importlib.util import find_spec
from pathlib import Path

from tests import ROOT

SYSTEMS = ("win32", "darwin")
MODULES = ("errno", "mmap", "os", "select", "signal", "socket", "sys", "time")
"""Modules that have fewer names on some systems"""
ABSENT_MODULES = {
    "win32": [
        *("_posixshmem", "_posixsubprocess", "crypt", "curses", "dbm", "fcntl", "grp", "nis"),
        *("ossaudiodev", "posix", "pty", "pwd", "readline", "resource", "spwd", "syslog"),
        *("termios", "tty"),
    ],
    "darwin": ["msvcrt", "ossaudiodev", "spwd", "winreg"],
}
ROS_MODULES = [
    *("ament_index_python", "builtin_interfaces", "diagnostic_msgs", "domain_coordinator"),
    *("geometry_msgs", "lifecycle_msgs", "rclpy", "rcl_interfaces", "sensor_msgs", "std_msgs"),
    *("std_srvs", "visualization_msgs"),
]


def lacking_names(system):
    """Return the names that Linux has and a system lacks, by module."""
    return {
        module: sorted(names_of(module, "linux") - names_of(module, system)) for module in MODULES
    }


def names_of(module, system):
    """Return the names of a module of Python's library on a system."""
    package = find_spec("mypy")
    stub = Path(str(package.origin)).with_name("typeshed") / "stdlib" / module
    file = stub / "__init__.pyi" if stub.is_dir() else stub.with_suffix(".pyi")
    return set(_names(ast.parse(file.read_text("utf-8")).body, system))


def _names(statements, system):
    for one in statements:
        if isinstance(one, ast.If):
            yield from _names(one.body if _holds(one.test, system) else one.orelse, system)
        elif isinstance(one, ast.FunctionDef | ast.ClassDef):
            yield one.name
        elif isinstance(one, ast.AnnAssign):
            yield ast.unparse(one.target)
        elif isinstance(one, ast.Assign):
            yield from map(ast.unparse, one.targets)
        elif isinstance(one, ast.ImportFrom):
            for each in one.names:
                yield from names_of(str(one.module), system) if each.name == "*" else [each.name]


def _holds(test, system):
    """Whether a condition on the system and on Python's version holds."""
    code = compile(ast.Expression(test), "stub", "eval")
    known = {"platform": system, "version_info": sys.version_info}
    return bool(eval(code, {"sys": type("sys", (), known)}))  # noqa: S307


def environment(system):
    """Return the environment of a Python process in which the package believes that it runs on a system.

    The console of Windows has the characters of code page 1252 only.
    """
    folders = [ROOT / "tests" / "helpers" / "other_system", ROOT, os.environ.get("PYTHONPATH", "")]
    asked = {
        "system": system,
        "lacking": lacking_names(system),
        "absent": [*ABSENT_MODULES[system], *ROS_MODULES],
    }
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(filter(None, map(str, folders))),
        "PYTHONIOENCODING": "cp1252" if system == "win32" else "utf-8",
        "PYTHONUTF8": "0",
        "PYTHONWARNDEFAULTENCODING": "1",
        "KNEE_CONTACT_TEST_SYSTEM": json.dumps(asked),
    }
