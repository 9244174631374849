"""What `about` tells."""

import platform
import sys

import numpy as np

from knee_contact_ros import __version__
from knee_contact_ros.commands import about
from knee_contact_ros.commands.main import main


def told(capsys):
    assert main(["about"]) == 0
    lines = capsys.readouterr().out.splitlines()
    return {name: fact.strip() for name, _, fact in (line.partition(":") for line in lines)}


def test_it_names_versions_the_system_and_the_library(capsys):
    facts = told(capsys)
    assert facts["knee_contact_ros"].startswith(f"{__version__}, in ")
    assert facts["Python"] == f"{platform.python_version()}, {sys.executable}"
    assert platform.machine() in facts["system"]
    assert f"numpy {np.__version__}" in facts["installed"]
    assert facts["compiled model"].endswith((".so", ".dylib", ".dll"))


def test_it_names_what_is_missing(capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "rclpy", None)
    monkeypatch.setitem(sys.modules, "knee_contact_ros.msg", None)
    monkeypatch.setattr(about, "found_library", lambda: None)
    monkeypatch.setattr(
        about, "requires", lambda _: ["numpy>=1", "no-such-library[x]; python_version > '3'"]
    )
    facts = told(capsys)
    assert facts["ROS 2"] == "none; messages of this package: no"
    assert facts["compiled model"].startswith("none: ")
    assert facts["not installed"] == "no-such-library"
