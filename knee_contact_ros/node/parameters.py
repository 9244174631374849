"""Kinds of nodes, and their ROS 2 parameters: overrides, declarations with descriptions, changes at run time, QoS.

rclpy ignores QoS overrides that do not fit; here they are refused.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, ReliabilityPolicy

from knee_contact_ros.parameters.files import all_values, known_parameters, load_parameters
from knee_contact_ros.parameters.schema import Declaration, NodeSection
from knee_contact_ros.system.errors import UsageError

if TYPE_CHECKING:
    from knee_contact_ros.node.session import Session


class Topics(NamedTuple):
    """Topics whose QoS a user may override."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


class NodeKind(NamedTuple):
    """Kind of node; what all kinds have in common is in `managed_node.py` and `session.py`."""

    schema: type[NodeSection]
    """Name of the node, and its parameters"""
    live: frozenset[str]
    """Names of the parameters that may change while the node is configured: they take effect between two ticks"""
    topics: Topics
    session: Callable[[LifecycleNode, Any, Collection[str]], Session]
    """Makes the session of a node from its parameters and the names of the QoS overrides that the user has given"""


LARGEST_INTEGER = 2**63 - 1
"""Largest integer that a parameter can hold"""
PREFIX = "qos_overrides."
STANDARD_TOPICS = ("/clock.", "/parameter_events.", "/rosout.")
"""Topics of every ROS 2 node, whose overrides are not checked here"""
LARGEST_DEPTH = 2**31 - 1
"""Largest depth that the middleware can hold"""
POLICIES = {
    policy: tuple(member.name.lower() for member in members if member.name != "UNKNOWN")
    for policy, members in (("history", HistoryPolicy), ("reliability", ReliabilityPolicy))
}
"""Allowed values of the QoS policies that may be overridden beside `depth`"""


def described(name: str, declaration: Declaration) -> ParameterDescriptor:
    """Descriptor of a parameter for ROS 2 tools: its meaning, and its range or what is allowed."""
    limits = declaration.limits
    descriptor = ParameterDescriptor(name=name, description=declaration.description, dynamic_typing=True)
    descriptor.additional_constraints = f"allowed: {limits.words}" if limits.words else ""
    if isinstance(declaration.default, float):
        descriptor.floating_point_range = [FloatingPointRange(from_value=limits.least, to_value=limits.most)]
    elif type(declaration.default) is int:
        most = int(min(limits.most, LARGEST_INTEGER))
        descriptor.integer_range = [IntegerRange(from_value=int(limits.least), to_value=most)]
    return descriptor


class NodeParameters:
    """Parameters of a node that declares the overrides of its user automatically.

    A change is checked at once. Types are checked here and not by rclpy, so that `5000` is as good as `5000.0`, offline
    and live.
    """

    def __init__(self, node: Node, kind: NodeKind) -> None:
        """Check all overrides and declare the rest.

        Raises:
            UsageError: an unknown name, a wrong type or a value outside its range.
        """
        self._node, self._kind, self._known = node, kind, known_parameters(kind.schema)
        self.user: Session | None = None
        """Session that is told of changes while the node is configured"""
        self._before: dict[str, Any] = {}  # values before the change that is checked
        overrides = self._values()
        parameters = load_parameters(overrides, kind.schema)
        values, sources = all_values(parameters), [source.topic for source in parameters.inputs()]
        self._topics = kind.topics._replace(
            inputs=(*kind.topics.inputs, *(name for name in sources if "*" not in name))
        )
        """Topics whose QoS a user may override, with those that the parameters name"""
        check_qos_overrides(node, self._topics, overrides.items())
        for name, declaration in self._known.items():
            if name in overrides:
                node.set_descriptor(name, described(name, declaration))
            else:
                node.declare_parameter(name, values[name], described(name, declaration))
        node.add_on_set_parameters_callback(self._on_set)
        node.add_post_set_parameters_callback(self._after_set)

    def read(self) -> Any:
        """Current parameters, in the schema of the kind of node."""
        return load_parameters(self._values(), self._kind.schema)

    def _values(self) -> dict[str, Any]:
        return {name: parameter.value for name, parameter in self._node.get_parameters_by_prefix("").items()}

    def _on_set(self, changes: Sequence[Parameter]) -> SetParametersResult:
        self._before = self._values()
        new = [change for change in changes if not same(self._before.get(change.name), change.value)]
        try:
            for change in new:
                if self.user and self._is_fixed(change.name):
                    raise UsageError(
                        f"parameter {change.name} cannot change while the node is configured, only after a cleanup"
                    )
            parameters = load_parameters(self._before | {each.name: each.value for each in changes}, self._kind.schema)
            check_qos_overrides(self._node, self._topics, ((change.name, change.value) for change in new))
            if self.user and new:
                self.user.check(parameters)
        except Exception as error:  # whatever a part of the model has against it
            return SetParametersResult(successful=False, reason=" ".join(str(error).split()) or type(error).__name__)
        return SetParametersResult(successful=True, reason="")

    def _is_fixed(self, name: str) -> bool:
        """Whether a parameter cannot change while the node is configured.

        QoS overrides that are new then are declared by rclpy itself.
        """
        if name.startswith(PREFIX):
            return bool(self._node.has_parameter(name))
        return name in self._known and name not in self._kind.live

    def _after_set(self, changes: Sequence[Parameter]) -> None:
        ours = {
            change.name: change.value
            for change in changes
            if change.name in self._kind.live and not same(self._before.get(change.name), change.value)
        }
        if self.user and ours:
            self.user.retune(self.read(), ours)


def same(one: Any, other: Any) -> bool:
    """Whether two values of a parameter mean the same: 5000 and 5000.0 do, True and 1 do not."""
    return isinstance(one, bool) == isinstance(other, bool) and (one == other or (one != one and other != other))  # noqa: PLR0124


def given_by_user(node: Node) -> frozenset[str]:
    """Names of the QoS overrides that the user has given; rclpy declares the others itself, as read-only."""
    names = [PREFIX + name for name in node.get_parameters_by_prefix(PREFIX.rstrip("."))]
    return frozenset(name for name in names if not node.describe_parameter(name).read_only)


def check_qos_overrides(node: Node, topics: Topics, given: Iterable[tuple[str, object]]) -> None:
    """Check the QoS overrides among parameters, given as names and values, for the topics of a node.

    Raises:
        UsageError: an override names none of the node's topics or an unknown policy, or its value is not allowed.
    """
    ours = [
        f"{PREFIX}{node.resolve_topic_name(topic)}.{side}."
        for side, of_side in (("subscription", topics.inputs), ("publisher", topics.outputs))
        for topic in of_side
    ]
    for name, value in given:
        if not name.startswith(PREFIX) or name.removeprefix(PREFIX).startswith(STANDARD_TOPICS):
            continue
        beginning, _, policy = name.rpartition(".")
        if f"{beginning}." not in ours or policy not in (*POLICIES, "depth"):
            known = ", ".join(f"{topic}*" for topic in ours)
            raise UsageError(f"unknown parameter {name}; allowed: {known} with depth, {', '.join(POLICIES)}")
        _check_value(name, policy, value)


def _check_value(name: str, policy: str, value: object) -> None:
    if policy == "depth":
        allowed, words = type(value) is int and 0 <= value <= LARGEST_DEPTH, f"an integer from 0 to {LARGEST_DEPTH}"
    else:
        allowed = isinstance(value, str) and value.lower() in POLICIES[policy]
        words = ", ".join(POLICIES[policy])
    if not allowed:
        raise UsageError(f"parameter {name}: {value!r} is not allowed; allowed: {words}")
