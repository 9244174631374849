"""What the node reports: the content of `/diagnostics` once a second, the meters behind it, and warnings in the log."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import LifecycleNode
from std_msgs.msg import Header

from knee_contact_ros.model.types import FLAT, ROW, UNUSABLE, Fidelity, Status
from knee_contact_ros.node.outputs import WORTH_A_WARNING, Outputs
from knee_contact_ros.streams.pairing import PairedStreams, Synchroniser
from knee_contact_ros.streams.publishers import Publishers
from knee_contact_ros.streams.topics import JOINT_REACTION_FORCE, JOINT_STATES, NANOSECONDS
from knee_contact_ros.system.ros import resolved

if TYPE_CHECKING:
    from knee_contact_ros.node.inputs import Input, Inputs
    from knee_contact_ros.parameters.schema import LoadParameters, Parameters
    from knee_contact_ros.streams.contact_stream import ContactStream

REFUSED_STAMPS = tuple(f"{stream}_{why}" for stream in ("angle", "load") for why in ("off_time", "not_in_order"))
"""Names of the counters of samples that are refused because of their stamps"""


FROM_BOOT = 1e8
"""Difference [s] of stamps that only a clock that counts from boot makes"""


class Problem(NamedTuple):
    """A fault for `/diagnostics`, and how severe it is."""

    text: str
    """Message; empty if nothing is wrong"""
    level: bytes
    """Level of `DiagnosticStatus`"""


FINE = Problem("", DiagnosticStatus.OK)


@dataclass
class InputMeter:
    """Measures rate, pauses and age of one input stream, and judges them."""

    warn_rate: float = 0.0
    """Rate [Hz] below which a warning is reported; 0: never"""
    error_rate: float = 0.0
    """Rate [Hz] below which an error is reported; 0: never"""
    max_gap: float = math.inf
    """Silence [s] from which a warning is reported"""
    timeout: float = math.inf
    """Silence [s] from which the stream is reported as stale"""
    received: int = 0
    """Number of messages that have come"""
    last: float = field(default_factory=time.monotonic)
    """Monotonic time [s] of the last message, or of the beginning"""
    periods: list[float] = field(default_factory=list)
    """Times [s] from message to message, since the last report"""
    ages: list[float] = field(default_factory=list)
    """Times [s] from stamps to arrivals by the system's clock, since the last report"""
    arrivals: list[tuple[float, float, int | None]] = field(default_factory=list)
    """Messages that are not counted yet: monotonic time and system's time [s], and the stamp [ns] if there is one.
    A message costs an append; the rest is done once a second, for all (`take`)"""
    report_time: float = field(default_factory=time.monotonic)
    """Monotonic time of the last report [s]"""

    def begin(self) -> None:
        """Start to measure: neither silence nor rate counts the time before."""
        self.take()  # they stay in the total
        self.last = self.report_time = time.monotonic()
        self.periods, self.ages = [], []

    def take(self) -> None:
        """Count the messages that have arrived since the last call."""
        arrived, self.arrivals = self.arrivals, []
        times = [self.last, *(now for now, _, _ in arrived)]
        self.received += len(arrived)
        self.last = times[-1]
        self.periods += [after - before for before, after in pairwise(times)]
        self.ages += [clock - 1e-9 * stamp for _, clock, stamp in arrived if stamp is not None]

    @property
    def age(self) -> float:
        """Time [s] since the last message, or since `begin` if that was later; infinite if none has come."""
        return time.monotonic() - self.last if self.received else math.inf

    def report(self) -> tuple[dict[str, str], Problem]:
        """Values for the time since the last report, and what is wrong."""
        now = time.monotonic()
        rate = len(self.periods) / max(now - self.report_time, 1e-9)
        values = {"received": str(self.received), "rate [Hz]": f"{rate:.1f}"}
        if self.received:
            values["age [s]"] = f"{self.age:.3f}"
        if self.periods:
            values["longest pause [ms]"] = f"{1e3 * max(self.periods):.1f}"
        values |= statistics_of("period", self.periods) | statistics_of("message age", self.ages)
        is_first = self.received == len(self.periods)  # the first messages came at some time of a second
        problem = self._problem(math.inf if is_first else rate)
        self.report_time, self.periods, self.ages = now, [], []
        return values, problem

    @property
    def period(self) -> float:
        """Mean time [s] from message to message since the last report; infinite if it is not known."""
        return sum(self.periods) / len(self.periods) if self.periods else math.inf

    def _problem(self, rate: float) -> Problem:
        if not self.received:
            return Problem("nothing received yet", DiagnosticStatus.STALE)
        if self.age > self.timeout:
            return Problem(f"timeout: silent for {self.age:.1f} s", DiagnosticStatus.STALE)
        if self.age > self.max_gap:
            return Problem(f"silent for {self.age:.1f} s", DiagnosticStatus.WARN)
        if rate < self.error_rate:
            return Problem(f"rate low: {rate:.1f} Hz, below {self.error_rate:g} Hz", DiagnosticStatus.ERROR)
        if rate < self.warn_rate:
            return Problem(f"rate low: {rate:.1f} Hz, below {self.warn_rate:g} Hz", DiagnosticStatus.WARN)
        return FINE


