"""The launch files at work, where the launch packages are; they are not among the ROS 2 wheels.

RViz, tf2_ros and robot_state_publisher are not among them, either: stand-ins say how they were called, and that of RViz
looks at the markers and closes.
"""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from importlib.util import find_spec
from itertools import count
from pathlib import Path
from typing import NamedTuple

import psutil
import pytest

from knee_contact_ros.bags.names import absolute
from knee_contact_ros.streams.topics import KNEE_CONTACT, MESSAGE_TYPES
from knee_contact_ros.system.files import PACKAGE, parse_yaml, share_folder
from tests.helpers.bags import raw_messages
from tests.helpers.patience import patience, wait_until
from tests.ros.conftest import STEP, Peer

pytest.importorskip("launch_ros", reason="needs the ROS package launch_ros")
FOLDER = share_folder() / "launch"
RUN = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

arguments = [argument.split(":=") for argument in sys.argv[2:]]
include = IncludeLaunchDescription(PythonLaunchDescriptionSource(sys.argv[1]), launch_arguments=arguments)
service = LaunchService(noninteractive=True)
service.include_launch_description(LaunchDescription([include]))
sys.exit(service.run())
"""
"""What `ros2 launch FILE name:=value ...` does where there is no terminal"""
INTERRUPTED = "130"
"""The code of a replay that was interrupted"""


class Knee(NamedTuple):
    """A knee of a launch file: what it listens to, and the file that it records to."""

    namespace: str = ""
    joint_states: str = "joint_states"
    joint: str = "knee"
    recording: str = "knee.mcap"


class Case(NamedTuple):
    """A launch file with arguments, `{}` for a folder, its knees, and whether the test publishes their samples."""

    file: str
    arguments: str
    knees: tuple[Knee, ...] = (Knee(),)
    fed: bool = True


BOTH = "left_record:={}/left.mcap right_record:={}/right.mcap"
CASES = {
    "node": Case("knee_contact.launch.py", "record:={}/knee.mcap"),
    "two knees": Case(
        "two_knees.launch.py",
        f"{BOTH} right_params:={{}}/soft.yaml",
        (Knee("left", recording="left.mcap"), Knee("right", recording="right.mcap")),
    ),
    "two knees on one topic": Case(
        "two_knees.launch.py",
        f"{BOTH} joint_states:=/joint_states left_joint:=knee_l right_joint:=knee_r",
        (
            Knee("left", "/joint_states", "knee_l", "left.mcap"),
            Knee("right", "/joint_states", "knee_r", "right.mcap"),
        ),
    ),
    "replay": Case("replay.launch.py", "record:={}/knee.mcap loop:=true", fed=False),
}
BAD = {
    "no such parameter file": (
        "knee_contact.launch.py",
        "params:=/nowhere.yaml",
        "/nowhere.yaml: cannot read",
    ),
    "delay is not a number": (
        "two_knees.launch.py",
        "respawn_delay:=nan",
        "respawn_delay:=nan: it must be a number",
    ),
    "bad parameters of both knees": (
        "two_knees.launch.py",
        "left_params:={}/unknown.yaml right_params:={}/unknown.yaml",
        "contact.stifness",
    ),
    "bad parameter of a load node": (
        "knee_load.launch.py",
        "params:={}/unknown.yaml",
        "contact.stifness",
    ),
    "bad parameter of a replay": (
        "replay.launch.py",
        "params:={}/unknown.yaml",
        "contact.stifness",
    ),
}
"""Launch file, arguments, what is said"""
FILES = {
    "soft.yaml": "/**: {ros__parameters: {contact: {stiffness: 4.0e+7}}}",
    "unknown.yaml": "/**: {ros__parameters: {contact: {stifness: 4.0e+7}}}",
}


class Launched:
    """A launch file that runs."""

    def __init__(self, file, arguments, folder):
        folder.mkdir(exist_ok=True)
        for name, content in FILES.items():
            (folder / name).write_text(content)
        self._log = (folder / "said").open("w+")
        path = os.pathsep.join(
            (str(Path(sys.executable).parent), os.environ["PATH"])
        )  # of this environment
        self.process = subprocess.Popen(
            [
                sys.executable,
                "-c",
                RUN,
                FOLDER / file,
                *arguments.replace("{}", str(folder)).split(),
            ],
            stdout=self._log,
            stderr=subprocess.STDOUT,
            env=os.environ | {"PATH": path, "ROS_LOG_DIR": str(folder / "log")},
        )

    def said(self):
        """All that launch and its processes have said."""
        return Path(self._log.name).read_text()

    def hear(self, words, times=1):
        """Wait until it has said something so many times."""
        wait_until(lambda: self.said().count(words) >= times)

    def node(self):
        """The only node's process."""
        (node,) = [
            child
            for child in psutil.Process(self.process.pid).children()
            if "--ros-args" in child.cmdline()
        ]
        return node

    def stop(self):
        """Ctrl-C."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(patience())

    def kill(self):
        """Leave nothing of it."""
        if self.process.poll() is None:
            for process in [
                *psutil.Process(self.process.pid).children(recursive=True),
                self.process,
            ]:
                process.kill()
        self.process.wait()
        self._log.close()


Launch = Callable[[str, str], Launched]


@pytest.fixture
def start(tmp_path):
    """Start launch files; all are gone after the test."""
    index = pytest.importorskip("ament_index_python")
    if not (Path(index.get_package_prefix(PACKAGE)) / "lib" / PACKAGE / "knee_contact").exists():
        pytest.skip("the package was installed without what `ros2 run` starts")
    launched: list[Launched] = []

    def start_it(file, arguments):
        launched.append(Launched(file, arguments, tmp_path))
        return launched[-1]

    yield start_it
    for each in launched:
        each.kill()


@pytest.fixture
def peers():
    """Peers of knees."""
    made: list[Peer] = []

    def make(knee):
        made.append(Peer(knee.namespace, knee.joint_states))
        return made[-1]

    yield make
    for peer in made:
        peer.executor.shutdown()
        peer.node.destroy_node()


class Stream:
    """Samples at 200 Hz that go on whoever listens."""

    def __init__(self, knees, fed=True):
        self.knees, self._fed, self._sent = knees, fed, 0

    def until(self, done):
        """Send on and hear answers until something has happened."""
        wait_until(done, self._go_on)

    def _go_on(self):
        if self._fed:
            self._send()
        due = time.monotonic() + STEP * 1e-9
        while (left := due - time.monotonic()) > 0.0:
            for peer in self.knees.values():
                peer.executor.spin_once(timeout_sec=left / len(self.knees))

    def _send(self):
        for knee, peer in self.knees.items():
            peer.send_angle(self._sent * STEP, 0.3, knee.joint)
            peer.send_force(self._sent * STEP, 900.0 + self._sent % 100)
        self._sent += 1


def answers(path, namespace=""):
    """The stamps [ns] of the answers in a recording."""
    name = absolute(KNEE_CONTACT, namespace)
    return [
        message.log_time for message in raw_messages(path, {name: MESSAGE_TYPES[KNEE_CONTACT]})
    ]


@pytest.mark.parametrize("name", CASES)
def test_it_runs_until_ctrl_c(name, start, peers, tmp_path):
    file, arguments, knees, fed = CASES[name]
    stream = Stream({knee: peers(knee) for knee in knees}, fed)
    launched = start(file, arguments)
    stream.until(lambda: all(len(peer.contacts) >= 50 for peer in stream.knees.values()))
    assert launched.stop() == 0
    said = launched.said()
    assert said.count("process has finished cleanly") >= len(knees), said
    assert "Traceback" not in said
    assert set(re.findall(r"exit code (-?\d+)", said)) <= {INTERRUPTED}
    for knee in knees:
        assert len(answers(tmp_path / knee.recording, knee.namespace)) >= 50


def test_replay_goes_through_the_node_and_ends(start, tmp_path):
    rerun = "rerun:={}/out.rrd" if find_spec("rerun") else ""
    launched = start("replay.launch.py", f"rate:=5 clock:=true record:={{}}/out.mcap {rerun}")
    assert launched.process.wait(patience()) == 0, launched.said()
    assert len(answers(tmp_path / "out.mcap")) == 387
    assert (tmp_path / "out.rrd").exists() == bool(rerun)


@pytest.mark.parametrize("name", BAD)
def test_what_is_wrong_is_told_once_and_ends(name, start):
    file, arguments, words = BAD[name]
    launched = start(file, arguments)
    launched.process.wait(patience())
    said = launched.said()
    assert words in said
    assert "Traceback" not in said
    assert said.count("exit code 2") == said.count("process started") - said.count(
        "[replay-2]: process started"
    )


def test_a_node_that_is_told_to_end_stays_away(start):
    launched = start("knee_contact.launch.py", "")
    launched.hear("active, listening")
    launched.node().terminate()
    assert launched.process.wait(patience()) == 0
    assert launched.said().count("process started") == 1


def test_a_node_that_was_good_before_tries_again(start, tmp_path):
    launched = start("knee_contact.launch.py", "params:={}/soft.yaml respawn_delay:=0.1")
    launched.hear("active, listening")
    content = (tmp_path / "soft.yaml").read_text()
    (tmp_path / "soft.yaml").unlink()
    launched.node().kill()
    launched.hear("exit code 2", times=2)
    (tmp_path / "soft.yaml").write_text(content)
    launched.hear("active, listening", times=2)
    assert launched.stop() == 0


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
def said(tmp_path, monkeypatch):
    """Where the stand-ins say how they were called."""
    pytest.importorskip("launch_ros", reason="needs the ROS package launch_ros")
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
    monkeypatch.setenv(
        "AMENT_PREFIX_PATH", f"{prefix}{os.pathsep}{os.environ['AMENT_PREFIX_PATH']}"
    )
    monkeypatch.setenv(
        "PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    )  # as when activated
    monkeypatch.setenv("ROS_LOG_DIR", str(tmp_path / "log"))
    return folder


def test_rviz_sees_the_knee_and_closing_it_ends_everything(said):
    command = [
        sys.executable,
        "-c",
        RUN,
        share_folder() / "launch" / "rviz.launch.py",
        "rate:=0.5",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=patience(), check=False)
    assert done.returncode == 0, done.stderr + done.stdout
    assert (said / "seen").exists(), done.stderr + done.stdout
    names = ["tibia", "femur", "contact_point", "contact_force_on_femur"]
    assert json.loads((said / "seen").read_text()) == [
        [f"knee/{name} in tibia_r" for name in names],
        True,
    ]
    (option, layout, *_), time = json.loads((said / "rviz2").read_text())
    assert option == "--display-config"
    layouts = Path("config") / "rviz" / "knee_contact.rviz"
    assert Path(layout).read_text() == (share_folder() / layouts).read_text()
    assert parse_yaml(time)["/**"]["ros__parameters"] == {"use_sim_time": True}
    _, parameters = json.loads((said / "robot_state_publisher").read_text())
    body = parse_yaml(parameters)["/**"]["ros__parameters"]
    assert body == {
        "use_sim_time": True,
        "robot_description": (share_folder() / "urdf" / "knee.urdf").read_text(),
    }
    called, _ = json.loads((said / "static_transform_publisher").read_text())
    assert called[:4] == ["--frame-id", "tibia_isb", "--child-frame-id", "tibia_r"]


def test_it_is_opened_beside_a_node_that_runs(said, start_node, peer):
    start_node()
    peer.wait_for_node()
    command = [sys.executable, "-c", RUN, share_folder() / "launch" / "rviz.launch.py"]
    arguments = ["replay:=false", "clock:=false", "frame:=tibia_isb"]
    launched = subprocess.Popen(
        [*command, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    numbers = count()

    def closed():
        peer.send(next(numbers) * STEP, 0.2, 900.0)
        peer.spin(1e-9 * STEP)
        return launched.poll() is not None

    peer.wait_until(closed)
    assert launched.returncode == 0, launched.communicate()
    assert json.loads((said / "seen").read_text())[1] is False
    assert not (said / "static_transform_publisher").exists()
