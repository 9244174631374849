"""What a report of a fault needs to know about an installation: `knee-contact about`."""

import os
import platform
import re
import sys
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec
from pathlib import Path

import click

from .. import __version__
from ..model.kernel import found_library
from ..system.files import PACKAGE

WITHOUT_METADATA = ("click", "mcap", "numpy", "pydantic", "rosbags", "scipy")
"""What is looked for where colcon installed the package, which leaves no list of what it needs"""


def print_about() -> None:
    """Print the versions, the system, and what is compiled, in one line each."""
    library = found_library()
    has_messages = bool(find_spec(f"{PACKAGE}.msg"))
    ros = os.environ.get("ROS_DISTRO", "from PyPI or unnamed") if find_spec("rclpy") else "none"
    facts = {
        "knee_contact_ros": f"{__version__}, in {Path(__file__).parents[1]}",
        "Python": f"{platform.python_version()}, {sys.executable}",
        "system": f"{platform.platform()}, {platform.machine()}, {os.cpu_count()} processors",
        "compiled model": str(
            library or "none: the plain model computes, or the first use builds it"
        ),
        "ROS 2": f"{ros}; messages of this package: {'yes' if has_messages else 'no'}",
    }
    installed = _versions()
    facts["installed"] = ", ".join(f"{name} {its}" for name, its in installed.items() if its)
    facts["not installed"] = ", ".join(name for name, its in installed.items() if not its)
    for name, fact in facts.items():
        click.echo(f"{name + ':':<18}{fact}")


def _versions() -> dict[str, str]:
    """Return the versions of what the package and its extras ask for, "" for what is missing."""
    try:
        asked = requires(PACKAGE) or []
    except PackageNotFoundError:
        asked = list(WITHOUT_METADATA)
    found = {}
    for name in sorted({re.split(r"[^\w.-]", one)[0] for one in asked}, key=str.lower):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = ""
    return found
