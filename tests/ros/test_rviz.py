"""The launch file for RViz at work, where the launch packages are, with stand-ins for the programs of other packages.

RViz, tf2_ros and robot_state_publisher are not among the ROS 2 wheels. The stand-ins say how they were called; that of
RViz looks at the markers and closes.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from knee_contact_ros.system.files import PACKAGE, parse_yaml, share_folder
from tests.ros.conftest import PATIENCE, STEP, Peer, Start
from tests.ros.test_launch import RUN

SAY = """#!{python}
import json, pathlib, sys
said = pathlib.Path({folder!r})
files = [pathlib.Path(path).read_text() for flag, path in zip(sys.argv, sys.argv[1:]) if flag == "--params-file"]
(said / pathlib.Path(sys.argv[0]).name).write_text(json.dumps([sys.argv[1:], "".join(files)]))
"""
WAIT = """
import signal
signal.sigwait([signal.SIGINT, signal.SIGTERM])
"""
LOOK = """
import rclpy
from rclpy.node import Node
from visualization_msgs.msg import MarkerArray

rclpy.init(args=sys.argv)
node, pictures = Node("rviz"), []
node.create_subscription(MarkerArray, "/knee_contact/markers", pictures.append, 1)
while len(pictures) < 5:
    rclpy.spin_once(node, timeout_sec=0.1)
names = [marker.ns + " in " + marker.header.frame_id for marker in pictures[-1].markers]
(said / "seen").write_text(json.dumps([names, node.get_parameter("use_sim_time").value]))
"""
PROGRAMS = {
    ("rviz2", "rviz2"): LOOK,
    ("robot_state_publisher", "robot_state_publisher"): WAIT,
    ("tf2_ros", "static_transform_publisher"): WAIT,
}
"""By package and name"""


@pytest.fixture
def said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the stand-ins say how they were called."""
    pytest.importorskip("launch_ros", reason="the launch packages are not installed")
    index = pytest.importorskip("ament_index_python")
    if not (Path(index.get_package_prefix(PACKAGE)) / "lib" / PACKAGE / "knee_contact").exists():
        pytest.skip("ros2 run finds no executable in this environment")
    prefix, folder = tmp_path / "prefix", tmp_path / "said"
    folder.mkdir()
    for (package, name), what in PROGRAMS.items():
        marker = prefix / "share" / "ament_index" / "resource_index" / "packages" / package
        program = prefix / "lib" / package / name
        for path in (marker, program):
            path.parent.mkdir(parents=True, exist_ok=True)
        marker.touch()
        program.write_text(SAY.format(python=sys.executable, folder=str(folder)) + what)
        program.chmod(0o755)
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{prefix}{os.pathsep}{os.environ['AMENT_PREFIX_PATH']}")
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")  # as when activated
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    return folder


def test_rviz_sees_the_knee_and_closing_it_ends_everything(said: Path) -> None:
    command = [sys.executable, "-c", RUN, share_folder() / "launch" / "rviz.launch.py", "rate:=0.5"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE, check=False)
    assert done.returncode == 0, done.stderr + done.stdout
    assert (said / "seen").exists(), done.stderr + done.stdout
    names = ["tibia", "femur", "contact_point", "contact_force_on_femur"]
    assert json.loads((said / "seen").read_text()) == [[f"knee/{name} in tibia_r" for name in names], True]
    (option, layout, *_), time = json.loads((said / "rviz2").read_text())
    assert option == "--display-config"
    layouts = Path("config") / "rviz" / "knee_contact.rviz"
    assert Path(layout).read_text() == (share_folder() / layouts).read_text()
    assert parse_yaml(time)["/**"]["ros__parameters"] == {"use_sim_time": True}
    _, parameters = json.loads((said / "robot_state_publisher").read_text())
    body = parse_yaml(parameters)["/**"]["ros__parameters"]
    assert body == {"use_sim_time": True, "robot_description": (share_folder() / "urdf" / "knee.urdf").read_text()}
    called, _ = json.loads((said / "static_transform_publisher").read_text())
    assert called[:4] == ["--frame-id", "tibia_isb", "--child-frame-id", "tibia_r"]


def test_it_is_opened_beside_a_node_that_runs(said: Path, start_node: Start, peer: Peer) -> None:
    start_node()
    peer.wait_for_node()
    command = [sys.executable, "-c", RUN, share_folder() / "launch" / "rviz.launch.py"]
    arguments = ["replay:=false", "clock:=false", "frame:=tibia_isb"]
    launched = subprocess.Popen([*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    numbers = iter(range(10_000))

    def closed() -> bool:
        peer.send(next(numbers) * STEP, 0.2, 900.0)
        return launched.poll() is not None

    peer.wait_until(closed)
    assert launched.returncode == 0, launched.communicate()
    assert json.loads((said / "seen").read_text())[1] is False
    assert not (said / "static_transform_publisher").exists()
