"""The names that our inputs have in a bag: their own, remapped ones, or those in a namespace."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

from knee_contact_ros.messages.topics import DYNAMIC_JOINT_STATES, INPUTS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.ros_arguments import split

Names = Mapping[str, str]
"""Absolute name of a topic, as the node has it, to its absolute name in a bag"""
OWN_NAMES: Names = MappingProxyType({})
"""Every topic has its own name"""


def absolute(name: str, namespace: str = "") -> str:
    """A name as it is seen from a namespace; recorders of other origin leave the first slash out."""
    return name if name.startswith("/") else f"/{namespace.strip('/')}/{name}".replace("//", "/")


def names_in_bag(remaps: Iterable[str] = (), namespace: str = "", inputs: Sequence[str] = INPUTS) -> Names:
    """What `--remap FROM:=TO` and `--namespace` say: FROM is the node's topic, one of its `inputs`, TO the bag's.

    Raises:
        UsageError: a rule that is none, FROM is no input or given twice, or two inputs have one name.
    """
    if namespace and not namespace.strip("/"):
        raise UsageError(f"--namespace {namespace!r}: it must be a name, as left")
    names = {f"/{topic}": absolute(topic, namespace) for topic in (*inputs, DYNAMIC_JOINT_STATES)}
    remapped = set()
    for rule in remaps:
        source, target = split(rule, "--remap")
        topic = absolute(source)
        if topic not in names:
            raise UsageError(_unknown(rule, source, target, inputs))
        if topic in remapped:
            raise UsageError(f"--remap {rule!r}: {source} is remapped twice")
        remapped.add(topic)
        names[topic] = absolute(target, namespace)
    if len(set(names.values())) < len(names):
        raise UsageError(f"--remap: two inputs cannot both be {names[topic]}")
    return names


def _unknown(rule: str, source: str, target: str, inputs: Sequence[str]) -> str:
    allowed = " or ".join(inputs)
    if absolute(target).removeprefix("/") in inputs:
        return f"--remap {rule!r}: the node's name comes first; say {target.removeprefix('/')}:={source}"
    return f"--remap {rule!r}: {source} is no input; FROM must be {allowed}, TO is the bag's topic"
