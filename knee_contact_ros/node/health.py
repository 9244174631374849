"""What `/diagnostics` says of a session once a second, and what the log says with it."""

from __future__ import annotations

import time
from typing import Any, Protocol

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode

from knee_contact_ros.node.diagnostics import (
    LagMeter,
    PairingMeter,
    TickMeter,
    diagnostic_array,
    diagnostic_entry,
    diagnostic_status,
)
from knee_contact_ros.node.outputs import Outputs
from knee_contact_ros.node.subscription import HandedStream, Inputs, InputStream
from knee_contact_ros.parameters.sections import Diagnostics, Pairing
from knee_contact_ros.pipeline.intake import Intake

REFUSAL_LOG_PERIOD = 5.0
SILENCE = 5.0
"""How long [s] an input may be silent before the log says so"""
SILENCE_LOG_PERIOD = 30.0
STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""Runs on when simulated time stands still, or the system's is set"""


def at_most_every(period: float) -> dict[str, Any]:
    """Arguments for a logger's call that is not to say something again within a period [s]."""
    return {"throttle_duration_sec": period, "throttle_time_source_type": STEADY}


class NodeSettings(Protocol):
    """What counts here of a node's parameters."""

    @property
    def pairing(self) -> Pairing:
        """What is stale."""

    @property
    def diagnostics(self) -> Diagnostics:
        """What is silent."""

    @property
    def deadline(self) -> float:
        """What is late [s]."""


class Health:
    """Counts what goes well and what goes wrong, and tells it."""

    def __init__(self, node: LifecycleNode, parameters: NodeSettings, pipeline: Intake, ticks: TickMeter) -> None:
        """Begin to count."""
        self.parameters = parameters
        self.ticks = ticks
        self.lag = LagMeter(0.0)
        """Of the timer that the session says; see `LagMeter`"""
        self.node, self._pipeline = node, pipeline
        self.name = node.get_fully_qualified_name().removeprefix("/")  # in /diagnostics, which all knees share
        self._pairing = PairingMeter(parameters.pairing.max_gap, pipeline.force_topic)
        self._missed_before = 0

    def more(self) -> list[Any]:
        """Entries that only one kind of node has."""
        return []

    def doubts(self) -> list[str]:
        """What makes no sense in the answers since the last report."""
        return []

    def count(self, level: int, status: int, duration: float, latency: float) -> None:
        """Note an answer's level and status, the time it took and that from its force's arrival [s]."""
        self.ticks.count(level, status, duration, latency + self.lag.now > self.parameters.deadline)

    def report(self, inputs: Inputs, outputs: Outputs) -> DiagnosticArray:
        """What there is to say since the last report, of angles and forces first; silent inputs are logged."""
        self._log_silence(inputs)
        period = inputs[1].meter.period
        entries = [
            diagnostic_entry(f"{self.name}: answers", *self.ticks.usability(self.parameters.diagnostics.timeout)),
            *(self._input_status(stream) for stream in inputs),
            self._refused_status(),
            self._pairing_status(),
            self._tick_status(period),
            *self.more(),
        ]
        entries += [
            diagnostic_status(f"{self.name}: {name}", values, problem, lost)
            for name, values, problem, lost in outputs.said()
        ]
        return diagnostic_array(self.node.get_clock().now().to_msg(), entries)

    def _log_silence(self, inputs: Inputs) -> None:
        silent = [stream for stream in inputs if time.monotonic() - stream.meter.last > SILENCE]
        if silent:
            names = " and ".join(self.node.resolve_topic_name(stream.topic) for stream in silent)
            text = f"nothing received on {names} for {SILENCE:g} s or more"
            self.node.get_logger().warning(text, **at_most_every(SILENCE_LOG_PERIOD))

    def _refused_status(self) -> Any:
        """Refused samples by reason."""
        refused = self._pipeline.synchroniser.refused
        counts = {"total": str(refused.total())} | {reason: str(count) for reason, count in refused.items()}
        return diagnostic_status(f"{self.name}: refused samples", counts, "samples were refused" if refused else "")

    def _input_status(self, stream: InputStream | HandedStream) -> Any:
        """What there is to say of an input."""
        values, problem = stream.meter.report()
        values |= {"reliability": stream.reliability.replace("_", " "), "publishers": str(stream.publishers)}
        return diagnostic_entry(f"{self.name}: {stream.topic}", values, problem)

    def _pairing_status(self) -> Any:
        """What there is to say of the stamps; problems are logged."""
        values, problem, lost = self._pairing.report(self._pipeline.synchroniser)
        if problem:
            self.node.get_logger().warning(problem, **at_most_every(REFUSAL_LOG_PERIOD))
        return diagnostic_status(f"{self.name}: pairing", values, problem, lost)

    def _tick_status(self, period: float) -> Any:
        """What there is to say of the ticks, with forces a period [s] apart; a node that falls behind is logged too."""
        missed, lag = self.ticks.missed - self._missed_before, self.lag.report()
        self._missed_before = self.ticks.missed
        problems = [f"{missed} answers came later than the deadline"] if missed else []
        for problem in self.doubts():
            problems.append(problem)
            self.node.get_logger().warning(problem, **at_most_every(SILENCE_LOG_PERIOD))
        if lag > self.parameters.deadline:
            problems.append(f"the node is behind by up to {1e3 * lag:.0f} ms")
            self.node.get_logger().warning(problems[-1], **at_most_every(REFUSAL_LOG_PERIOD))
        values = self.ticks.values(period) | {
            "lag max [ms]": f"{1e3 * lag:.1f}",
            "decoded by ROS": str(self._pipeline.decoder.ordinary),
        }
        return diagnostic_status(f"{self.name}: ticks", values, "; ".join(problems))
