"""What `/diagnostics` says of the load and the depth of a contact node, beside what every node says."""

from __future__ import annotations

from typing import Any

from rclpy.lifecycle import LifecycleNode

from knee_contact_ros.node.diagnostics import TickMeter, diagnostic_status
from knee_contact_ros.node.health import SILENCE_LOG_PERIOD, Health, at_most_every
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.pipeline.pipeline import Pipeline


class ContactHealth(Health):
    """Counts what goes well and what goes wrong with contacts, and tells it."""

    def __init__(self, node: LifecycleNode, parameters: Parameters, pipeline: Pipeline) -> None:
        """Begin to count."""
        super().__init__(node, parameters, pipeline, TickMeter())
        self._contacts = pipeline
        self._too_deep_before: dict[str, int] = {}

    def more(self) -> list[Any]:
        """The load."""
        return [self._load_status()]

    def doubts(self) -> list[str]:
        """Of compartments that have been too deep since."""
        found = []
        for compartment in self._contacts.compartments:
            doubts = compartment.doubts
            if doubts.too_deep > self._too_deep_before.get(compartment.topic, 0):
                self._too_deep_before[compartment.topic] = doubts.too_deep
                found.append(doubts.about_depth)
        return found

    def _load_status(self) -> Any:
        """What there is to say of the load, and of its split where the share varies; problems are logged."""
        doubts, values = self._contacts.doubts, {}
        problem = doubts.about_load
        if doubts.ticks:
            values = {"from [N]": f"{doubts.lowest:.1f}", "to [N]": f"{doubts.highest:.1f}"}
        if self._contacts.varies:
            split = self._contacts.split
            values |= {"share of the axial load": split.text, "above 1": str(split.above), "below 0": str(split.below)}
            problem = problem or split.problem
        if problem:
            self.node.get_logger().warning(problem, **at_most_every(SILENCE_LOG_PERIOD))
        return diagnostic_status(f"{self.name}: load", values, problem)
