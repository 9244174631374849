"""The content of `/diagnostics` once a second, and the warnings that go into the log with it."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode
from std_msgs.msg import Header

from knee_contact_ros.node.diagnostics import LagMeter, PairingMeter, TickMeter, diagnostic_entry, diagnostic_status
from knee_contact_ros.node.outputs import Outputs
from knee_contact_ros.node.subscription import HandedStream, Inputs, InputStream
from knee_contact_ros.streams.pairing import PairedStreams

if TYPE_CHECKING:
    from knee_contact_ros.parameters.schema import LoadParameters, Parameters
    from knee_contact_ros.streams.contact_stream import ContactStream

REFUSAL_LOG_PERIOD = 5.0
"""Shortest time [s] between two warnings of refused samples, or of other faults of the inputs, in the log"""
SILENCE = 5.0
"""Time [s] without a message of an input after which the log warns"""
SILENCE_LOG_PERIOD = 30.0
"""Shortest time [s] between two warnings of a silent input, or of implausible answers, in the log"""
STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""Clock that runs on when simulated time stands still, or the system's is set"""


def at_most_every(period: float) -> dict[str, Any]:
    """Keyword arguments with which a logger's call does nothing if it has logged within the last `period` [s]."""
    return {"throttle_duration_sec": period, "throttle_time_source_type": STEADY}


class Health:
    """Counts ticks, faults and delays of a session, and reports them."""

    def __init__(
        self, node: LifecycleNode, parameters: Parameters | LoadParameters, pipeline: PairedStreams, ticks: TickMeter
    ) -> None:
        """Begin to count; `ticks` counts the answers."""
        self.parameters = parameters
        self.ticks = ticks
        self.lag = LagMeter(0.0)
        """Delay of the timer with which the session looks for late angles; see `LagMeter`"""
        self.node, self._pipeline = node, pipeline
        self.name = node.get_fully_qualified_name().removeprefix("/")  # in /diagnostics, which all knees share
        self._pairing = PairingMeter(parameters.pairing.max_gap, pipeline.force_topic)
        self._missed_before = 0

    def special_entries(self) -> list[Any]:
        """Diagnostic entries that only one kind of node has."""
        return []

    def doubts(self) -> list[str]:
        """Sentences about implausible answers since the last report."""
        return []

    def count(self, level: int, status: int, duration: float, latency: float) -> None:
        """Count an answer: its level and status, its computing time and the time since its force arrived, both [s]."""
        self.ticks.count(level, status, duration, latency + self.lag.now > self.parameters.deadline)

    def report(self, inputs: Inputs, outputs: Outputs) -> DiagnosticArray:
        """Report what has happened since the last report, inputs first; silent inputs are logged."""
        self._log_silence(inputs)
        period = inputs[1].meter.period
        entries = [
            diagnostic_entry(f"{self.name}: answers", *self.ticks.usability(self.parameters.diagnostics.timeout)),
            *(self._input_status(stream) for stream in inputs),
            self._refused_status(),
            self._pairing_status(),
            self._tick_status(period),
            *self.special_entries(),
        ]
        entries += [
            diagnostic_status(f"{self.name}: {name}", values, problem, lost)
            for name, values, problem, lost in outputs.reports()
        ]
        return DiagnosticArray(header=Header(stamp=self.node.get_clock().now().to_msg()), status=entries)

    def _log_silence(self, inputs: Inputs) -> None:
        silent = [stream for stream in inputs if time.monotonic() - stream.meter.last > SILENCE]
        if silent:
            names = " and ".join(self.node.resolve_topic_name(stream.topic) for stream in silent)
            text = f"nothing received on {names} for {SILENCE:g} s or more"
            self.node.get_logger().warning(text, **at_most_every(SILENCE_LOG_PERIOD))

    def _refused_status(self) -> Any:
        """Entry for the refused samples, counted by reason."""
        refused = self._pipeline.synchroniser.refused
        counts = {"total": str(refused.total())} | {reason: str(count) for reason, count in refused.items()}
        return diagnostic_status(f"{self.name}: refused samples", counts, "samples were refused" if refused else "")

    def _input_status(self, stream: InputStream | HandedStream) -> Any:
        """Entry for an input."""
        values, problem = stream.meter.report()
        values |= {"reliability": stream.reliability.replace("_", " "), "publishers": str(stream.publishers)}
        return diagnostic_entry(f"{self.name}: {stream.topic}", values, problem)

    def _pairing_status(self) -> Any:
        """Entry for the pairing of the stamps; problems are logged."""
        values, problem, lost = self._pairing.report(self._pipeline.synchroniser)
        if problem:
            self.node.get_logger().warning(problem, **at_most_every(REFUSAL_LOG_PERIOD))
        return diagnostic_status(f"{self.name}: pairing", values, problem, lost)

    def _tick_status(self, period: float) -> Any:
        """Entry for the ticks, with forces a `period` [s] apart; a node that falls behind is logged too."""
        missed, lag = self.ticks.missed - self._missed_before, self.lag.report()
        self._missed_before = self.ticks.missed
        problems = [f"{missed} answers came later than the deadline"] if missed else []
        for problem in self.doubts():
            problems.append(problem)
            self.node.get_logger().warning(problem, **at_most_every(SILENCE_LOG_PERIOD))
        if lag > self.parameters.deadline:
            problems.append(f"the node is behind by up to {1e3 * lag:.0f} ms")
            self.node.get_logger().warning(problems[-1], **at_most_every(REFUSAL_LOG_PERIOD))
        values = self.ticks.values(period) | {"lag max [ms]": f"{1e3 * lag:.1f}"}
        return diagnostic_status(f"{self.name}: ticks", values, "; ".join(problems))


class ContactHealth(Health):
    """Health of a contact node: also watches the load, its split and the depth."""

    def __init__(self, node: LifecycleNode, parameters: Parameters, pipeline: ContactStream) -> None:
        """Begin to count."""
        super().__init__(node, parameters, pipeline, TickMeter())
        self._contacts = pipeline
        self._too_deep_before: dict[str, int] = {}

    def special_entries(self) -> list[Any]:
        """Entry for the load, and for its split where the share varies; problems are logged."""
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
        return [diagnostic_status(f"{self.name}: load", values, problem)]

    def doubts(self) -> list[str]:
        """Sentences about the compartments whose depth was implausible since the last report."""
        sentences = []
        for compartment in self._contacts.compartments:
            doubts = compartment.doubts
            if doubts.too_deep > self._too_deep_before.get(compartment.topic, 0):
                self._too_deep_before[compartment.topic] = doubts.too_deep
                sentences.append(doubts.about_depth)
        return sentences
