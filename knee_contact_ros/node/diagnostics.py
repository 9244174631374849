"""Reports of the node: the content of `/diagnostics` once a second, and warnings in the log."""

from __future__ import annotations

import math
import time
from collections import Counter
from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from std_msgs.msg import Header

from knee_contact_ros.model.types import FLAT, ROW, UNUSABLE, Fidelity, Status
from knee_contact_ros.node.outputs import WORTH_A_WARNING
from knee_contact_ros.streams.topics import JOINT_STATES, NANOSECONDS
from knee_contact_ros.system.ros import resolve_topic

if TYPE_CHECKING:
    from knee_contact_ros.node.contact_node import ContactSession
    from knee_contact_ros.node.inputs import Input
    from knee_contact_ros.node.session import Session

OFF_TIME = tuple(
    f"{stream}_{why}" for stream in ("angle", "load") for why in ("off_time", "not_in_order")
)
"""Names of the counters of samples that are refused because of their stamps"""
FROM_BOOT = 1e8
"""Difference [s] of stamps above which one clock must count from boot"""
LOG_PERIOD = 5.0
"""Shortest time [s] between two warnings of one kind in the log, as of refused samples"""
SILENCE = 5.0
"""Time [s] without a message of an input after which the log warns"""
REMINDER_PERIOD = 30.0
"""Shortest time [s] between two warnings of a state that lasts, such as a silent input"""
STEADY = Clock(clock_type=ClockType.STEADY_TIME)
"""Clock that keeps running when simulated time stands still or the system's clock is set"""
OK, WARN, ERROR, STALE = (
    DiagnosticStatus.OK,
    DiagnosticStatus.WARN,
    DiagnosticStatus.ERROR,
    DiagnosticStatus.STALE,
)
Problem = tuple[bytes, str]
"""Level of a `DiagnosticStatus`, and its message, which is empty if nothing is wrong"""
Entry = tuple[str, dict[str, str], Problem]
"""Name of a `DiagnosticStatus` after that of the node, its values, and what is wrong"""


def at_most_every(period: float) -> dict[str, Any]:
    """Keyword arguments with which a logger's call does nothing if it has logged within the last `period` [s]."""
    return {"throttle_duration_sec": period, "throttle_time_source_type": STEADY}


def first_of(*table: tuple[Any, bytes, str]) -> Problem:
    """First row of a table that applies, as level and message."""
    return next(((level, text) for applies, level, text in table if applies), (OK, ""))


def warned(*texts: str) -> Problem:
    """Warning of all texts that are not empty."""
    text = "; ".join(filter(None, texts))
    return (WARN if text else OK), text


