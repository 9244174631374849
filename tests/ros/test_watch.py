"""`knee-contact watch`: what it finds of a real node, for people and for scripts."""

import json
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from knee_contact_ros.msg import KneeContact
from rclpy.node import Node

from tests.helpers.patience import patience
from tests.helpers.terminals import Terminal

COMMAND = (str(Path(sys.executable).parent / "knee-contact"), "watch")


def once(peer, *arguments, send=True):
    """Code and words of a `watch --once`, while both inputs come at 100 Hz."""
    process = subprocess.Popen(
        [*COMMAND, "--once", *arguments], text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    while process.poll() is None:
        if send:
            peer.send(peer.node.get_clock().now().nanoseconds, 0.5, 800.0)
        peer.spin(0.01)
    return process.returncode, *process.communicate()


def once_usable(peer, *arguments):
    """Words of a `watch --once` whose answer is usable, which a busy machine's, coming late, need not be."""
    begin = time.monotonic()
    while (found := once(peer, *arguments))[0] == 1:
        assert time.monotonic() < begin + patience(), found
    code, text, errors = found
    assert (code, errors) == (0, "")
    return text


def report_of(peer, *arguments, send=True):
    found: dict[str, Any] = json.loads(once(peer, "--json", *arguments, send=send)[1])
    return found


def test_scripts_read_rates_and_numbers(peer, start_node):
    node = start_node()
    peer.wait_for_node()
    report = json.loads(once_usable(peer, "--json"))
    assert (report["node"], report["usable"], report["because"]) == ("/knee_contact", True, None)
    answer = report["answers"]["/knee_contact"]
    assert (answer["flexion_angle"], answer["load"], answer["flags"]) == (0.5, 400.0, [])
    assert answer["contact_force"] == pytest.approx(peer.contacts[-1].contact_force, rel=1e-3)
    assert 20.0 < answer["rate"] <= 110.0  # 100 Hz, on a machine that may be busy
    assert answer["age"] < 2.0
    assert report["diagnostics"]["joint_states"]["publishers"] == "1"
    entry = report["diagnostics"]["answers"]
    assert entry["message"] in peer.told  # the first answers of a busy machine may be unusable
    assert (entry["level"] == "ok") == (entry["message"] == "ok")
    text = once_usable(peer)
    assert re.search(r"^usable +yes$", text, re.MULTILINE)
    assert re.search(r"^  angle +28.65 deg$", text, re.MULTILINE)
    state = re.search(r"^joint_states +\d+\.\d Hz  (.+)$", text, re.MULTILINE)
    assert state
    assert state[1] == "ok" or any(words in state[1] for words in peer.told - {"ok"})
    log = node.stop()
    line = re.search(r"(\d+) Hz on /joint_states, (\d+) Hz on /joint_reaction_force, (.*)", log)
    assert line
    words = r"\d+ answers a second, knee_contact: 4\d\d N, (all usable|\d+ of \d+ not usable)"
    assert re.fullmatch(words, line[3])
    assert 20 < int(line[1]) <= 110
    assert log.count("answers a second") == 1


def test_what_cannot_be_used_is_said_and_is_the_exit_code(peer, start_node):
    code, _, errors = once(peer, "--wait", "1", send=False)
    assert code == 2
    assert "no node with knee_contact or load_estimate in ROS domain" in errors
    start_node()
    peer.wait_for_node()
    code, text, errors = once(peer, "--wait", "3", send=False)
    assert code == 1
    assert "usable                NO: no answer yet" in text
    assert errors.startswith("knee-contact: /knee_contact: no usable answer: no answer yet")
    code, _, errors = once(peer, "knee_contct", "--wait", "6", send=False)
    assert (code, "did you mean /knee_contact?" in errors) == (2, True)


def test_a_node_is_chosen_by_name(peer, start_node):
    start_node()
    peer.wait_for_node()
    other = Node("other", namespace="left")
    publisher = other.create_publisher(KneeContact, "knee_contact", 10)
    peer.wait_until(lambda: peer.node.count_publishers("/left/knee_contact"))
    code, _, errors = once(peer, "--wait", "5", send=False)
    assert code == 2
    assert "several nodes answer: /knee_contact, /left/other; name one of them" in errors
    publisher.publish(KneeContact())
    assert report_of(peer, "knee_contact")["node"] == "/knee_contact"
    other.destroy_node()


def test_a_terminal_stays_still_and_keeps_the_last_picture(peer, start_node):
    start_node()
    peer.wait_for_node()
    with Terminal(*COMMAND) as terminal:
        terminal.wait_for(r"\x1b\[\?1049h")  # a screen of its own
        terminal.wait_for(r"waiting: no node|/knee_contact  active")
        for _ in range(2):
            terminal.wait_for(r"\x1b\[H[^\x1b]*NO: no answer yet[^\x1b]*joint_reaction_force")
        terminal.press(b"\x03")
        terminal.wait_for(r"\x1b\[\?1049l")
        terminal.wait_for(r"usable +NO: no answer yet")
        terminal.wait_for(r"\[ended with 0, usual\]")


def test_a_node_that_went_is_told_and_watched_again_when_it_is_back(peer, start_node):
    """An answer's age alone does not tell a node that is gone from sensors that are silent."""
    node = start_node()
    peer.wait_for_node()
    with Terminal(*COMMAND) as terminal:
        terminal.wait_for(r"/knee_contact  active")
        terminal.wait_for(r"joint_reaction_force")
        node.stop()
        terminal.wait_for(r"/knee_contact  (gone|silent: it was killed or hangs)")
        terminal.wait_for(r"NO: no answer[^\x1b]*: the node is gone")
        start_node()
        peer.wait_for_node()
        terminal.wait_for(r"/knee_contact  active")
        terminal.press(b"\x03")
        terminal.wait_for(r"\[ended with 0, usual\]")
