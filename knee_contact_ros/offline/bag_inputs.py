"""Inputs of a bag for the pipelines, from the topics and types that the parameters name."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
from rosbags.typesys.store import Typestore

from ..bags.bag import Bag
from ..bags.bag_file import Batch
from ..bags.names import NAMESPACE, Names, absolute
from ..parameters.load_schema import LoadParameters
from ..parameters.schema import Parameters
from ..parameters.sources import TopicSource
from ..streams.conversion import converters, store_of
from ..streams.frames import (
    MOST_MOVING,
    TF_MESSAGE,
    TF_MOVING,
    TF_STATIC,
    ForceFrame,
    decode_transforms,
)
from ..streams.messages import JOINT_STATE, RefusedSampleError
from ..streams.topics import JOINT_STATES
from ..system.errors import UsageError, list_names
from ..system.terminal import warn

READ_AHEAD = 256
"""Number of messages that are read at a time to search for a joint"""


def as_recorded(parameters: Any) -> Any:
    """Return the parameters with the usual inputs, which a recording of a node has instead of the node's sources."""
    section, topics = (
        parameters.force_source.split(".")[0],
        [JOINT_STATES, parameters.usual_forces],
    )
    sections = {name: getattr(parameters, name) for name in ("knee", section)}
    pairs = zip(sections.items(), topics, strict=True)
    update = {n: part.model_copy(update={"source": topic}) for (n, part), topic in pairs}
    if parameters.thigh():
        update["orientations"] = type(parameters.orientations)()
    return parameters.model_copy(update=update)


class BagInputs:
    """Angles and forces in an open bag that a node's parameters name."""

    def __init__(
        self,
        bag: Bag,
        parameters: Parameters | LoadParameters,
        names: Names,
        has_state: bool = False,
    ) -> None:
        """Find the inputs in a bag; `names` are their names in it.

        With a state of the run before (`has_state`), all of its forces may be answered by the angle in that state.
        A recording of a node has the usual inputs, whatever the node's sources were; then the usual ones are read.

        Raises:
            UsageError: the bag cannot be used, or lacks a topic, a type or a field; see `Bag.select` and `Converter`.
        """
        usual = as_recorded(parameters)
        if usual.inputs() != parameters.inputs() and bag.is_recording:
            parameters = usual
        self.bag = bag
        self._orientations: Any = None  # those that were joined last
        self._parameters = parameters
        sources = [*parameters.inputs(), *filter(None, [parameters.thigh()])]
        self.topic = sources[0].topic
        """Topic of the angles"""
        self._topics = [absolute(source.topic) for source in sources]
        namespace = names.get(NAMESPACE, "")
        places = {
            topic: absolute(one.topic, namespace)
            for topic, one in zip(self._topics, sources, strict=True)
        }
        types = {topic: one.type for topic, one in zip(self._topics, sources, strict=True)}
        self._reader = bag.select(types, {**places, **names}, self._topics[0] if has_state else "")
        converters(parameters, self._types)

    def batches_of(self, size: int, only: int | None = None) -> Iterator[Batch]:
        """Yield batches of at most `size` messages in the order of arrival, as the pipelines take them.

        Messages of number 0 are angles, as JointStates; those of number 1 are forces, as WrenchStampeds. `only` is the
        number to read; None means both.
        """
        if isinstance(self._parameters, Parameters) and self._parameters.thigh():
            from ..streams.orientations import OrientationJoin

            self._orientations = OrientationJoin(self._parameters)
        convert = converters(self._parameters, self._types, self._orientations)
        topics = self._topics if only is None else [self._topics[only], *self._topics[2:]]
        for read in self._reader.batches_of(size, topics):
            batch = read
            if self._topics[0] == self._topics[1]:  # a message has both
                count = len(read)
                twice = read.select(np.repeat(np.arange(count), 2))
                batch = replace(twice, numbers=np.tile([0, 1], count))
                if only is not None:
                    batch = batch.select(np.flatnonzero(batch.numbers == only))
            yield batch.converted(convert) if any(convert) else batch

    @property
    def orientation_doubt(self) -> str:
        """Sentence about the orientations of thigh and shank that were read; empty without one."""
        return self._orientations.knee.doubt if self._orientations else ""

    @property
    def message_count(self) -> int:
        """Number of angles and forces in the bag."""
        return self._reader.message_count

    @property
    def force_count(self) -> int:
        """Number of forces."""
        return self._reader.count_messages(self._topics[1])

    def publishers(self) -> list[str]:
        """Return the channels of the angles and of the forces, as words; empty where there is only one."""
        words = []
        for topic in self._topics[:2]:
            ids = self._reader.channel_ids(topic)
            words.append(
                f"channels {' and '.join(map(str, ids))} of the bag" if len(ids) > 1 else ""
            )
        return words

    def check_joints(self, wanted: Mapping[str, str]) -> None:
        """Refuse a bag that lacks one of the joints `wanted`, given by parameter (`joints` of the parameters).

        Usually the first sample has all joints, so that the rest of the bag is not read.

        Raises:
            UsageError: no sample has one of the joints; the message lists those of the bag.
        """
        joints: dict[str, None] = {}  # a set that keeps the order
        for batch in self.batches_of(READ_AHEAD, only=0):
            for _, _, data in batch:
                with suppress(RefusedSampleError):
                    joints |= dict.fromkeys(JOINT_STATE.read_message(data, JOINT_STATES)[0].name)
                if joints.keys() >= set(wanted.values()):
                    return
        for parameter, joint in wanted.items():
            if joints and joint not in joints:
                known = list_names(list(joints))
                raise UsageError(
                    f"bag {self.bag}: {self.topic} has no joint {joint!r}; it has {known} (parameter {parameter})"
                )

    def learn_transforms(self, frame: ForceFrame) -> None:
        """Add all static transforms of the bag to a frame; warn of those that cannot be used."""
        for data in transform_messages(self.bag):
            try:
                problems = frame.add_transforms(decode_transforms(data))
            except ValueError as error:
                problems = [str(error)]
            warn(f"{TF_STATIC} of {self.bag}: {problem}" for problem in problems)
        for data in transform_messages(self.bag, TF_MOVING, MOST_MOVING):
            with suppress(ValueError):
                frame.note_moving(decode_transforms(data))

    def _types(self, source: TopicSource, by: str) -> Typestore:
        try:
            return store_of(self._reader.definition_of(absolute(source.topic)), source.type)
        except Exception as error:  # whatever a foreign definition provokes
            reason = " ".join(str(error).split())
            raise UsageError(
                f"bag {self.bag}: parameter {by}: {source.type} is not defined in it: {reason}"
            ) from None


def transform_messages(bag: Bag, topic: str = TF_STATIC, most: int | None = None) -> list[bytes]:
    """Return the first `most` messages of a topic of transforms, as bytes; none if the bag has no such topic."""
    with suppress(UsageError):
        messages = bag.select({topic: TF_MESSAGE}).raw_messages()
        return [message.data for message in islice(messages, most)]
    return []
