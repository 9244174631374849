"""The parameters as ROS 2 sees them: overrides in, declarations with descriptions out, changes at run time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from knee_contact_ros.node.kind import NodeKind
from knee_contact_ros.node.qos_overrides import PREFIX, check_qos_overrides
from knee_contact_ros.parameters.declared import Declaration, all_values
from knee_contact_ros.system.errors import UsageError

LARGEST_INTEGER = 2**63 - 1
"""That a parameter can hold"""


def described(name: str, declaration: Declaration) -> ParameterDescriptor:
    """What tools show of a parameter: its meaning, and a range or what is allowed."""
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
    """Our parameters on a node that declares its overrides by itself.

    A change is checked at once. Types are checked here and not by rclpy, so that `5000` is as good as `5000.0`, offline
    and live.
    """

    def __init__(self, node: Node, kind: NodeKind) -> None:
        """Check all overrides and declare the rest.

        Raises:
            UsageError: an unknown name, a wrong type or a value outside its range.
        """
        self._node, self._kind, self._known = node, kind, kind.reading.known()
        self.user: Callable[[Any, dict[str, Any]], None] | None = None
        """Who is told of changes while the node is configured: all parameters, and those that have changed"""
        overrides = self._values()
        values = all_values(kind.reading.load(overrides))
        check_qos_overrides(node, kind.topics, overrides.items())
        for name, declaration in self._known.items():
            if name in overrides:
                node.set_descriptor(name, described(name, declaration))
            else:
                node.declare_parameter(name, values[name], described(name, declaration))
        node.add_on_set_parameters_callback(self._on_set)
        node.add_post_set_parameters_callback(self._after_set)

    def read(self) -> Any:
        """The parameters as they are now, of the kind's schema."""
        return self._kind.reading.load(self._values())

    def _values(self) -> dict[str, Any]:
        return {name: parameter.value for name, parameter in self._node.get_parameters_by_prefix("").items()}

    def _on_set(self, changes: Sequence[Parameter]) -> SetParametersResult:
        for change in changes:
            if self.user and self._is_fixed(change.name):
                reason = f"parameter {change.name} cannot change while the node is configured, only after a cleanup"
                return SetParametersResult(successful=False, reason=reason)
        try:
            self._kind.reading.load(self._values() | {change.name: change.value for change in changes})
            check_qos_overrides(self._node, self._kind.topics, ((change.name, change.value) for change in changes))
        except UsageError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True, reason="")

    def _is_fixed(self, name: str) -> bool:
        """Whether it cannot change while the node is configured; rclpy declares overrides then, which are new."""
        if name.startswith(PREFIX):
            return bool(self._node.has_parameter(name))
        return name in self._known and name not in self._kind.live

    def _after_set(self, changes: Sequence[Parameter]) -> None:
        ours = {change.name: change.value for change in changes if change.name in self._kind.live}
        if self.user and ours:
            self.user(self.read(), ours)
