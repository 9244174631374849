"""The example of an assist controller beside the real node: its commands fall, return, and end at zero."""

import signal
import subprocess
import sys
import time
from functools import partial

import psutil
import pytest
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray

from examples.assist_as_needed import COMMANDS
from knee_contact_ros.system.files import share_folder
from tests.helpers.patience import patience, wait_until
from tests.helpers.processes import internet_sockets
from tests.ros.conftest import own_words

EXAMPLE = share_folder() / "examples" / "assist_as_needed.py"
PARAMETERS = EXAMPLE.with_suffix(".yaml")
STEP = 5_000_000
"""[ns] between samples"""
LOW, HIGH = 1000.0, 4000.0
"""[N] axial forces; half of them is the compartment's, and the limit is 1400 N"""


class Loop:
    """A stream of samples at 200 Hz through node and companion, and the commands that come back."""

    def __init__(self, peer):
        self.peer = peer
        self.stamp = 0
        self.commands: list[float] = []
        """Torques [N m]"""
        self._due = 0.0
        peer.node.create_subscription(
            Float64MultiArray, COMMANDS, self._on_command, QoSProfile(depth=1000)
        )

    def _on_command(self, message):
        self.commands.append(message.data[0])

    @property
    def torque(self):
        """[N m] the newest command"""
        return self.commands[-1]

    def wait_for_both(self):
        """Wait until node and companion listen and speak."""
        self.peer.wait_for_node()
        self.peer.wait_until(
            lambda: self.peer.node.count_subscribers("knee_contact") == 2 and self.commands
        )

    def send(self, axial):
        """Publish a sample when it is due."""
        while (left := self._due - time.perf_counter()) > 0.0:
            self.peer.executor.spin_once(timeout_sec=left)
        self._due = time.perf_counter() + STEP * 1e-9
        self.stamp += STEP
        self.peer.send(self.stamp, 0.2, axial)

    def send_until(self, axial, done):
        """Publish samples until something has happened."""
        wait_until(done, partial(self.send, axial))


@pytest.fixture
def companion():
    """The example with quick rates, so that the test is short, and patience, for other tests may slow it down."""
    arguments = ["--params-file", str(PARAMETERS)]
    for setting in ("rise_rate:=100.0", "fall_rate:=100.0", "timeout:=0.5"):
        arguments += ["-p", setting]
    process = subprocess.Popen(
        [sys.executable, EXAMPLE, "--ros-args", *arguments], stderr=subprocess.PIPE, text=True
    )
    yield process
    process.kill()
    process.wait()
    process.stderr.close()


@pytest.fixture
def loop(peer, start_node, companion):
    """All three at work, and the torque at its nominal value."""
    start_node()
    loop = Loop(peer)
    loop.wait_for_both()
    assert loop.torque == 0.0
    loop.send_until(LOW, lambda: loop.torque == 10.0)
    return loop


def test_the_torque_follows_the_force_and_falls_step_by_step_to_zero_where_it_must(
    loop, companion
):
    """Above the limit; where the stream jumps or stops; and at the end."""
    assert {socket.laddr.ip for socket in internet_sockets(psutil.Process(companion.pid))} == {
        "127.0.0.1"
    }
    loop.send_until(HIGH, lambda: loop.torque == 0.0)
    loop.send_until(LOW, lambda: loop.torque == 10.0)
    loop.stamp += 200 * STEP  # the node will flag STALE_INPUT
    loop.commands.clear()
    loop.send(LOW)
    loop.peer.wait_until(lambda: loop.commands and loop.torque < 10.0)
    loop.send_until(LOW, lambda: loop.torque == 10.0)
    loop.commands.clear()
    loop.peer.wait_until(lambda: loop.commands and loop.torque == 0.0)
    assert loop.commands == sorted(loop.commands, reverse=True)
    loop.send_until(LOW, lambda: loop.torque == 10.0)
    loop.commands.clear()
    companion.send_signal(signal.SIGTERM)  # a demo ends it by SIGINT
    loop.send_until(LOW, lambda: companion.poll() is not None)
    loop.peer.wait_until(lambda: loop.torque == 0.0)
    falling = (
        loop.commands[-loop.commands[::-1].index(10.0) :]
        if 10.0 in loop.commands
        else loop.commands
    )
    assert falling == sorted(falling, reverse=True)
    assert 0.0 < falling[0] < 10.0
    assert companion.returncode == 0
    log = companion.stderr.read()
    assert "no assist: the node's input was interrupted" in log
    assert "no assist: no answer for 0.5 s" in log


def test_a_bad_parameter_ends_it_with_one_line():
    command = [sys.executable, EXAMPLE, "--ros-args", "-p", "fall_rate:=-1.0"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=patience(), check=False)
    assert done.returncode == 2
    assert (
        own_words(done.stderr)
        == "assist_as_needed: fall_rate: -1.0 is not allowed; it should be a number > 0\n"
    )
