"""Find a topic among those of a bag, or say in one line what is there instead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from knee_contact_ros.bags.stored_bag import Connection
from knee_contact_ros.bags.topic_names import absolute
from knee_contact_ros.messages.topics import (
    GROUND_REACTION_FORCE,
    INPUTS,
    JOINT_REACTION_FORCE,
    LOAD_INPUTS,
    MESSAGE_TYPES,
)
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.printable import listed

OTHER_FORCE = {
    JOINT_REACTION_FORCE: (GROUND_REACTION_FORCE, "knee-contact estimate-load makes joint reaction forces of its"),
    GROUND_REACTION_FORCE: (JOINT_REACTION_FORCE, "knee-contact solve takes, and replay without --sensors, its"),
}
"""The other input that has a force's type, but must not be taken for it; and what to do with it"""


def find_topic(bag: Path, connections: Sequence[Connection], topic: str, type_name: str, name: str) -> list[Connection]:
    """All connections of a topic of ours that has the absolute name `name` in the bag.

    Recorders that met several publishers, and merged files, may have several.

    Raises:
        UsageError: the topic is missing or empty, has another type or a second one, or is not encoded as CDR.
    """
    found = [connection for connection in connections if absolute(connection.topic) == name]
    if not found:
        raise UsageError(f"bag {bag} has no topic {name} ({type_name}); {ways_out(connections, topic)}")
    found = [connection for connection in found if connection.messages] or found
    types = sorted({connection.type for connection in found})
    if types != [type_name]:
        there = f"is a {types[0]}" if len(types) == 1 else f"has {len(types)} types, {' and '.join(types)}"
        raise UsageError(f"bag {bag}: topic {name} {there}; it must be a {type_name}")
    if not any(connection.messages for connection in found):
        raise UsageError(f"bag {bag}: topic {name} has no messages")
    for connection in found:
        if connection.encoding != "cdr":
            raise UsageError(
                f"bag {bag}: topic {name} is encoded as {connection.encoding or 'nothing'}; it must be cdr"
            )
    return found


def ways_out(connections: Sequence[Connection], topic: str) -> str:
    """What to type to get an input that is not there under its name, or what else the bag has."""
    there = {absolute(connection.topic): connection.type for connection in connections}
    own = topic.removeprefix("/")
    for inputs in (INPUTS, LOAD_INPUTS):
        if own in inputs and (spaces := namespaces(there, inputs)):
            return f"it has inputs in the namespaces {listed(spaces)}: say --namespace {spaces[0]}"
    alike = sorted(name for name, type_there in there.items() if type_there == MESSAGE_TYPES.get(own))
    if own in (*INPUTS, *LOAD_INPUTS) and topic not in alike:
        not_this = tuple(f"/{known}" for known in MESSAGE_TYPES if known != own)
        fitting = [name for name in alike if not name.endswith(not_this)]
        if fitting:
            return f"of this type it has {listed(fitting)}: say --remap {own}:={fitting[0]}"
        other, way_out = OTHER_FORCE.get(own, ("", ""))
        if others := [name for name in alike if name.endswith(f"/{other}")]:
            return f"{way_out} {others[0]}"
    return f"its topics: {listed(sorted(there)) or 'none'}"


def namespaces(there: Mapping[str, str], inputs: Sequence[str]) -> list[str]:
    """Namespaces, without slashes at the ends, in which all inputs are with their types."""
    first = f"/{inputs[0]}"
    candidates = sorted(name.removesuffix(first).strip("/") for name in there if name.endswith(first))
    return [
        space
        for space in candidates
        if space and all(there.get(absolute(topic, space)) == MESSAGE_TYPES[topic] for topic in inputs)
    ]
