"""Search for a topic in a bag, with a helpful message if it is missing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from knee_contact_ros.bags.stored_bag import Connection
from knee_contact_ros.bags.topic_names import absolute
from knee_contact_ros.streams.topics import (
    GROUND_REACTION_FORCE,
    INPUTS,
    JOINT_REACTION_FORCE,
    LOAD_INPUTS,
    MESSAGE_TYPES,
)
from knee_contact_ros.system.errors import UsageError, listed

OTHER_FORCE = {
    JOINT_REACTION_FORCE: (GROUND_REACTION_FORCE, "knee-contact estimate-load makes joint reaction forces of its"),
    GROUND_REACTION_FORCE: (JOINT_REACTION_FORCE, "knee-contact solve takes, and replay without --sensors, its"),
}
"""Other input of the same type, by the name of a force that it must not be taken for, and the advice for it"""


def find_topic(bag: Path, connections: Sequence[Connection], topic: str, type_name: str, name: str) -> list[Connection]:
    """Connections of a topic in a bag; recorders with several publishers, and merged files, may have several.

    Args:
        bag: Path of the bag, for messages.
        connections: Connections of the bag.
        topic: Absolute name of the topic in the node.
        type_name: Type that the topic must have.
        name: Absolute name of the topic in the bag.

    Raises:
        UsageError: The topic is missing or empty, has another type or several, or is not encoded as CDR.
    """
    of_name = [connection for connection in connections if absolute(connection.topic) == name]
    if not of_name:
        raise UsageError(f"bag {bag} has no topic {name} ({type_name}); {_advice(connections, topic)}")
    filled = [connection for connection in of_name if connection.messages]
    types = sorted({connection.type for connection in filled or of_name})
    if types != [type_name]:
        fault = f"is a {types[0]}" if len(types) == 1 else f"has {len(types)} types, {' and '.join(types)}"
        raise UsageError(f"bag {bag}: topic {name} {fault}; it must be a {type_name}")
    if not filled:
        raise UsageError(f"bag {bag}: topic {name} has no messages")
    for connection in filled:
        if connection.encoding != "cdr":
            raise UsageError(
                f"bag {bag}: topic {name} is encoded as {connection.encoding or 'nothing'}; it must be cdr"
            )
    return filled


def _advice(connections: Sequence[Connection], topic: str) -> str:
    """Advice for a topic that is missing under its name: an option to give, or the topics of the bag."""
    types = {absolute(connection.topic): connection.type for connection in connections}
    own = topic.removeprefix("/")
    for inputs in (INPUTS, LOAD_INPUTS):
        if own in inputs and (spaces := namespaces(types, inputs)):
            return f"it has inputs in the namespaces {listed(spaces)}: say --namespace {spaces[0]}"
    same_type = sorted(name for name, type_name in types.items() if type_name == MESSAGE_TYPES.get(own))
    if own in (*INPUTS, *LOAD_INPUTS) and topic not in same_type:
        other_topics = tuple(f"/{known}" for known in MESSAGE_TYPES if known != own)
        candidates = [name for name in same_type if not name.endswith(other_topics)]
        if candidates:
            return f"of this type it has {listed(candidates)}: say --remap {own}:={candidates[0]}"
        other, advice = OTHER_FORCE.get(own, ("", ""))
        if others := [name for name in same_type if name.endswith(f"/{other}")]:
            return f"{advice} {others[0]}"
    return f"its topics: {listed(sorted(types)) or 'none'}"


def namespaces(types: Mapping[str, str], inputs: Sequence[str]) -> list[str]:
    """Namespaces, without slashes at the ends, in which all inputs have the right types.

    Args:
        types: Type of each topic of a bag, by its absolute name.
        inputs: Relative names of the inputs.
    """
    first = f"/{inputs[0]}"
    candidates = sorted(name.removesuffix(first).strip("/") for name in types if name.endswith(first))
    return [
        space
        for space in candidates
        if space and all(types.get(absolute(topic, space)) == MESSAGE_TYPES[topic] for topic in inputs)
    ]
