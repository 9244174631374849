"""`knee-contact replay` over real topics: what arrives, in which part, with which clock, and how it ends."""

import re
import signal
import subprocess
import sys
import time

import pytest
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState

from knee_contact_ros.bags.bag import INPUT_TYPES
from knee_contact_ros.commands.main import main
from knee_contact_ros.streams.topics import NANOSECONDS, stamp_to_ns
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.ros import one_line_ros_errors
from tests.helpers.bags import raw_messages, write_rosbag2
from tests.helpers.patience import patience
from tests.helpers.terminals import Terminal
from tests.ros.conftest import own_words

COMMAND = [sys.executable, "-m", "knee_contact_ros.commands.main", "replay"]
ANGLE, FORCE = INPUT_TYPES
LAST_LINE = (
    r"(\d+) messages published, \d+ \([0-9.e-]+ %\) later than 1 ms, the latest by [0-9.]+ ms; "
    r"drift at the end "
)


class Ear:
    """Hears what a replay publishes."""

    def __init__(self, peer, namespace=""):
        self.peer = peer
        self.heard: dict[str, list[bytes]] = {ANGLE: [], FORCE: []}
        self.clock: list[int] = []
        qos = QoSProfile(depth=5000)
        for topic, kind in ((ANGLE, JointState), (FORCE, WrenchStamped)):
            peer.node.create_subscription(
                kind, f"{namespace}{topic}", self.heard[topic].append, qos, raw=True
            )
        peer.node.create_subscription(
            Clock, "/clock", lambda m: self.clock.append(stamp_to_ns(m.clock)), qos
        )

    @property
    def count(self):
        return sum(map(len, self.heard.values()))

    def listen_to(self, replay):
        """Until it has ended, and until all has come that it has said to have published."""
        self.peer.wait_until(lambda: replay.poll() is not None)
        output, errors = replay.communicate(timeout=patience())
        said = re.match(LAST_LINE, output)
        assert said, output + errors
        self.peer.wait_until(
            lambda: self.count >= int(said[1])
        )  # a signal may come between a message and its count
        return output, own_words(errors)


@pytest.fixture
def ear(peer):
    return Ear(peer)


@pytest.fixture(scope="module")
def gait(request):
    return raw_messages(request.getfixturevalue("right_bag"))


@pytest.fixture
def start():
    started = []

    def start(*arguments):
        command = [*COMMAND, *map(str, arguments)]
        started.append(
            subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        )
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def by_topic(messages):
    return {
        topic: [message.data for message in messages if message.topic == topic]
        for topic in INPUT_TYPES
    }


def test_every_message_comes_as_it_was_recorded(ear, start, right_bag, gait):
    """A plain --clock, here before BAG, tells the time of every message."""
    replay = start("--clock", right_bag, "--rate", "4", "--wait", "60")
    _, errors = ear.listen_to(replay)
    assert (replay.returncode, errors) == (0, "")  # no progress bar in a pipe
    assert ear.heard == by_topic(gait)
    ear.peer.wait_until(lambda: len(ear.clock) == len(gait))
    assert ear.clock == [message.log_time for message in gait]


def test_who_is_found_later_misses_nothing(ear, start, right_bag, gait):
    """Two nodes on the same topics are found one after the other."""
    replay = start(right_bag, "--wait", "60")
    ear.peer.wait_until(
        lambda: all(ear.peer.node.count_publishers(topic) > 1 for topic in INPUT_TYPES)
    )  # the first is ours
    time.sleep(0.5)
    later = Ear(ear.peer)
    ear.listen_to(replay)
    ear.peer.wait_until(lambda: later.count == ear.count)
    assert later.heard == ear.heard == by_topic(gait)


