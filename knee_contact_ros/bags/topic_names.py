"""Names of the inputs in a bag: those of the node, remapped ones, or those in a namespace."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

from knee_contact_ros.streams.topics import DYNAMIC_JOINT_STATES, INPUTS
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.files import split

Names = Mapping[str, str]
"""Absolute names of topics in a bag, by their absolute names in the node"""
OWN_NAMES: Names = MappingProxyType({})
"""Names for a bag in which each topic has its name in the node"""


def absolute(name: str, namespace: str = "") -> str:
    """Absolute name of a topic in a namespace; some recorders omit the first slash of an absolute name."""
    return name if name.startswith("/") else f"/{namespace.strip('/')}/{name}".replace("//", "/")


def names_in_bag(remaps: Iterable[str] = (), namespace: str = "", inputs: Sequence[str] = INPUTS) -> Names:
    """Names in a bag according to the options `--remap FROM:=TO` and `--namespace`.

    Args:
        remaps: Rules `FROM:=TO`; FROM is the name of an input in the node, TO its name in the bag.
        namespace: Namespace of relative names in the bag.
        inputs: Relative names of the inputs in the node.

    Raises:
        UsageError: A rule is malformed, its FROM is no input or is repeated, or two inputs get the same name.
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
    """Message for a rule whose `source` is no input."""
    allowed = " or ".join(inputs)
    if absolute(target).removeprefix("/") in inputs:
        return f"--remap {rule!r}: the node's name comes first; say {target.removeprefix('/')}:={source}"
    return f"--remap {rule!r}: {source} is no input; FROM must be {allowed}, TO is the bag's topic"
