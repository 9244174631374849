"""A leg's sensors for tests of its pipeline, and what they make possible."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import pytest

from knee_contact_ros.bags.reader import RawMessage
from knee_contact_ros.joint_reaction.estimator import Estimate
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import LoadParameters
from knee_contact_ros.streams.load_stream import LoadStream
from knee_contact_ros.streams.messages import JointState, WrenchStamped, encode_joint_state, encode_wrench_stamped
from knee_contact_ros.streams.topics import Answer
from tests.helpers.walking import ANGLES, FORCE, MS, WHOLE_LEG, ground

POSE = {"hip": 0.3, "knee": 0.5, "ankle": 0.1}


def pipeline(values: Any = None) -> LoadStream:
    return LoadStream(load_parameters(WHOLE_LEG if values is None else values, LoadParameters))


def take(pipe: LoadStream, messages: Iterable[RawMessage]) -> list[tuple[Answer, Estimate]]:
    """What they make possible."""
    found = []
    for message in messages:
        for answer in (pipe.joint_state if message.topic == ANGLES else pipe.force)(message.data):
            assert pipe.estimate
            found.append((answer, pipe.estimate))
    return found


def by_stamp(found: Iterable[tuple[Answer, Estimate]]) -> dict[int, Estimate]:
    return {answer.records[-1][1]: estimate for answer, estimate in found}


def estimates(pipe: LoadStream, messages: Iterable[RawMessage]) -> list[Estimate]:
    found = [estimate for _, estimate in take(pipe, messages)]
    for _ in pipe.finish():
        assert pipe.estimate
        found.append(pipe.estimate)
    return found


def state(stamp: int, efforts: tuple[float, ...] = (), **positions: float) -> RawMessage:
    told = JointState(stamp, "", tuple(positions), tuple(positions.values()), (), efforts)
    return RawMessage(ANGLES, stamp, encode_joint_state(told))


def force(stamp: int, wrench: WrenchStamped | None = None, **parts: Any) -> RawMessage:
    told = (wrench or ground(275 * MS))._replace(stamp=stamp, **parts)
    return RawMessage(FORCE, stamp, encode_wrench_stamped(told))


def once(values: Any, efforts: tuple[float, ...] = (), **parts: Any) -> Estimate:
    """The estimate for one pose and one force."""
    (found,) = estimates(pipeline(values), [state(0, efforts, **POSE), force(0, **parts)])
    return found


def same(one: Estimate, other: Estimate, within: float = 0.0) -> bool:
    """Whether two estimates are alike; what is not a number is like itself."""
    return all(a == pytest.approx(b, abs=within, rel=0.0, nan_ok=True) for a, b in zip(one, other, strict=True))