def statistics_of(name: str, seconds: list[float]) -> dict[str, str]:
    """Mean, minimum, maximum and standard deviation of times [s] in ms, named as in ROS 2's topic statistics."""
    if not seconds:
        return {}
    times = 1e3 * np.array(seconds)
    numbers = {"mean": times.mean(), "min": times.min(), "max": times.max(), "std": times.std()}
    return {f"{name} {kind} [ms]": f"{number:.3f}" for kind, number in numbers.items()}


@dataclass
class LagMeter:
    """Measures how far the node is behind, by the delay of a timer of a known period.

    Samples and timers wait in the same queue of the executor, so a late timer has waited for as long as a sample would.
    """

    period: float
    """Period of the timer [s]"""
    now: float = 0.0
    """Delay of the timer when it came last [s]"""
    largest: float = 0.0
    """Largest delay since the last report [s]"""
    _last: float = field(default_factory=time.monotonic)  # a timer may be late the first time, too

    def count(self) -> None:
        """Take note that the timer has come."""
        last, self._last = self._last, time.monotonic()
        self.now = max(0.0, self._last - last - self.period)
        self.largest = max(self.largest, self.now)

    def report(self) -> float:
        """Largest delay since the last report [s]."""
        largest, self.largest = self.largest, 0.0
        return largest


@dataclass
class TickMeter:
    """Counts ticks, their times and their status bits."""

    names: type[IntEnum] = Fidelity
    """Levels, by name and number"""
    what: str = "fidelity"
    """Word for a level in `/diagnostics`"""
    ticks: int = 0
    """Number of ticks"""
    missed: int = 0
    """Number of answers that came later than the deadline"""
    flagged: Counter[str] = field(default_factory=Counter)
    """Number of ticks by status bit"""
    levels: Counter[int] = field(default_factory=Counter)
    """Number of ticks by level"""
    durations: list[float] = field(default_factory=list)
    """Computing times of the ticks since the last report [s]"""
    overruns: int = 0
    """Number of ticks that took longer than forces are apart"""
    status: int = Status.OK
    """Status bits of the last tick"""
    last: float = -math.inf
    """Monotonic time [s] of the last tick"""
    unusable: int = 0
    """Number of answers that must not be used for control"""
    unusable_reported: int = 0
    """Number of these that were reported"""
    answers: list[tuple[int, int, float, bool, float]] = field(default_factory=list)
    """Answers that are not counted yet: level and status, computing time [s], whether it has missed its deadline, and
    the monotonic time [s]"""

    def take(self) -> None:
        """Count the answers since the last call."""
        answers, self.answers = self.answers, []
        if not answers:
            return
        levels, flags, durations, late, times = zip(*answers, strict=True)
        self.ticks += len(answers)
        self.missed += sum(late)
        self.durations += durations
        self.levels.update(levels)
        self.status, self.last = flags[-1], times[-1]
        for status in filter(None, flags):
            self.unusable += status & UNUSABLE != 0
            self.flagged.update(bit.name or "" for bit in Status if status & bit)

    def usability(self, timeout: float) -> tuple[dict[str, str], Problem]:
        """Values that say whether the newest answer may be used for control, and what is wrong.

        An answer older than `timeout` [s] may not.
        """
        age, more = time.monotonic() - self.last, self.unusable - self.unusable_reported
        self.unusable_reported = self.unusable
        why = ", ".join(bit.name or "" for bit in Status if self.status & bit & UNUSABLE)
        problem = Problem(f"the newest answer is not usable: {why}", DiagnosticStatus.WARN) if why else FINE
        if more:
            problem = Problem(f"not usable answers: {more}", DiagnosticStatus.WARN)
        if age > timeout:
            why = f"no answer for {age:.1f} s" if self.ticks else "no answer yet"
            problem = Problem(why, DiagnosticStatus.STALE)
        values = {"usable": "false" if why else "true", "because": why, "answers": str(self.ticks)}
        return values | {"not usable": str(self.unusable)}, problem

    def values(self, period: float) -> dict[str, str]:
        """Totals, and computing times since the last report, of ticks whose forces are a `period` [s] apart."""
        durations, self.durations = sorted(self.durations), []
        self.overruns += sum(duration > period for duration in durations)
        values = {"ticks": str(self.ticks), "missed deadlines": str(self.missed), "overruns": str(self.overruns)}
        if durations:
            values["tick time median [us]"] = f"{durations[len(durations) // 2] * 1e6:.0f}"
            values["tick time max [us]"] = f"{durations[-1] * 1e6:.0f}"
        for level in self.names:
            if count := self.levels[level]:
                values[f"{self.what} {level.name}"] = f"{count} ({100.0 * count / self.ticks:.1f} %)"
        return values | {f"status {name}": str(count) for name, count in self.flagged.items()}


