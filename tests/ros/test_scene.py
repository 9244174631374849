"""The scene live: served to viewers on this machine; none of them, slow, stopped or killed, costs an answer."""

import signal
import time
from ipaddress import ip_address

import psutil
import pytest

pytest.importorskip("rerun", reason="needs the extra viewer")
from knee_contact_ros.system.processes import free_port
from knee_contact_ros.view.plots import DETAIL_PLOTS, SOLVER_PLOTS
from tests.helpers.viewer import rendered, shown_to, wait_for, window_of
from tests.ros.test_outputs import children, walk

LOOPBACK = "127.0.0.1"
VIEWER = "knee_contact: viewer"


def address(port):
    return f"rerun+http://{LOOPBACK}:{port}/proxy"


def listeners(process):
    """Addresses on which a process and its children accept connections; 127.0.0.1 for all of the loopback interface."""
    return {
        LOOPBACK if ip_address(connection.laddr.ip).is_loopback else connection.laddr.ip
        for one in (process, *process.children(recursive=True))
        for connection in one.net_connections("tcp")
        if connection.status == psutil.CONN_LISTEN
    }


def stand_still(place):
    """Stop the viewers of an address."""
    viewers = [
        process
        for process in psutil.process_iter(["name", "cmdline"])  # zombies have no command line
        if process.info["name"] == "rerun" and place in (process.info["cmdline"] or [])
    ]
    assert viewers
    for viewer in viewers:
        viewer.send_signal(signal.SIGSTOP)


def test_viewers_see_what_is_served_and_cost_no_answer(peer, start_node):
    """One that stands still takes nothing from its socket any more; what is kept for it is bounded."""
    port = free_port()
    node = start_node("rerun.mode:=serve", f"rerun.port:={port}")
    peer.wait_for_node()
    assert listeners(psutil.Process(node.process.pid)) == {LOOPBACK}
    walk(peer, 0, 400)  # nobody looks
    (server,) = children(node)
    with rendered(address(port)) as screen:
        wait_for(lambda: shown_to(screen.state) >= 399 * 5_000_000, "the viewer to have all")
        # plots of a circle; plane, words, events, states, leg
        assert len(screen.views()) == 2 + len(DETAIL_PLOTS) + len(SOLVER_PLOTS) + 6
        assert screen.complaints() == []
        walk(peer, 400, 100)
        wait_for(lambda: shown_to(screen.state) >= 499 * 5_000_000, "the viewer to follow")
        stand_still(address(port))
        for begin in range(500, 1500, 100):
            walk(peer, begin, 100)
        peer.wait_until(lambda: peer.diagnostics.get(VIEWER, {}).get("written") == "1500")
    walk(peer, 1500, 100)  # it was killed
    peer.wait_until(lambda: peer.diagnostics.get(VIEWER, {}).get("written") == "1600")
    assert peer.diagnostics[VIEWER]["dropped"] == "0"
    assert server.is_running()
    said = node.stop()
    assert f"knee-contact view {address(port)}" in said
    assert [contact.status for contact in peer.contacts] == [0] * 1600


def test_a_window_is_opened_and_may_be_ended(peer, start_node, hidden_screen):
    port = free_port()
    node = start_node("rerun.mode:=spawn", f"rerun.port:={port}")
    peer.wait_for_node()
    walk(peer, 0, 100)
    with window_of(psutil.Process(node.process.pid), 99 * 5_000_000) as viewer:
        assert listeners(psutil.Process(node.process.pid)) == {LOOPBACK}
        viewer.terminate()
        viewer.wait(30.0)
    walk(peer, 100, 100)
    time.sleep(2.0)  # the server looks once a second
    said = node.stop()
    assert (
        f"the Rerun viewer was ended by SIGTERM; the scene is still served: knee-contact view {address(port)}"
        in said
    )
    assert [contact.status for contact in peer.contacts] == [0] * 200


def test_two_nodes_share_a_viewer(peer, start_node):
    ports = {"left": free_port(), "right": free_port()}
    for side, port in ports.items():
        remaps = (
            f"__ns:=/{side}",
            "joint_states:=/joint_states",
            "joint_reaction_force:=/joint_reaction_force",
        )
        rules = [word for rule in remaps for word in ("-r", rule)]
        start_node(
            *rules,
            "rerun.mode:=serve",
            f"rerun.port:={port}",
            "rerun.knees:=left,right",
        )
    peer.wait_until(
        lambda: (
            peer.angle.get_subscription_count() == 2 and peer.force.get_subscription_count() == 2
        )
    )
    for number in range(100):
        peer.send(number * 5_000_000, 0.2, 900.0)
    with rendered(*map(address, ports.values())) as screen:
        wait_for(lambda: shown_to(screen.state) >= 99 * 5_000_000, "the viewer to have all")
        (recording,) = screen.state.recordings
        assert [line.name for line in recording.timelines] == ["stamp"]
        names = list(screen.views())
        assert screen.complaints() == []
    plots = {name for name in names if name.endswith(": left blue, right orange")}
    assert len(plots) == 2 + len(DETAIL_PLOTS) + len(SOLVER_PLOTS)
    each = {
        f"{side}: {what}"
        for side in ports
        for what in (
            "cartilage 2 × 2.2 mm (drawn only)",
            "contact and level",
            "events",
            "leg and contact force",
        )
    }
    assert set(names) - plots == each | {"What you see", "Stance, shaded, and swing"}
