"""A recording that begins in the middle of a run holds the state of the run, from which `solve` continues it."""

import json

import numpy as np
import pytest

from knee_contact_ros.bags.answers import read_answers
from knee_contact_ros.bags.bag import RawMessage
from knee_contact_ros.bags.leg import DrawnLeg
from knee_contact_ros.bags.provenance import STATE, provenance_record, read_provenance
from knee_contact_ros.bags.recorder import AnswerWriter, BagWriter
from knee_contact_ros.model.types import Status
from knee_contact_ros.parameters.curves import curve_texts
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import has_two_compartments
from knee_contact_ros.streams.contact_pipeline import CONTACT_TOPICS, ContactPipeline
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import MESSAGE_TYPES, recorded_topics
from knee_contact_ros.system.errors import UsageError
from tests.helpers.answers import answers_to
from tests.helpers.bags import raw_messages
from tests.helpers.offline import solve

BEGIN, FORCES, ANGLES = 10**9, 5_000_000, 11_000_000
"""First stamp, and the time between two forces and between two angles [ns]"""
LIFT_OFF = 0.3
"""Time [s] at which the load ends"""
KNEES = {
    "healthy": ["healthy"],
    "both": ["healthy", "both_compartments", {"lateral.contact.damping": 900.0}],
    "impact": ["healthy", {"contact.law": "hunt_crossley"}],
}


def messages():
    """A turning knee under a load that is thrown off, in the order of the stamps; few angles, many forces."""
    sent = []
    for i in range(120):
        stamp, time = BEGIN + i * FORCES, 1e-9 * i * FORCES
        load = 1000.0 + 300.0 * np.sin(20.0 * time) if time < LIFT_OFF else 2.0
        wrench = WrenchStamped(stamp, "tibia_r", (0.0, -2.0 * load, 0.0), (10.0, 0.0, 0.0))
        sent.append(RawMessage("/joint_reaction_force", stamp, encode_wrench_stamped(wrench)))
    for i in range(-1, 60):
        stamp = BEGIN + i * ANGLES + 1_000_000
        angle = 0.4 + 0.3 * float(np.sin(9e-9 * i * ANGLES))
        state = JointState(stamp, "", ("knee",), (angle,), (), ())
        sent.append(RawMessage("/joint_states", stamp, encode_joint_state(state)))
    return sorted(sent, key=lambda message: message.log_time)


def recorded(knee, path, begin, reset=False):
    """Record a run from one of its messages on, as the node does; return the answers from there on."""
    parameters = load_parameters(KNEES[knee])
    pipeline, sent = ContactPipeline(parameters, compiled=True), messages()
    for _ in answers_to(pipeline, sent[:begin]):
        pass
    if reset:
        for _ in pipeline.finish_streams():
            pass
        pipeline.reset()
    with BagWriter(path) as bag:
        state = pipeline.run_state()
        texts = curve_texts(parameters, {})
        provenance = provenance_record(parameters, texts, ticks_before=pipeline.ticks, state=state)
        names = {topic: f"/{topic}" for topic in recorded_topics(has_two_compartments(parameters))}
        writer, leg, kept = AnswerWriter(bag, provenance, names), DrawnLeg(), []
        for answer in [*answers_to(pipeline, sent[begin:]), *pipeline.finish_streams()]:
            writer.write_answer(leg.records_with_leg(answer))
            kept.append(answer.messages[-1])
        writer.write_ending(pipeline.ending())
    return kept


def again(path, tmp_path):
    """The answers that a recording is solved to."""
    provenance = read_provenance(path)
    solve(path, provenance, tmp_path / "again.mcap", overwrite=True)
    topic = CONTACT_TOPICS[has_two_compartments(provenance.parameters)]
    types = {f"/{topic}": MESSAGE_TYPES[topic]}
    return [message.data for message in raw_messages(tmp_path / "again.mcap", types)]


@pytest.mark.parametrize("begin", [1, 2, 20, 87, 88, 89, 90, 91, 95, 150])
@pytest.mark.parametrize("knee", KNEES)
def test_the_run_goes_on_bit_by_bit(tmp_path, knee, begin):
    """In stance, at the lift-off and in flight; wherever the last angle lies beside the last force."""
    live = recorded(knee, tmp_path / "middle.mcap", begin)
    assert len(live) > 15
    assert again(tmp_path / "middle.mcap", tmp_path) == live


def test_after_a_reset_it_begins_from_rest(tmp_path):
    live = recorded("healthy", tmp_path / "middle.mcap", 60, reset=True)
    assert again(tmp_path / "middle.mcap", tmp_path) == live


@pytest.mark.parametrize("reset", [False, True])
def test_a_reset_before_the_first_answer_is_known(tmp_path, reset):
    live = recorded("healthy", tmp_path / "begin.mcap", 0, reset)
    assert again(tmp_path / "begin.mcap", tmp_path) == live
    (first, *_) = read_answers(tmp_path / "again.mcap")["status"]
    assert bool(first & Status.TIME_RESET) == reset


def test_without_the_state_nothing_is_ok_and_wrong(tmp_path):
    """As recordings of earlier versions are: flagged while the femur may still fly."""
    recorded("healthy", tmp_path / "middle.mcap", 92)
    provenance = read_provenance(tmp_path / "middle.mcap")
    assert provenance.state is not None
    solve(tmp_path / "middle.mcap", provenance._replace(state=None), tmp_path / "again.mcap")
    rows = read_answers(tmp_path / "again.mcap")
    assert (rows["status"] & Status.NOT_CONVERGED != 0).all()


@pytest.mark.parametrize(
    "damaged",
    [
        "",
        "{}",
        "[1, [], []]",
        '["x", [], []]',
        "[1, [[1]], [[0.0]]]",
        "[null, 3, []]",
        "[1, [], [[1.0]]]",
    ],
)
def test_a_damaged_state_is_said(tmp_path, damaged):
    path = tmp_path / "middle.mcap"
    parameters = load_parameters({})
    with BagWriter(path) as bag:
        record = provenance_record(parameters, {}, ticks_before=1)
        bag.add_metadata("knee_contact", record | {STATE: damaged})
    with pytest.raises(UsageError, match="state"):
        again(path, tmp_path)


def test_a_state_of_another_model_is_not_used(tmp_path):
    pipeline = ContactPipeline(load_parameters({}), compiled=True)
    for _ in answers_to(pipeline, messages()[:50]):
        pass
    record = provenance_record(pipeline.parameters, {}, ticks_before=9, state=pipeline.run_state())
    assert json.loads(record[STATE])[0] == pipeline.synchroniser.last_pair
    with BagWriter(tmp_path / "other.mcap") as bag:
        bag.add_metadata("knee_contact", record | {"model_sha256": "0"})
    found = read_provenance(tmp_path / "other.mcap")
    assert found.state is None