class PairingMeter:
    """Finds what has gone wrong with the stamps since the last report."""

    def __init__(self, max_gap: float, force_topic: str = JOINT_REACTION_FORCE) -> None:
        """Begin to count; `max_gap` is the parameter `pairing.max_gap` [s], `force_topic` the topic of the forces."""
        self._max_gap, self._force_topic = max_gap, force_topic
        self._jumps = {JOINT_STATES: 0, force_topic: 0}
        self._refused = 0
        self._unrecorded = 0

    def report(self, synchroniser: Synchroniser) -> tuple[dict[str, str], str, bool]:
        """Values, what is wrong (empty if nothing is), and whether something is lost because of it."""
        lead, fill = synchroniser.lead, synchroniser.fill
        values = {
            "forces that wait for an angle": str(synchroniser.waiting),
            "queue [%]": f"{100.0 * fill:.0f}",
            "angles not recorded": str(synchroniser.unrecorded),
            "jumps of joint_states": str(synchroniser.angle_time.jumps),
            f"jumps of {self._force_topic}": str(synchroniser.load_time.jumps),
        }
        if lead is not None:
            values["force ahead of angle [s]"] = f"{lead:.3f}"
        if synchroniser.leads:
            usual = float(np.median(synchroniser.leads)) / NANOSECONDS
            values["force ahead of angle, median [s] (pairing.angle_delay, if it is the sensor's)"] = f"{usual:.4f}"
            synchroniser.leads = []
        problems = "; ".join(self._problems(synchroniser, lead, fill))
        lost = synchroniser.unrecorded > self._unrecorded
        self._unrecorded = synchroniser.unrecorded
        return values, problems, lost

    def _problems(self, synchroniser: Synchroniser, lead: float | None, fill: float) -> Iterator[str]:
        if (more := synchroniser.unrecorded - self._unrecorded) > 0:
            yield f"{more} angles are not recorded: more than pairing.queue came without a force"
        for topic, time_ in ((JOINT_STATES, synchroniser.angle_time), (self._force_topic, synchroniser.load_time)):
            if time_.jumps > self._jumps[topic]:
                yield f"stamps of {topic} have jumped"
            self._jumps[topic] = time_.jumps
        refused = sum(count for reason, count in synchroniser.refused.items() if reason in REFUSED_STAMPS)
        if refused > self._refused:
            yield f"{refused - self._refused} stamps fit neither the sample before nor the other topic"
        self._refused = refused
        if lead is not None and abs(lead) > self._max_gap:
            first, second = (JOINT_STATES, self._force_topic)[:: 1 if lead > 0 else -1]
            boot = "; one of them counts from boot" if abs(lead) > FROM_BOOT else ""
            flagged = ", and the answers are flagged (STALE_INPUT)" if synchroniser.apart else ""
            yield f"stamps of {first} lie {abs(lead):.3f} s behind those of {second}{boot}{flagged}"
        if fill >= WORTH_A_WARNING:
            yield f"{100.0 * fill:.0f} % of pairing.queue wait for the other topic"


def diagnostic_status(name: str, values: dict[str, str], problem: str = "", lost: bool = False) -> Any:
    """Entry of a `DiagnosticArray`: a warning if there is a problem, an error if something is lost because of it."""
    level = DiagnosticStatus.ERROR if lost else DiagnosticStatus.WARN
    return diagnostic_entry(name, values, Problem(problem, level) if problem else FINE)


def diagnostic_entry(name: str, values: dict[str, str], problem: Problem) -> Any:
    """Entry of a `DiagnosticArray` with a level of its own."""
    return DiagnosticStatus(
        level=problem.level,
        name=name,
        message=problem.text or "ok",
        values=[KeyValue(key=key, value=value) for key, value in values.items()],
    )


