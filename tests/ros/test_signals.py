"""Signals: those that end the node do so in whatever state it is, with its files completed; others do nothing."""

from __future__ import annotations

import signal
import time
from pathlib import Path

import psutil
import pytest

from knee_contact_ros.bags.reader import read_bag
from knee_contact_ros.model.compiler import kept_files, stamp
from knee_contact_ros.streams.topics import EACH_TICK, MESSAGE_TYPES
from tests.helpers.needs import needs_viewer
from tests.helpers.processes import has_ended
from tests.ros.conftest import STAMPS, STEP, Peer, Start


@pytest.mark.usefixtures("hang_up")
@needs_viewer
def test_hanging_up_completes_the_files(peer: Peer, start_node: Start, tmp_path: Path) -> None:
    """As SIGINT and SIGTERM do, by which other tests end their nodes."""
    recording, picture = tmp_path / "bag" / "bag_0.mcap", tmp_path / "knee.rrd"
    node = start_node(
        "-p", f"record.path:={recording}", "-p", "rerun.mode:=file", "-p", f"rerun.path:={picture}", anew=True
    )  # fmt: skip
    peer.wait_for_node()
    peer.send_series()
    peer.send_angle(int(STAMPS[-1]) + STEP, 0.1)  # an input without an answer
    peer.spin(0.3)
    code, output = node.stop(signal.SIGHUP)
    assert code == 0, output
    assert "40 ticks, 0 samples refused" in output
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["bag", "bag_0.mcap", "knee.rrd", "metadata.yaml"]
    messages = read_bag(recording.parent, {f"/{topic}": MESSAGE_TYPES[topic] for topic in EACH_TICK})
    count = {f"/{topic}": sum(m.topic == f"/{topic}" for m in messages) for topic in EACH_TICK}
    assert count == {"/joint_states": 41, "/joint_reaction_force": 40, "/knee_contact": 40, "/knee_contact/wrench": 40}
    recorded = [m.message.penetration_depth for m in messages if m.topic == "/knee_contact"]
    assert recorded == [contact.penetration_depth for contact in peer.contacts]


@pytest.mark.parametrize(("children", "signals"), [(1, 2), (2, 1)])
def test_a_node_that_compiles_ends_without_a_kernel(
    start_node: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, children: int, signals: int,
    request: pytest.FixtureRequest,
) -> None:  # fmt: skip
    """Also if it is told to at the moment when its second child has begun, which compiles; the first one records."""
    monkeypatch.setenv("NUMBA_OPT", "2")  # what is compiled with other settings is of no use
    request.addfinalizer(stamp.cache_clear)
    stamp.cache_clear()
    for left in kept_files():  # by this test, where it has failed
        left.unlink()
    node = start_node("-p", f"record.path:={tmp_path / 'bag' / 'bag_0.mcap'}", anew=True)
    process, begun = psutil.Process(node.process.pid), list[psutil.Process]()
    while len(begun) < children:
        assert node.process.poll() is None
        begun = process.children()
    for _ in range(signals - 1):  # as Ctrl-C in a demo, which reaches the node twice
        node.process.send_signal(signal.SIGINT)
        time.sleep(0.02)
    code, output = node.stop(signal.SIGTERM)
    assert code == 0, output
    assert "Traceback" not in output
    assert not [child for child in begun if not has_ended(child)]
    assert not kept_files()
    assert not list(tmp_path.glob("bag/*.partial"))


def test_a_node_outlives_its_terminal_where_it_was_asked_to(
    peer: Peer, start_node: Start, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As `nohup` asks: by ignoring SIGHUP, which its children inherit."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        node = start_node(anew=True)
    finally:
        signal.signal(signal.SIGHUP, before)
    peer.wait_for_node()
    node.process.send_signal(signal.SIGHUP)
    peer.spin(0.3)
    peer.send_series()
    code, output = node.stop(signal.SIGTERM)
    assert code == 0, output
    assert "40 ticks" in output
