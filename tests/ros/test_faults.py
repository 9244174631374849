"""Faults injected into the streams of a running node: what each costs is the faulty sample itself, and nothing else.

Every fault comes in the middle of a stream of good samples. All good samples must be answered, with the bits that the
Python calls give for them alone; the next answer must carry the fault's status bit, and its counter must count it.
"""

import re
from collections import Counter

import pytest
from knee_contact_ros.msg import KneeContact
from std_srvs.srv import Trigger

from examples.assist_as_needed import AssistLaw, Settings
from knee_contact_ros import load_model
from knee_contact_ros.model.types import Status
from knee_contact_ros.streams.topics import stamp_to_ns
from tests import ROOT
from tests.helpers.patience import patience
from tests.ros.conftest import NodeProcess, Peer, call
from tests.ros.faults import FAULTS, HALF, OK, SECOND, STEP, Sample, angle_at

SHARE = 0.5
WAIT = 7.0
"""How long [s] a force waits for its angle: what a burst has lost Fast DDS sends again with a heartbeat, every 3 s"""
FIELDS = (
    "contact_force",
    "penetration_depth",
    "gap",
    "penetration_rate",
    "femoral_height",
    "error_estimate",
)


class Running:
    """A node that lives through all of the faults, and what it must have refused so far."""

    def __init__(self):
        self.process = NodeProcess("use_sim_time:=true", f"pairing.wait:={WAIT}")
        self.refused: Counter[str] = Counter()
        self.unusable = 0
        """Answers that nothing must be controlled by"""
        self.begin = 1000 * SECOND


@pytest.fixture(scope="module")
def running():
    running = Running()
    yield running
    running.process.process.kill()
    running.process.process.communicate(timeout=patience())


@pytest.fixture(scope="module")
def one_peer(running):
    """Our side, which meets the node once."""
    peer = Peer()
    peer.node_process = running.process.process.pid
    peer.wait_for_node()
    yield peer
    peer.executor.shutdown()
    peer.node.destroy_node()


@pytest.fixture
def listening(one_peer):
    """Our side, with the node at rest: its next tick starts anew."""
    assert call(one_peer, Trigger, "/knee_contact/reset", Trigger.Request()).success
    one_peer.contacts.clear()
    yield one_peer
    while one_peer.stalled:
        process = one_peer.stalled.pop()
        process.kill()
        process.wait()


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_fault_costs_nothing_but_the_faulty_sample(listening, running, fault):
    peer, begin = listening, running.begin
    first = [Sample(begin + i * STEP, angle_at(i), 800.0 + 40.0 * i) for i in range(HALF)]
    first[0] = first[0]._replace(status=Status.TIME_RESET)
    after = [
        Sample(
            begin + i * STEP + fault.shift,
            angle_at(i),
            800.0 + 40.0 * i,
            fault.status if i == HALF else OK,
        )
        for i in range(HALF, 2 * HALF)
    ]
    send(peer, first)
    extra = fault.inject(peer, begin + (HALF - 1) * STEP + STEP // 2) or []
    peer.spin(0.05)  # nothing orders the samples of two topics
    send(peer, after, already=len(first) + len(extra))
    expected = [*first, *extra, *after]
    assert [stamp_to_ns(contact.header.stamp) for contact in peer.contacts] == [
        sample.stamp for sample in expected
    ]
    assert [contact.status for contact in peer.contacts] == [sample.status for sample in expected]
    model = load_model({})
    stream = model.stream()
    for contact, sample in zip(peer.contacts, expected, strict=True):
        if sample.status & Status.TIME_RESET:
            stream = model.stream()
        stream.advance(sample.stamp, sample.angle, SHARE * sample.axial)
        (alone,) = stream.answer
        assert [getattr(contact, name) for name in FIELDS] == [
            getattr(alone, name) for name in FIELDS
        ]
    law = AssistLaw(Settings())
    for contact, sample in zip(peer.contacts, expected, strict=True):
        law.hear(0.0, contact.contact_force, contact.status, contact.error_estimate)
        is_usable = Status(sample.status) in (Status.OK, Status.INPUT_REJECTED)
        assert is_usable == law.usable == (contact.status & KneeContact.UNUSABLE == 0)
        running.unusable += not is_usable
    running.refused.update(fault.counters)
    running.begin += 10 * SECOND


def send(peer, samples, already=0):
    """Publish good samples and wait for all answers."""
    for sample in samples:
        peer.send(sample.stamp, sample.angle, sample.axial)
    peer.wait_until(lambda: len(peer.contacts) >= already + len(samples))


def test_all_that_was_refused_is_counted(listening, running):
    """Runs last: the sums over all faults of this file."""
    expected = {reason: str(count) for reason, count in running.refused.items()}
    expected["total"] = str(running.refused.total())
    peer, unusable = listening, str(running.unusable)
    # Once a second; a report may lie between the last refusal and the last answer.
    peer.wait_until(lambda: peer.diagnostics.get("knee_contact: refused samples") == expected)
    peer.wait_until(lambda: peer.diagnostics["knee_contact: answers"]["not usable"] == unusable)


OF_ITSELF = {"angle lost": Status.INPUT_HELD}
"""Status of the answer to the faulty sample, where the table tells that one's"""
ENTRIES = {"pairing"}
"""What the table names of `/diagnostics` that counts no refused samples"""


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_the_documented_table_says_what_a_fault_costs(fault):
    page = (ROOT / "docs" / "reference" / "faults.md").read_text(encoding="utf-8")
    rows = [
        [cell.strip() for cell in line.strip("|").split("|")]
        for line in page.splitlines()
        if line[:2] == "| "
    ]
    ((_, lost, status, counters),) = [row for row in rows if row[0] == fault.name]
    assert lost
    told = OF_ITSELF.get(fault.name, Status(fault.status))
    assert set(re.findall("[A-Z_]{2,}", status)) == {bit.name for bit in Status if bit & told} | (
        {"OK"} if not told else set()
    )
    assert set(re.findall("`([a-z_]+)`", counters)) - ENTRIES == set(fault.counters)
