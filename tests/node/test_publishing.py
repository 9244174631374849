"""A live answer: its messages come first, its latency counts from the arrival of the force, and it is counted."""

from types import SimpleNamespace

import numpy as np
import pytest

from knee_contact_ros.bags.leg import DrawnLeg
from knee_contact_ros.model.types import ROW
from knee_contact_ros.node.contact_node import ContactSession
from knee_contact_ros.node.diagnostics import AnswerCounts
from knee_contact_ros.node.inputs import HandedInputs, HandOver
from knee_contact_ros.node.load_node import LoadSession
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.load_schema import LoadParameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.load_pipeline import LoadPipeline
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)

ARRIVED, BEGUN, PUBLISHED = 100.0, 100.5, 102.0
"""Times [s]: the force arrives, waits, and its answer is computed and published"""
STATE = encode_joint_state(JointState(0, "", ("knee",), (0.3,), (), ()))
FORCE = encode_wrench_stamped(WrenchStamped(0, "tibia", (0.0, -900.0, 0.0), (0.0, 0.0, 0.0)))


@pytest.fixture
def acts(monkeypatch):
    """What sessions do, in order: topics that they publish, and what they put into the outputs."""
    monkeypatch.setattr("time.perf_counter", lambda: PUBLISHED)
    return []


def session_of(kind, pipeline, acts, **more):
    """A session that publishes and records into a list."""
    session = kind.__new__(kind)
    vars(session).update(
        pipeline=pipeline,
        parameters=pipeline.parameters,
        outputs=SimpleNamespace(put_item=acts.append),
        health=SimpleNamespace(counts=AnswerCounts(), rows=[]),
        **more,
    )
    return session


def answers_of(pipeline):
    return [*pipeline.push_joint_state(STATE), *pipeline.push_force(FORCE, ARRIVED)]


@pytest.mark.parametrize("compartments", ["fixed_share", "both"])
def test_a_contact_is_published_before_it_is_recorded(acts, compartments):
    values = {"load.compartment": compartments}
    pipeline = ContactPipeline(load_parameters(values), compiled=False)
    number = len(pipeline.compartments)
    session = session_of(
        ContactSession,
        pipeline,
        acts,
        _leg=DrawnLeg(),
        _markers=SimpleNamespace(),
        _strides=SimpleNamespace(add_answer=acts.append),
        _publish_contact=[acts.append] * number,
        _publish_wrench=acts.append,
    )
    (answer,) = answers_of(pipeline)
    session._publish(answer, BEGUN)
    *published, output, kept = acts
    assert published == [*answer.messages, answer.wrench]
    assert kept is session._markers.newest is answer
    rows = np.frombuffer(output.row, ROW)
    assert rows["latency"].tolist() == [PUBLISHED - ARRIVED] * number
    assert [data for *_, data in output.records if data in published] == published
    counts = session.health.counts
    assert (counts.latency, counts.durations) == (PUBLISHED - ARRIVED, [PUBLISHED - BEGUN])
    assert counts.missed == counts.by_status.total() == 1


def test_an_estimate_is_handed_over_first_and_its_latency_is_counted(acts):
    pipeline = LoadPipeline(load_parameters({}, LoadParameters))
    takers = HandedInputs(HandOver(), HandOver())
    takers.forces.taker = acts.append
    publishers = dict.fromkeys(
        ("joint_reaction_force", "load_estimate"), SimpleNamespace(publish=acts.append)
    )
    session = session_of(LoadSession, pipeline, acts, _takers=takers, _publishers=publishers)
    (answer,) = answers_of(pipeline)
    session._publish(answer, BEGUN)
    *published, output = acts
    assert published == [answer.reaction, answer.reaction, answer.message]
    assert output.records == answer.records()
    counts = session.health.counts
    assert (counts.latency, counts.durations) == (PUBLISHED - ARRIVED, [PUBLISHED - BEGUN])
