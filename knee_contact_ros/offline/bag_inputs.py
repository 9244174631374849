"""The inputs in a bag, as the pipeline takes them: its angles may be those of ros2_control."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from pathlib import Path

from knee_contact_ros.bags.batch import Batch
from knee_contact_ros.bags.reader import BagReader, RawMessage
from knee_contact_ros.bags.topic_names import Names
from knee_contact_ros.messages.dynamic_joint_states import as_joint_state
from knee_contact_ros.messages.ros_types import deserialize
from knee_contact_ros.messages.topics import (
    DYNAMIC_JOINT_STATE,
    DYNAMIC_JOINT_STATES,
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    MESSAGE_TYPES,
)
from knee_contact_ros.messages.transforms import TF_MESSAGE, TF_STATIC, decode_transforms
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.frames import ForceFrame
from knee_contact_ros.pipeline.samples import Decoder, RefusedSampleError
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.printable import listed
from knee_contact_ros.system.terminal import warn

FEW = 256
"""Messages that are read ahead"""


class BagInputs:
    """A bag that is known to hold forces, and angles of one source."""

    def __init__(self, bag: Path, source: str, names: Names, force_topic: str = JOINT_REACTION_FORCE) -> None:
        """Open a bag; `source` is `knee.source`, `names` are those of the inputs in it.

        Raises:
            UsageError: as `BagReader`.
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
        """Messages in the order of log time, by so many: 0 has angles, as JointStates, and 1 forces."""
        for batch in self.reader.blocks(topics, most=most):
            angles = batch.numbers == 0
            yield batch.changed(as_joint_state, angles) if self.source == DYNAMIC_JOINT_STATES else batch

    def messages(self) -> Iterator[RawMessage]:
        """All of both topics, in the order of log time; angles are JointStates."""
        return self._one_by_one(())

    def angles(self) -> Iterator[RawMessage]:
        """Those with angles, likewise."""
        return self._one_by_one((f"/{self.source}",))

    def _one_by_one(self, topics: Collection[str]) -> Iterator[RawMessage]:
        names = (f"/{JOINT_STATES}", self.force)
        for batch in self.blocks(FEW, topics):
            for number, time, data in batch:
                yield RawMessage(names[number], time, data)


def wanted_joints(parameters: Parameters) -> dict[str, str]:
    """Joints that the contact node needs, by the parameters that name them."""
    wanted = {"knee.joint_name": parameters.knee.joint_name}
    if parameters.drive == "displacement":
        wanted["knee.height_joint_name"] = parameters.knee.height_joint_name
    return wanted


def check_joints(bag: BagInputs, wanted: Mapping[str, str]) -> None:
    """Look for the first sample with the joints that are wanted, by the parameters that name them.

    As a rule that is the first of the bag.

    Raises:
        UsageError: no sample has one of them; lists the joints of the bag.
    """
    decoder = Decoder(deserialize)
    found: dict[str, None] = {}  # a set that keeps the order
    for message in bag.angles():
        try:
            names = decoder.joint_state(message.data)[0].name
        except RefusedSampleError:
            continue
        found |= dict.fromkeys(names)
        if found.keys() >= set(wanted.values()):
            return
    for parameter, joint in wanted.items():
        if found and joint not in found:
            known = listed(list(found))
            text = f"{bag.source} has no joint {joint!r}; it has {known} (parameter {parameter})"
            raise UsageError(f"bag {bag.path}: {text}")


def transform_messages(bag: Path) -> list[bytes]:
    """What a bag holds of `/tf_static`; nothing if it has no such topic, or another by that name."""
    with suppress(UsageError), BagReader(bag, {TF_STATIC: TF_MESSAGE}) as reader:
        return [message.data for message in reader.raw_messages()]
    return []


def learn_transforms(bag: Path, frame: ForceFrame) -> None:
    """Learn all static transforms that a bag holds, and tell of those that make no sense."""
    for data in transform_messages(bag):
        try:
            problems = frame.learn(decode_transforms(data))
        except ValueError as error:
            problems = [str(error)]
        warn(f"{TF_STATIC} of {bag}: {problem}" for problem in problems)