REFUSAL_LOG_PERIOD = 5.0
"""Shortest time [s] between two warnings of refused samples, or of other faults of the inputs, in the log"""
HANDED_OVER = "handed over"
"""Reliability of an input from another node in the process"""
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

    def take(self) -> None:
        """Count the answers since the last report."""
        self.ticks.take()

    def report(self, inputs: Inputs, outputs: Outputs) -> DiagnosticArray:
        """Report what has happened since the last report, inputs first; silent inputs are logged."""
        self.take()
        for stream in inputs:
            stream.meter.take()
        self._log_silence(inputs)
        period = inputs[1].meter.period
        entries = [
            diagnostic_entry(f"{self.name}: answers", *self.ticks.usability(self.parameters.diagnostics.timeout)),
            *map(self._input_status, inputs, (self._pipeline.angles_seen, self._pipeline.forces_seen)),
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
            names = " and ".join(resolved(self.node, stream.topic) for stream in silent)
            text = f"nothing received on {names} for {SILENCE:g} s or more"
            others = [stream for stream in silent if stream.reliability != HANDED_OVER]
            if any(stream.publishers and not stream.meter.received for stream in others):
                text += (
                    ", although a publisher is there: it does not publish, or is of another user, whose shared memory "
                    "cannot be read (FASTDDS_BUILTIN_TRANSPORTS=UDPv4 for both)"
                )
            self.node.get_logger().warning(text, **at_most_every(SILENCE_LOG_PERIOD))

    def _refused_status(self) -> Any:
        """Entry for the refused samples, counted by reason."""
        refused = self._pipeline.synchroniser.refused
        counts = {"total": str(refused.total())} | {reason: str(count) for reason, count in refused.items()}
        return diagnostic_status(f"{self.name}: refused samples", counts, "samples were refused" if refused else "")

    def _input_status(self, stream: Input, seen: Publishers) -> Any:
        """Entry for an input; publishers that disagree are logged."""
        values, problem = stream.meter.report()
        joint = self.parameters.knee.joint_name if seen is self._pipeline.angles_seen else ""
        if words := seen.sentence(f"{stream.publishers} publishers" if stream.publishers > 1 else "", joint):
            self.node.get_logger().warning(words, **at_most_every(SILENCE_LOG_PERIOD))
            problem = problem if problem.text else Problem(words, DiagnosticStatus.WARN)
        seen.forget()
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
        self.rows: list[bytes] = []
        """Rows of the answers that are not looked at yet"""
        self._contacts = pipeline
        self._before: dict[str, tuple[int, int, int]] = {}

    def take(self) -> None:
        """Count the answers since the last report, and look for implausible ones among them."""
        super().take()
        rows, self.rows = np.frombuffer(b"".join(self.rows), ROW).view(FLAT), []
        compartments = self._contacts.compartments
        for number, compartment in enumerate(compartments if len(rows) else ()):
            own = rows[number :: len(compartments)]
            compartment.doubts.add_all(own)

    def special_entries(self) -> list[Any]:
        """Entries for load (with split where that varies, and deviation) and flexion; problems are logged."""
        doubts, values, flexion = self._contacts.doubts, {}, {}
        inputs, angle = doubts.inputs, doubts.inputs.about_angle
        problem = "; ".join(sentence for sentence in doubts.about_inputs if sentence != angle)
        if doubts.ticks:
            values = {"from [N]": f"{inputs.lowest:.1f}", "to [N]": f"{inputs.highest:.1f}"}
            flexion = {
                "from [deg]": f"{math.degrees(inputs.least):.1f}",
                "to [deg]": f"{math.degrees(inputs.most):.1f}",
            }
        if self._contacts.varies:
            split = self._contacts.split
            values |= {"share of the axial load": split.text, "above 1": str(split.above), "below 0": str(split.below)}
            problem = problem or split.problem
        deviation = self._contacts.parameters.diagnostics.load_deviation * self._contacts.parameters.body_weight
        for compartment in self._contacts.compartments if deviation and doubts.ticks else ():
            (found,) = compartment.model.uncertainty(compartment.row, deviation)
            values[f"{compartment.topic}: force +- [N]"] = f"{found['contact_force']:.1f}"
            values[f"{compartment.topic}: depth +- [mm]"] = f"{1e3 * found['penetration_depth']:.4f}"
        if problem:
            self.node.get_logger().warning(problem, **at_most_every(SILENCE_LOG_PERIOD))
        if angle:
            self.node.get_logger().warning(angle, **at_most_every(SILENCE_LOG_PERIOD))
        return [
            diagnostic_status(f"{self.name}: load", values, problem),
            diagnostic_status(f"{self.name}: flexion", flexion, angle),
        ]

    def doubts(self) -> list[str]:
        """Sentences about the compartments whose depth or gap was implausible since the last report."""
        sentences: list[str] = []
        for compartment in self._contacts.compartments:
            doubts = compartment.doubts
            implausible = doubts.too_deep, doubts.flown, doubts.off
            if implausible != self._before.get(compartment.topic, (0, 0, 0)):
                self._before[compartment.topic] = implausible
                sentences += filter(None, (doubts.about_place, doubts.about_depth, doubts.about_gap))
        return sentences
