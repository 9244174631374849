"""Names of topics in a bag, which may differ from those in the node."""

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType

from ..parameters.sources import DYNAMIC_JOINT_STATES
from ..streams.topics import INPUTS
from ..system.errors import UsageError
from ..system.files import split_rule

Names = Mapping[str, str]
"""Absolute names of topics in a bag, by their absolute names in the node"""
OWN_NAMES: Names = MappingProxyType({})
"""Names for a bag in which each topic has its name in the node"""
NAMESPACE = ""
"""Key in `Names` of the namespace of relative names"""


def absolute(name: str, namespace: str = "") -> str:
    """Return the absolute name of a topic in a namespace; some recorders omit the first slash of an absolute name."""
    return name if name.startswith("/") else f"/{namespace.strip('/')}/{name}".replace("//", "/")


def only_namespace(topics: Iterable[str], inputs: Sequence[str] = INPUTS) -> str:
    """Return the only namespace in which a bag with these topics has the inputs; empty if there is none, or no need."""
    found = [
        {topic.removesuffix(f"/{name}") for topic in topics if topic.endswith(f"/{name}")}
        for name in inputs
    ]
    spaces = set.intersection(*found)
    return (
        spaces.pop().strip("/")
        if len(spaces) == 1 and not any("" in each for each in found)
        else ""
    )


def names_in_bag(
    remaps: Iterable[str] = (), namespace: str = "", inputs: Sequence[str] = INPUTS
) -> Names:
    """Return the names in a bag according to the options `--remap FROM:=TO` and `--namespace`.

    Args:
        remaps: Rules `FROM:=TO`; FROM is the name of an input in the node, TO its name in the bag.
        namespace: Namespace of relative names in the bag.
        inputs: Relative names of the inputs in the node.

    Raises:
        UsageError: A rule is malformed, its FROM is not an input or is repeated, or two inputs get the same name.
    """
    if namespace and not namespace.strip("/"):
        raise UsageError(f"--namespace {namespace!r}: it must be a name, such as left")
    names = {f"/{topic}": absolute(topic, namespace) for topic in (*inputs, DYNAMIC_JOINT_STATES)}
    if namespace:
        names[NAMESPACE] = namespace
    remapped = set()
    for rule in remaps:
        source, target = split_rule(rule, "--remap")
        topic = absolute(source)
        if topic not in names:
            allowed = " or ".join(inputs)
            raise UsageError(
                f"--remap {rule!r}: FROM must be {allowed}, the input; TO is its name in the bag"
            )
        if topic in remapped:
            raise UsageError(f"--remap {rule!r}: {source} is remapped twice")
        remapped.add(topic)
        names[topic] = absolute(target, namespace)
    if len(set(names.values())) < len(names):
        raise UsageError(f"--remap: two inputs cannot both be {names[topic]}")
    return names
