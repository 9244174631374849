"""A launch file at work, where the launch packages are; they are not among the ROS 2 wheels."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from knee_contact_ros.bags.reader import read_bag
from knee_contact_ros.messages.topics import MESSAGE_TYPES
from knee_contact_ros.system.resources import PACKAGE, share_folder
from tests.helpers.needs import needs_viewer

RUN = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

arguments = [argument.split(":=") for argument in sys.argv[2:]]
include = IncludeLaunchDescription(PythonLaunchDescriptionSource(sys.argv[1]), launch_arguments=arguments)
service = LaunchService()
service.include_launch_description(LaunchDescription([include]))
sys.exit(service.run())
"""
"""What `ros2 launch FILE name:=value ...` does"""


@needs_viewer
def test_replay_goes_through_the_node_and_ends(tmp_path: Path) -> None:
    pytest.importorskip("launch_ros", reason="the launch packages are not installed")
    index = pytest.importorskip("ament_index_python")
    if not (Path(index.get_package_prefix(PACKAGE)) / "lib" / PACKAGE / "knee_contact").exists():
        pytest.skip("ros2 run finds no executable in a pip environment")
    arguments = ["rate:=5", "clock:=true", f"record:={tmp_path / 'out.mcap'}", f"rerun:={tmp_path / 'out.rrd'}"]
    command = [sys.executable, "-c", RUN, share_folder() / "launch" / "replay.launch.py", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    types = {f"/{topic}": name for topic, name in MESSAGE_TYPES.items()}
    messages = read_bag(tmp_path / "out.mcap", types)
    assert sum(message.topic == "/knee_contact" for message in messages) == 387
    assert (tmp_path / "out.rrd").exists()