class Health:
    """Reports what a session has counted, and warns in the log.

    The session counts each answer right after publishing it; a second's worth of counting at a time would delay the
    messages that come meanwhile.
    """

    def __init__(
        self, session: Session, levels: type[IntEnum] = Fidelity, what: str = "fidelity"
    ) -> None:
        """Begin to report; `levels` are those of the answers, and `what` is the word for one."""
        self.session, self._pipeline, self._levels, self._what = (
            session,
            session.pipeline,
            levels,
            what,
        )
        self._name = session.node.get_fully_qualified_name().removeprefix(
            "/"
        )  # in /diagnostics, which all knees share
        self._reported: dict[str, int] = {}  # totals at the last report
        self._warned: dict[str, float] = {}  # monotonic times [s] of the last warnings

    def more(self, name: str, total: int) -> int:
        """Part of a total that came since the last report."""
        before, self._reported[name] = self._reported.get(name, 0), total
        return total - before

    def warn(self, kind: str, text: str, period: float = REMINDER_PERIOD) -> None:
        """Log a warning if it has text, unless one of its kind was logged within the last `period` [s]."""
        now = time.monotonic()
        if text and now >= self._warned.get(kind, -math.inf) + period:
            self._warned[kind] = now
            self.session.node.get_logger().warning(text)

    def report(self) -> DiagnosticArray:
        """Report what has happened since the last report, inputs first; silent inputs are logged."""
        self._log_silence()
        entries = [
            self.usability(),
            *map(
                self._input,
                self.session.inputs,
                (self._pipeline.angle_conflict, self._pipeline.force_conflict),
            ),
            self._refused(),
            self.pairing(),
            self.ticks(),
            *self.special_entries(),
        ]
        for name, sink in self.session.outputs.sinks.items():
            values, text, lost = sink.report()
            entries.append((name, values, (ERROR if lost else warned(text)[0], text)))
        status = [
            DiagnosticStatus(
                level=level,
                name=f"{self._name}: {name}",
                message=text or "ok",
                values=[KeyValue(key=key, value=value) for key, value in values.items()],
            )
            for name, values, (level, text) in entries
        ]
        return DiagnosticArray(
            header=Header(stamp=self.session.node.get_clock().now().to_msg()), status=status
        )

    def special_entries(self) -> list[Entry]:
        """Entries that only one kind of node has."""
        return []

    def doubts(self) -> list[str]:
        """Sentences about implausible answers since the last report."""
        return []

    def usability(self) -> Entry:
        """Entry that says whether the newest answer may be used for control; an old one may not."""
        age = time.monotonic() - self.session.answered
        unusable = sum(
            number for (_, status), number in self.session.counts.items() if status & UNUSABLE
        )
        more = self.more("unusable", unusable)
        problem = first_of(
            (math.isinf(age), STALE, "no answer yet"),
            (
                age > self.session.parameters.diagnostics.timeout,
                STALE,
                f"no answer for {age:.1f} s",
            ),
            (more, WARN, f"not usable answers: {more}"),
        )
        bits = ", ".join(bit.name or "" for bit in Status if self.session.status & bit & UNUSABLE)
        why = problem[1] if problem[0] == STALE else bits
        values = {
            "usable": "false" if why else "true",
            "because": why,
            "not usable": str(unusable),
        }
        return "answers", values, problem

    def _input(self, stream: Input, seen: Any) -> Entry:
        """Entry for an input; publishers that disagree are logged."""
        (values, problem), publishers = stream.meter.report(), stream.publishers
        joint = (
            self.session.parameters.knee.joint_name
            if seen is self._pipeline.angle_conflict
            else ""
        )
        words = seen.sentence(f"{publishers} publishers" if publishers > 1 else "", joint)
        self.warn(stream.topic, words)
        seen.clear_findings()
        values |= {
            "reliability": stream.reliability.replace("_", " "),
            "publishers": str(publishers),
        }
        return stream.topic, values, problem if problem[1] else warned(words)

    def _log_silence(self) -> None:
        silent = [
            stream
            for stream in self.session.inputs
            if time.monotonic() - stream.meter.last > SILENCE
        ]
        if silent:
            names = " and ".join(
                resolve_topic(self.session.node, stream.topic) for stream in silent
            )
            text = f"nothing received on {names} for {SILENCE:g} s or more"
            if any(
                stream.publishers and not (stream.meter.received or stream.handed)
                for stream in silent
            ):
                text += (
                    ", although there is a publisher: it sends nothing, or it runs as another user, whose shared "
                    "memory cannot be read (FASTDDS_BUILTIN_TRANSPORTS=UDPv4 for both)"
                )
            self.warn("silence", text)

    def _refused(self) -> Entry:
        """Entry for the refused samples, counted by reason."""
        refused = self._pipeline.synchroniser.refused
        counts = {"total": str(refused.total())} | {
            reason: str(count) for reason, count in refused.items()
        }
        return "refused samples", counts, warned("samples were refused" if refused else "")

    def pairing(self) -> Entry:
        """Entry for the pairing of the stamps; problems are logged."""
        paired, force = self._pipeline.synchroniser, self._pipeline.force_topic
        lead, full = paired.lead or 0.0, 100.0 * paired.fill
        jumps = {JOINT_STATES: paired.angle_time.jumps, force: paired.load_time.jumps}
        values = {f"jumps of {topic}": str(number) for topic, number in jumps.items()}
        values |= {
            "queue [%]": f"{full:.0f}",
            "angles not recorded": str(paired.unrecorded_angles),
        }
        if paired.lead is not None:
            values["force ahead of angle [s]"] = f"{lead:.3f}"
        if paired.leads:
            usual = float(np.median(paired.leads)) / NANOSECONDS
            values[
                "force ahead of angle, median [s] (pairing.angle_delay, if it is the sensor's)"
            ] = f"{usual:.4f}"
            paired.leads = []
        lost = self.more("unrecorded", paired.unrecorded_angles)
        off = self.more("off time", sum(paired.refused[reason] for reason in OFF_TIME))
        first, second = (JOINT_STATES, force)[:: 1 if lead > 0 else -1]
        apart = f"stamps of {first} lie {abs(lead):.3f} s behind those of {second}"
        apart += "; one of them counts from boot" if abs(lead) > FROM_BOOT else ""
        apart += ", and the answers are flagged (STALE_INPUT)" if paired.clocks_differ else ""
        _, text = warned(
            f"{lost} angles are not recorded: more of them than pairing.queue came without a force"
            if lost
            else "",
            *(
                f"stamps of {topic} have jumped"
                for topic, number in jumps.items()
                if self.more(topic, number)
            ),
            f"{off} stamps fit neither the sample before nor the other topic" if off else "",
            apart if abs(lead) > self.session.parameters.pairing.max_gap else "",
            f"{full:.0f} % of pairing.queue wait for the other topic"
            if full >= 100.0 * WORTH_A_WARNING
            else "",
        )
        self.warn("pairing", text, LOG_PERIOD)
        return "pairing", values, (ERROR, text) if lost else warned(text)

    def ticks(self) -> Entry:
        """Entry for the ticks; a node that falls behind is logged too."""
        session, durations = self.session, sorted(self.session.durations)
        lag, session.durations, session.largest_lag = 1e3 * session.largest_lag, [], 0.0
        values = {"ticks": str(session.counts.total()), "missed deadlines": str(session.missed)}
        if durations:
            values["tick time median [us]"] = f"{durations[len(durations) // 2] * 1e6:.0f}"
            values["tick time max [us]"] = f"{durations[-1] * 1e6:.0f}"
        named: Counter[str] = Counter()
        for (level, status), number in session.counts.items():
            named[f"{self._what} {self._levels(level).name}"] += number
            named.update({f"status {bit.name}": number for bit in Status if status & bit})
        values |= {name: str(number) for name, number in named.items()} | {
            "lag max [ms]": f"{lag:.1f}"
        }
        missed, doubts = self.more("missed", session.missed), self.doubts()
        behind = (
            f"the node is behind by up to {lag:.0f} ms"
            if lag > 1e3 * session.parameters.deadline
            else ""
        )
        self.warn("behind", behind, LOG_PERIOD)
        self.warn("doubts", "; ".join(doubts))
        late = f"{missed} answers came later than the deadline" if missed else ""
        return "ticks", values, warned(late, *doubts, behind)


