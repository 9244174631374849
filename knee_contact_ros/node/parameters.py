"""Kinds of nodes, and their ROS 2 parameters: overrides, declarations with descriptions, changes at run time."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.lifecycle import LifecycleNode
from rclpy.node import Node
from rclpy.parameter import Parameter

from ..parameters.files import (
    all_values,
    known_parameters,
    load_parameters,
    number_in,
    with_companions,
)
from ..parameters.sections import Declaration, NodeSection
from ..system.errors import UsageError

if TYPE_CHECKING:
    from .session import Session


class NodeKind(NamedTuple):
    """Kind of node; code for all kinds is in `managed_node.py` and `session.py`."""

    schema: type[NodeSection]
    """Name of the node, and its parameters"""
    live: frozenset[str]
    """Names of the parameters that may change while the node is configured: they take effect between two ticks"""
    session: Callable[[LifecycleNode, Any], Session]
    """Makes the session of a node from its parameters"""


MAX_INT64 = 2**63 - 1
"""Largest integer that a parameter can hold"""
QOS_PREFIX = "qos_overrides."


def described(name: str, declaration: Declaration) -> ParameterDescriptor:
    """Descriptor of a parameter for ROS 2 tools: its meaning, and its range or allowed values."""
    descriptor = ParameterDescriptor(
        name=name, description=declaration.description, dynamic_typing=True
    )
    descriptor.additional_constraints = (
        f"allowed: {declaration.words}" if declaration.words else ""
    )
    if isinstance(declaration.default, float):
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=declaration.least, to_value=declaration.most)
        ]
    elif type(declaration.default) is int:
        most = int(min(declaration.most, MAX_INT64))
        descriptor.integer_range = [IntegerRange(from_value=int(declaration.least), to_value=most)]
    return descriptor


class NodeParameters:
    """Parameters of a node that declares the overrides of its user automatically.

    A change is checked immediately. Types are checked here instead of by rclpy, so that `5000` is accepted for
    `5000.0`, offline and live.
    """

    def __init__(
        self, node: Node, kind: NodeKind, companions: Mapping[str, Any] = MappingProxyType({})
    ) -> None:
        """Check all overrides and declare the rest; `companions` are the values given to the node's companion.

        Raises:
            UsageError: an unknown name, a wrong type or a value outside its range.
        """
        self._node, self._kind, self._known = node, kind, known_parameters(kind.schema)
        self.user: Session | None = None
        """Session that takes changes while the node is configured"""
        self._before: dict[str, Any] = {}  # values before the change that is checked
        overrides = self._values()
        self.given = with_companions(overrides, companions, kind.schema)
        """Values that the user has given to this node, or to its companion for both"""
        for name in overrides.keys() & kind.schema.other_names.keys():
            node.undeclare_parameter(name)
        values = all_values(load_parameters(self.given, kind.schema))
        for name, declaration in self._known.items():
            if name in overrides:
                node.set_descriptor(name, described(name, declaration))
                if isinstance(overrides[name], str) and not isinstance(values[name], str):
                    node.set_parameters([Parameter(name, value=values[name])])
            else:
                node.declare_parameter(name, values[name], described(name, declaration))
        node.add_pre_set_parameters_callback(self._numbers_for_texts)
        node.add_on_set_parameters_callback(self._on_set)
        node.add_post_set_parameters_callback(self._after_set)

    def read_parameters(self) -> Any:
        """Current parameters, in the schema of the kind of node."""
        return load_parameters(self._values(), self._kind.schema)

    def unset_person(self) -> str:
        """Sentence about the parameters of the person that nobody has given; empty if all are."""
        values = all_values(self.read_parameters())
        unset = [
            f"{name} ({values[name]:.7g} {unit} is used)"
            for name, unit in self._kind.schema.about_person.items()
            if name not in self.given
        ]
        return f"nobody has set {' and '.join(unset)}" if unset else ""

    def _values(self) -> dict[str, Any]:
        return {
            name: parameter.value
            for name, parameter in self._node.get_parameters_by_prefix("").items()
        }

    def _numbers_for_texts(self, changes: Sequence[Parameter]) -> list[Parameter]:
        """Changes with numbers of the declared type instead of texts or integers."""

        def as_number(change: Parameter) -> Parameter:
            declared = self._known.get(change.name)
            value = number_in(change.value, declared.default) if declared else change.value
            if declared and isinstance(declared.default, float) and type(value) is int:
                value = float(value)
            return change if value is change.value else Parameter(change.name, value=value)

        return [as_number(change) for change in changes]

    def _on_set(self, changes: Sequence[Parameter]) -> SetParametersResult:
        self._before = self._values()
        new = self._new(changes)
        try:
            for name in new:
                if self.user and self._is_fixed(name):
                    raise UsageError(
                        f"parameter {name} cannot change while the node is configured, only after a cleanup"
                    )
            parameters = load_parameters(
                self._before | {each.name: each.value for each in changes}, self._kind.schema
            )
            if self.user and new:
                self.user.pipeline.check_retune(parameters)
        except Exception as error:  # whatever a part of the model has against it
            for change in changes:  # rclpy has noted the new types already
                if change.name in self._before:
                    kept = self._node.get_parameter(change.name).type_.value
                    self._node.describe_parameter(change.name).type = kept
            return SetParametersResult(
                successful=False, reason=" ".join(str(error).split()) or type(error).__name__
            )
        return SetParametersResult(successful=True, reason="")

    def _new(self, changes: Sequence[Parameter]) -> dict[str, Any]:
        """Values that differ from those before, by name; of a name that is given twice the last one counts."""
        last = {change.name: change.value for change in changes}
        return {
            name: value for name, value in last.items() if not same(self._before.get(name), value)
        }

    def _is_fixed(self, name: str) -> bool:
        """Whether a parameter cannot change while the node is configured.

        New QoS overrides in that state are declared by rclpy itself.
        """
        if name.startswith(QOS_PREFIX):
            return bool(self._node.has_parameter(name))
        return name in self._known and name not in self._kind.live

    def _after_set(self, changes: Sequence[Parameter]) -> None:
        ours = {
            name: value for name, value in self._new(changes).items() if name in self._kind.live
        }
        if self.user and ours:
            self.user.retune(self.read_parameters(), ours)


def same(one: Any, other: Any) -> bool:
    """Whether two values of a parameter mean the same: 5000 and 5000.0 do, True and 1 do not."""
    return isinstance(one, bool) == isinstance(other, bool) and (
        one == other or (one != one and other != other)  # noqa: PLR0124
    )


def given_by_user(node: Node) -> frozenset[str]:
    """Names of the QoS overrides that the user has given; rclpy declares the others itself, as read-only."""
    names = [QOS_PREFIX + name for name in node.get_parameters_by_prefix(QOS_PREFIX.rstrip("."))]
    return frozenset(name for name in names if not node.describe_parameter(name).read_only)
