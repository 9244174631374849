"""Answers made up by tests, and those that a pipeline gives, as rows."""

import numpy as np
from hypothesis import strategies as st

from knee_contact_ros.model.types import FLAT, MESSAGE_BYTES, ROW, blank_answers
from knee_contact_ros.streams.topics import JOINT_STATES

FIELDS = tuple(
    name for name, (_, begin, *_) in (ROW.fields or {}).items() if begin < MESSAGE_BYTES.stop
)
"""Those of the message behind its header"""
EXAMPLE = {
    "flexion_angle": 0.1,
    "load": 2.0,
    "contact_force": 3.0,
    "penetration_depth": 4e-4,
    "penetration_rate": 0.01,
    "sliding_velocity": -0.02,
    "contact_point": (0.005, 0.0, 0.0),
    "femoral_height": 0.03,
    "cartilage_depth": 4e-4,
    "contact_state": 1,
    "fidelity": 2,
    "error_estimate": 1e-9,
    "force_error_estimate": 1e-3,
    "evaluations": 12,
    "contact_wrench": ((0.0, -3.0, 0.0), (0.0, 0.0, -0.015)),
    "normal_y": 1.0,
}


def contact(**fields):
    """An answer with some fields given."""
    rows = blank_answers(1)
    for name, value in (EXAMPLE | fields).items():
        rows[name] = value
    return rows[0]


def contacts_of(numbers):
    """Answers whose floating-point numbers are drawn from these."""
    triples = st.tuples(numbers, numbers, numbers)
    return st.fixed_dictionaries(
        dict.fromkeys(FIELDS, numbers)
        | {"contact_point": triples, "contact_wrench": st.tuples(triples, triples)}
        | {name: st.integers(0, 255) for name in ("contact_state", "fidelity", "status")}
        | {"evaluations": st.integers(0, 2**32 - 1)}
    ).map(lambda fields: contact(**fields))


def rows_of(answers):
    """The rows of answers, shape (n,)."""
    return np.frombuffer(b"".join(row for answer in answers for row in answer.rows), ROW).view(
        np.recarray
    )


def same(one, other):
    """Whether all numbers of answers are alike; what is not a number is like itself."""
    names = FLAT.names or ()
    return all(
        np.array_equal(one.view(FLAT)[name], other.view(FLAT)[name], equal_nan=True)
        for name in names
    )


def answers_to(pipeline, messages):
    """The answers to messages, which have a topic and bytes (`data`), one by one."""
    for message in messages:
        is_angle = message.topic == f"/{JOINT_STATES}"
        push = pipeline.push_joint_state if is_angle else pipeline.push_force
        yield from push(message.data)
