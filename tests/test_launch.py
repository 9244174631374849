"""The launch file loads where the launch packages are installed; they are not among the ROS 2 wheels."""

from __future__ import annotations

import runpy

import pytest

from knee_contact_ros.resources import share_folder


def test_the_launch_file_describes_the_node() -> None:
    pytest.importorskip("launch_ros", reason="the launch packages are not installed")
    description = runpy.run_path(str(share_folder() / "launch" / "knee_contact.launch.py"))[
        "generate_launch_description"
    ]()
    assert len(description.entities) == 4