class ContactHealth(Health):
    """Health of a contact node: also watches the load, its split and the depth."""

    def __init__(self, session: ContactSession) -> None:
        """Begin to report."""
        super().__init__(session)
        self.rows: list[bytes] = []
        """Rows of the answers that are not looked at yet"""
        self._contacts = session.pipeline

    def take(self) -> None:
        """Look for implausible answers among those since the last call."""
        rows, self.rows = np.frombuffer(b"".join(self.rows), ROW).view(FLAT), []
        compartments = self._contacts.compartments
        for number, compartment in enumerate(compartments if len(rows) else ()):
            compartment.doubts.add_all(rows[number :: len(compartments)])

    def special_entries(self) -> list[Entry]:
        """Entries for load (with split where that varies, and deviation) and flexion; problems are logged."""
        doubts, values, flexion = self._contacts.doubts, {}, {}
        inputs, angle = doubts.inputs, doubts.inputs.about_angle
        problem = "; ".join(sentence for sentence in doubts.about_inputs if sentence != angle)
        if doubts.ticks:
            values = {"from [N]": f"{inputs.min_load:.1f}", "to [N]": f"{inputs.max_load:.1f}"}
            bounds = (("from [deg]", inputs.min_angle), ("to [deg]", inputs.max_angle))
            flexion = {name: f"{math.degrees(bound):.1f}" for name, bound in bounds}
        if self._contacts.varies:
            split = self._contacts.split
            values |= {
                "share of the axial load": split.text,
                "above 1": str(split.above),
                "below 0": str(split.below),
            }
            problem = problem or split.problem
        deviation = (
            self._contacts.parameters.diagnostics.load_deviation
            * self._contacts.parameters.body_weight
        )
        for compartment in self._contacts.compartments if deviation and doubts.ticks else ():
            (found,) = compartment.model.uncertainty(compartment.row, deviation)
            values[f"{compartment.topic}: force +- [N]"] = f"{found['contact_force']:.1f}"
            values[f"{compartment.topic}: depth +- [mm]"] = (
                f"{1e3 * found['penetration_depth']:.4f}"
            )
        self.warn("load", problem)
        self.warn("flexion", angle)
        return [("load", values, warned(problem)), ("flexion", flexion, warned(angle))]

    def doubts(self) -> list[str]:
        """Sentences about the compartments whose depth or gap was implausible since the last report."""
        sentences: list[str] = []
        for compartment in self._contacts.compartments:
            if self.more(f"{compartment.topic} implausible", compartment.doubts.implausible):
                sentences += compartment.doubts.about_answers
        return sentences
