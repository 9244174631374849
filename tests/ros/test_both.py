"""Both compartments of a real node: topics, recording, scene, changes between ticks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from knee_contact_ros.msg import KneeContact
from rclpy.qos import QoSProfile

from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.streams.topics import recorded_topics
from tests.helpers.needs import HAS_VIEWER
from tests.ros.conftest import Peer, Start, raw, set_parameters, trigger

MILLISECOND = 1_000_000
TICKS = 60


def test_medial_and_lateral_answers_and_the_wrench_of_both(peer: Peer, start_node: Start, tmp_path: Path) -> None:
    """With a change amid them, of the medial one alone, and a reset; computed again from the recording: same bytes."""
    lateral: list[KneeContact] = []
    peer.node.create_subscription(KneeContact, "knee_contact/lateral", lateral.append, QoSProfile(depth=1000))
    recording, redone, scene = (tmp_path / name for name in ("live.mcap", "redone.mcap", "knee.rrd"))
    shown = ("-p", "rerun.mode:=file", "-p", f"rerun.path:={scene}") if HAS_VIEWER else ()
    node = start_node(
        "-p", "load.compartment:=both", "-p", "load.share:=0.6", "-p", "lateral.contact.damping:=900.0",
        "-p", f"record.path:={recording}", *shown,
    )  # fmt: skip
    peer.wait_for_node()
    peer.wait_until(lambda: peer.node.count_publishers("knee_contact/lateral"))
    axial = [800.0 + 300.0 * np.sin(0.4 * i) for i in range(TICKS)]
    for i, force in enumerate(axial):
        if i == TICKS // 2:
            peer.wait_until(lambda: len(peer.contacts) == TICKS // 2)
            assert set_parameters(peer, {"contact.stiffness": 5e7, "load.compartment_spacing": 0.05}) == (True, "")
        if i == 3 * TICKS // 4:
            peer.wait_until(lambda: len(peer.contacts) == 3 * TICKS // 4)
            assert trigger(peer, "reset")[0]
        peer.send(i * 5 * MILLISECOND, 0.2, force)
    peer.wait_until(lambda: len(peer.contacts) == len(lateral) == len(peer.wrenches) == TICKS)
    node.stop()
    assert [one.header.stamp for one in lateral] == [one.header.stamp for one in peer.contacts]
    loads = np.array([[one.load, other.load] for one, other in zip(peer.contacts, lateral, strict=True)])
    assert loads.sum(axis=1) == pytest.approx(axial, rel=1e-15)  # a difference and a sum: two roundings
    assert loads[:, 0] == pytest.approx(0.6 * np.array(axial), rel=1e-15)
    places = [(one.contact_point.z, other.contact_point.z) for one, other in zip(peer.contacts, lateral, strict=True)]
    assert places == (TICKS // 2) * [(-0.035, 0.035)] + (TICKS // 2) * [(-0.025, 0.025)]
    for contact, other, wrench in zip(peer.contacts, lateral, peer.wrenches, strict=True):
        forces = np.array([contact.contact_force, other.contact_force])
        assert wrench.wrench.force.y == pytest.approx(-forces.sum(), rel=1e-15)
        assert wrench.wrench.torque.x == pytest.approx(other.contact_point.z * (forces[1] - forces[0]), abs=1e-12)
    found, topics = read_provenance(recording), recorded_topics(has_both=True)
    assert found is not None
    assert found.parameters.lateral.contact.stiffness == found.parameters.contact.stiffness
    solve(recording, found, redone, lambda _done, _total: None)
    assert raw(recording, topics) == raw(redone, topics)
    assert len(raw(recording, topics)) == 5 * TICKS + 1 + 15  # and a leg, which moves 50 times a second
    assert scene.is_file() or not HAS_VIEWER
