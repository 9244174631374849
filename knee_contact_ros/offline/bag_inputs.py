"""The inputs in a bag, as the pipelines take them; its angles may be those of ros2_control."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from knee_contact_ros.bags.columns import Batch
from knee_contact_ros.bags.reader import BagReader, Names, RawMessage
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.streams.frames import TF_MESSAGE, TF_STATIC, ForceFrame, decode_transforms
from knee_contact_ros.streams.messages import JOINT_STATE, RefusedSampleError, as_joint_state
from knee_contact_ros.streams.topics import (
    DYNAMIC_JOINT_STATE,
    DYNAMIC_JOINT_STATES,
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    MESSAGE_TYPES,
)
from knee_contact_ros.system.errors import UsageError, listed
from knee_contact_ros.system.terminal import warn

READ_AHEAD = 256
"""Number of messages that are read at once where they are wanted one by one"""


class BagInputs:
    """An open bag with forces, and with angles of one source."""

    def __init__(self, bag: Path, source: str, names: Names, force_topic: str = JOINT_REACTION_FORCE) -> None:
        """Open a bag; `source` is the parameter `knee.source`, `names` are the names of the inputs in the bag.

        Raises:
            UsageError: the bag cannot be used, or lacks a topic; see `BagReader`.
        """
        kind = {JOINT_STATES: MESSAGE_TYPES[JOINT_STATES], DYNAMIC_JOINT_STATES: DYNAMIC_JOINT_STATE}[source]
        types = {f"/{source}": kind, f"/{force_topic}": MESSAGE_TYPES[force_topic]}
        self.path = bag
        self.reader = BagReader(bag, types, names)
        self.source, self.force = source, f"/{force_topic}"

    def __enter__(self) -> BagInputs:
        return self

    def __exit__(self, *_: object) -> None:
        self.reader.close()

    def blocks(self, most: int, topics: Collection[str] = ()) -> Iterator[Batch]:
        """Yield blocks of at most `most` messages in the order of log time.

        Messages of number 0 are angles, as JointStates; those of number 1 are forces.
        """
        for batch in self.reader.blocks(topics, most=most):
            angles = batch.numbers == 0
            yield batch.changed(as_joint_state, angles) if self.source == DYNAMIC_JOINT_STATES else batch

    def messages(self, topics: Collection[str] = ()) -> Iterator[RawMessage]:
        """Yield messages one by one in the order of log time, of some `topics` or of both; angles are JointStates."""
        names = (f"/{JOINT_STATES}", self.force)
        for batch in self.blocks(READ_AHEAD, topics):
            for number, time, data in batch:
                yield RawMessage(names[number], time, data)


def wanted_joints(parameters: Parameters) -> dict[str, str]:
    """Return the names of the joints that the contact node needs, by the parameters that give them."""
    wanted = {"knee.joint_name": parameters.knee.joint_name}
    if parameters.drive == "displacement":
        wanted["knee.height_joint_name"] = parameters.knee.height_joint_name
    return wanted


def check_joints(bag: BagInputs, wanted: Mapping[str, str]) -> None:
    """Refuse a bag that lacks one of the joints `wanted`, which are given by parameter.

    As a rule the first sample has all joints, so that the bag is not read as a whole.

    Raises:
        UsageError: no sample has one of the joints; the message lists those of the bag.
    """
    joints: dict[str, None] = {}  # a set that keeps the order
    for message in bag.messages((f"/{bag.source}",)):
        try:
            names = JOINT_STATE.read(message.data, JOINT_STATES)[0].name
        except RefusedSampleError:
            continue
        joints |= dict.fromkeys(names)
        if joints.keys() >= set(wanted.values()):
            return
    for parameter, joint in wanted.items():
        if joints and joint not in joints:
            known = listed(list(joints))
            text = f"{bag.source} has no joint {joint!r}; it has {known} (parameter {parameter})"
            raise UsageError(f"bag {bag.path}: {text}")


def transform_messages(bag: Path) -> list[bytes]:
    """Return the messages of `/tf_static` in a bag, as bytes; none if it has no topic of that name and type."""
    with suppress(UsageError), BagReader(bag, {TF_STATIC: TF_MESSAGE}) as reader:
        return [message.data for message in reader.raw_messages()]
    return []


def learn_transforms(bag: Path, frame: ForceFrame) -> None:
    """Give a frame all static transforms of a bag; warn of transforms that cannot be used."""
    for data in transform_messages(bag):
        try:
            problems = frame.learn(decode_transforms(data))
        except ValueError as error:
            problems = [str(error)]
        warn(f"{TF_STATIC} of {bag}: {problem}" for problem in problems)