@pytest.mark.parametrize("there", [True, False], ids=["in the bag too", "in no bag"])
def test_a_part_into_a_namespace_with_a_clock_of_its_own_rate(peer, start, gait, tmp_path, there):
    ear = Ear(peer, "/left")
    bag = write_rosbag2(
        tmp_path / "bag", gait, name=lambda topic: f"/left{topic}" if there else topic
    )
    replay = start(
        bag, "--namespace", "/left/", "--start-offset", "0.5", "--duration", "0.4", "--clock", "50"
    )
    ear.listen_to(replay)
    begin = gait[0].log_time + NANOSECONDS // 2
    end = begin + 4 * NANOSECONDS // 10
    assert ear.heard == by_topic([message for message in gait if begin <= message.log_time < end])
    assert 3 < len(ear.clock) <= 21  # every 20 ms; a busy machine may leave some out
    assert ear.clock == sorted(ear.clock)
    assert ear.clock[0] >= begin


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_loop_starts_over_and_ends_at_once_with_all_that_was_sent(
    ear, start, right_bag, gait, number, code
):
    replay = start(right_bag, "--loop", "--start-offset", "1.6", "--rate", "2")
    part = by_topic([m for m in gait if m.log_time >= gait[0].log_time + 16 * NANOSECONDS // 10])
    ear.peer.wait_until(lambda: len(ear.heard[FORCE]) > 2.5 * len(part[FORCE]))
    replay.send_signal(number)
    ear.listen_to(replay)
    assert replay.returncode == code
    for topic, heard in ear.heard.items():
        once = len(part[topic])
        assert heard == (part[topic] * (len(heard) // once + 1))[: len(heard)]


def test_keys_step_pause_and_go_on(ear, right_bag, gait):
    part = [message for message in gait if message.log_time >= gait[0].log_time + NANOSECONDS]
    with Terminal(
        *COMMAND, str(right_bag), "--start-offset", "1", "--start-paused", "--wait", "60"
    ) as terminal:
        terminal.wait_for("Paused gait2354_right at rate 1")
        ear.peer.spin(0.3)
        assert ear.count == 0
        for steps, key in enumerate((b"s", b"\x1b[C", b"s"), start=1):
            terminal.press(key)
            ear.peer.wait_until(lambda steps=steps: ear.count == steps)
        ear.peer.spin(0.3)
        assert ear.count == 3
        terminal.press(b"\x1b[A ")
        terminal.wait_for("Replaying gait2354_right at rate 1.1")
        ear.peer.wait_until(lambda: ear.count > 20)
        terminal.press(b" ")
        terminal.wait_for("Paused gait2354_right at rate 1.1")
        ear.peer.spin(0.3)
        paused_at = ear.count
        ear.peer.spin(0.3)
        assert ear.count == paused_at < len(part)
        terminal.press(b" ")
        ear.peer.wait_until(lambda: ear.count == len(part))
        terminal.wait_for(LAST_LINE)
        terminal.wait_for(r"\[ended with 0, usual\]")
    assert ear.heard == by_topic(part)


@pytest.mark.parametrize("namespace", ["a b", "9x", "n" * 300])
def test_a_namespace_that_ros_refuses_is_told_in_one_line(namespace):
    with (
        pytest.raises(
            UsageError, match=rf"cannot join the ROS graph: Invalid namespace: .*/{namespace}'$"
        ),
        one_line_ros_errors(),
    ):
        Node("knee_contact_replay", namespace=namespace)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--start-paused"], "--start-paused needs a terminal"),
        (["--start-offset", "100"], "has no message there; it lasts 1.930 s"),
        (["--clock", "-3"], "-3.0 is not in the range"),
        (
            ["--remap", "joint_states:=/exo"],
            "has no topic /exo (sensor_msgs/msg/JointState); its topics",
        ),
    ],
)
def test_what_cannot_be_played_is_told_in_one_line(arguments, words, right_bag, capfd):
    assert main(["replay", str(right_bag), *arguments]) == 2
    printed, errors = capfd.readouterr()
    assert words in errors
    assert (printed, len(errors.splitlines())) == ("", 1)
