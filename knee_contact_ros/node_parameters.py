"""The parameters as ROS 2 sees them: overrides in, declarations with descriptions out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from knee_contact_ros.errors import UsageError
from knee_contact_ros.parameters import Parameters, known_parameters, load_parameters


class NodeParameters:
    """Our parameters on a node that declares its overrides by itself.

    A value can change while the node is not configured; it is checked at once. Types are checked here and not by rclpy,
    so that `5000` is as good as `5000.0`, offline and live.
    """

    def __init__(self, node: Node) -> None:
        """Check all overrides and declare the rest.

        Raises:
            UsageError: an unknown name, a wrong type or a value outside its range.
        """
        self._node = node
        self.fixed = False
        """Whether changes are refused"""
        overrides = self._values()
        load_parameters(overrides)
        for name, (default, description) in known_parameters().items():
            descriptor = ParameterDescriptor(name=name, description=description, dynamic_typing=True)
            if name in overrides:
                node.set_descriptor(name, descriptor)
            else:
                node.declare_parameter(name, default, descriptor)
        node.add_on_set_parameters_callback(self._on_set)

    def read(self) -> Parameters:
        """The parameters as they are now."""
        return load_parameters(self._values())

    def _values(self) -> dict[str, Any]:
        return {name: parameter.value for name, parameter in self._node.get_parameters_by_prefix("").items()}

    def _on_set(self, changes: Sequence[Parameter]) -> SetParametersResult:
        ours = [change for change in changes if change.name in known_parameters()]
        if ours and self.fixed:
            return SetParametersResult(
                successful=False, reason=f"parameter {ours[0].name} cannot change while the node is configured"
            )
        try:
            load_parameters(self._values() | {change.name: change.value for change in changes})
        except UsageError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True, reason="")
