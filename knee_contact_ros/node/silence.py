"""Why an input is silent, and the line to write: another type on its topic, a misspelt name, two swapped topics."""

from collections.abc import Collection, Iterator, Mapping
from fnmatch import fnmatchcase
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from ..parameters.sources import ON_ARRIVAL, TopicSource
from ..streams.columns import FIXED
from ..system.errors import UsageError, list_names, suggest
from .inputs import installed_types

Graph = Mapping[str, Collection[str]]
"""Types by topic, of the topics that other nodes publish"""
MOST_DEEP = 3
"""Largest depth of a field whose path is named"""
NO_MEASUREMENTS = ("header", "stamp", "covariance")
"""Fields without a measured number"""


def published_by_others(node: Any) -> dict[str, set[str]]:
    """Find the topics that other nodes publish, with their types."""
    own = node.get_name(), node.get_namespace()
    return {
        topic: {
            each.topic_type
            for each in node.get_publishers_info_by_topic(topic)
            if (each.node_name, each.node_namespace) != own
        }
        for topic, _ in node.get_topic_names_and_types()
    }


def reason_of_silence(
    by: str, source: TopicSource, name: str, other_type: str, wanted: int, graph: Graph
) -> str:
    """Say why nothing comes from a source, and what to write; empty if the graph shows no reason.

    Args:
        by: Parameter of the source.
        source: The source.
        name: Absolute name of its topic, in which `*` matches any text.
        other_type: Type of the messages of the node's other input.
        wanted: Number of fields that a source of another type needs; 0 for a force, which may have one, three or six.
        graph: What other nodes publish.
    """
    there = sorted({kind for topic in graph if fnmatchcase(topic, name) for kind in graph[topic]})
    if source.type in there:
        return ""
    if other_type in there:
        return (
            f"{other_type} is published there, the type of the other input: are the two swapped?"
        )
    if there:
        line = line_of(by, source.topic, there[0], wanted)
        return f"{there[0]} is published there, and not {source.type}; {line}"
    return f"nobody publishes it; {_other_topic(by, source.type, name, graph)}"


def _other_topic(by: str, kind: str, name: str, graph: Graph) -> str:
    """Say which other topic may be meant; see `reason_of_silence`."""
    right = [topic for topic, types in graph.items() if kind in types]
    if len(right) == 1:
        return f"{kind} is on {right[0]}: write {by}: {right[0]}"
    if right:
        return suggest(name, right, f"{kind} is on {list_names(sorted(right))}", cutoff=0.5)
    topics = [topic for topic, types in graph.items() if types]
    if not topics:
        return "no other node publishes anything there"
    return suggest(name, topics, "and nobody publishes that type", cutoff=0.75)


def line_of(by: str, topic: str, kind: str, wanted: int) -> str:
    """Say which line takes messages of another type; see `reason_of_silence`."""
    package, _, name = kind.split("/")
    source = TopicSource(topic, kind, (), on_arrival=False)
    try:
        store = installed_types(source, by)
    except UsageError:
        return f"and the ROS 2 package {package} is not installed here"
    names = {field for field, _ in store.fielddefs[kind][1]}
    arrival = "" if names & {"header", "stamp"} else f" {ON_ARRIVAL}"
    paths = list(numbers_in(store, kind))
    fields = chosen_fields(paths, wanted)
    if fields:
        return f"write {by}: {topic} {package}/{name} {', '.join(fields)}{arrival}"
    if not paths:
        return "and that type has no number"
    return (
        f"write {by}: {topic} {package}/{name} FIELD{arrival}, with one of {list_names(paths)}, "
        "or another number"
    )


def chosen_fields(paths: list[str], wanted: int) -> list[str]:
    """Choose the fields among paths, if there is no doubt; see `reason_of_silence`."""
    ends = [path.rpartition(".")[2] for path in paths]
    is_vector = ends in (["x", "y", "z"], ["x", "y", "z"] * 2)
    return paths if len(paths) == (wanted or 1) or (is_vector and not wanted) else []


def numbers_in(store: Typestore, kind: str, before: str = "", depth: int = 0) -> Iterator[str]:
    """Yield the paths of the numbers in a type; of a list that of its first element."""
    fields: Any = store.fielddefs[kind][1]
    for name, (form, detail) in fields:
        if name.startswith(NO_MEASUREMENTS) or name.endswith(NO_MEASUREMENTS):
            continue
        path = before + name
        if form in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            (form, detail), path = detail[0], f"{path}[0]"  # noqa: PLW2901
        if form is Nodetype.BASE and detail[0] in FIXED:
            yield path
        elif form is Nodetype.NAME and depth < MOST_DEEP and detail in store.fielddefs:
            yield from numbers_in(store, detail, f"{path}.", depth + 1)
