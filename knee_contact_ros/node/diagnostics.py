"""Reports of a node: the content of `/diagnostics` once a second, and warnings in the log."""

import math
import os
import time
from collections import Counter
from collections.abc import Sequence
from enum import IntEnum
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.lifecycle import LifecycleNode
from std_msgs.msg import Header

from ..model.types import UNUSABLE, Fidelity, Status
from ..streams.pipeline import Pipeline
from ..streams.publisher_conflicts import PublisherConflict
from ..streams.timeline import Timeline
from ..streams.topics import NANOSECONDS
from ..system.ros import graph_words, resolve_topic
from .inputs import Input, Inputs
from .outputs import WARNING_FILL, Outputs
from .problems import (
    ERROR,
    LOG_PERIOD,
    STALE,
    WARN,
    Problem,
    first_problem,
    warning_of,
)
from .silence import published_by_others, reason_of_silence

STAMP_REFUSALS = tuple(
    f"{stream}_{why}" for stream in ("angle", "load") for why in ("off_time", "not_in_order")
)
"""Names of the counters of samples that are refused because of their stamps"""
STARTING_TIME = 3.0
"""Time [s] after the activation in which a lag is not told: imports and discovery take their time"""
FEWEST_STEPS = 4
"""Number of steps between angles from which their rate is judged"""
FROM_BOOT = 1e8
"""Difference [s] of stamps above which one clock must count from boot"""
SILENCE = 5.0
"""Time [s] without a message of an input after which the log warns"""
REMINDER_PERIOD = 30.0
"""Shortest time [s] between two warnings of a state that lasts, such as a silent input"""
Entry = tuple[str, dict[str, str], Problem]
"""Name of a `DiagnosticStatus` after that of the node, its values, and what is wrong"""


def jump_sentence(topic: str, jump: float, stream: Input) -> str:
    """Sentence about a jump [s] of stamps: nothing came for that long, or it is the clock's."""
    if 0.0 < jump <= 2.0 * stream.meter.longest_pause:
        return f"no samples on {topic} for {jump:.2f} s"
    return f"stamps of {topic} have jumped by {jump:.2f} s"


class AnswerCounts:
    """What a session counts of its answers.

    Each answer is counted right after it is published; a second's worth of counting at a time would delay the messages
    that come meanwhile.
    """

    def __init__(self) -> None:
        """Begin without answers."""
        self.by_status: Counter[tuple[int, int]] = Counter()
        """Numbers of answers by level and status"""
        self.status = 0
        """Status of the newest answer"""
        self.missed = 0
        """Number of answers that came later than the deadline"""
        self.answered = -math.inf
        """Monotonic time [s] of the newest answer"""
        self.latency = math.nan
        """Time [s] from the arrival of the newest answer's force to its publication"""
        self.durations: list[float] = []
        """Computing times [s] of the answers since the last report"""
        self.largest_lag = 0.0
        """Largest delay [s] of a timer since the last report"""
        self._lag = 0.0
        self._timer_fired = math.inf
        self._started = 0.0

    def start_timer(self) -> None:
        """Note that the timer starts now whose delay is the lag of the node."""
        self._lag = 0.0
        self._started = self._timer_fired = time.monotonic()

    @property
    def is_starting(self) -> bool:
        """Whether the session is so young that what made it may still be the reason of a lag."""
        return time.monotonic() < self._started + STARTING_TIME

    def note_timer(self, period: float) -> None:
        """Note that this timer has fired; it waits in the same queue as samples."""
        before, self._timer_fired = self._timer_fired, time.monotonic()
        self._lag = max(0.0, self._timer_fired - before - period)
        self.largest_lag = max(self.largest_lag, self._lag)

    def count_answer(
        self, level: int, status: int, duration: float, latency: float, deadline: float
    ) -> None:
        """Count an answer by its level and status.

        Args:
            level: Value of one of the levels.
            status: Bits of `Status`.
            duration: Computing time [s].
            latency: Time [s] from the arrival of its force to its publication.
            deadline: Largest latency [s] that is not missed, with the lag of the node added.
        """
        self.by_status[level, status] += 1
        self.durations.append(duration)
        self.missed += latency + self._lag > deadline
        self.status = status
        self.latency = latency
        self.answered = time.monotonic()


class Health:
    """Reports what a session has counted, and warns in the log."""

    def __init__(
        self,
        node: LifecycleNode,
        parameters: Any,
        pipeline: Pipeline[Any],
        levels: type[IntEnum] = Fidelity,
        level_name: str = "fidelity",
    ) -> None:
        """Begin to report; `levels` are those of the answers, and `level_name` is the word for one."""
        self.parameters = parameters
        """Parameters of the node, which may change"""
        self.counts = AnswerCounts()
        self.mixed = ""
        """Sentence about other publishers of the answers; empty without one"""
        self.namesake = ""
        """Sentence about another node of the same name; empty without one"""
        self._node = node
        self._pipeline = pipeline
        self._levels = levels
        self._level_name = level_name
        # In /diagnostics, which all knees share.
        self._name = node.get_fully_qualified_name().removeprefix("/")
        self._reported: dict[str, int] = {}  # totals at the last report
        self._warned: dict[str, float] = {}  # monotonic times [s] of the last warnings
        self._begun: tuple[float, int, list[int]] | None = None  # time [s] and counts at first
        self._is_told = False  # what the first second was like

    def report_diagnostics(self, inputs: Inputs, outputs: Outputs) -> DiagnosticArray:
        """Report what has happened since the last report, inputs first; silent inputs are logged."""
        self._log_silence(inputs)
        angles, forces = inputs
        entries = [
            self.usability_entry(),
            self._input_entry(
                angles,
                self._pipeline.angle_conflict,
                "" if self.parameters.inputs()[0].fields else self.parameters.knee.joint_name,
            ),
            self._input_entry(forces, self._pipeline.force_conflict),
            self._refusals_entry(),
            self.pairing_entry(inputs),
            self.ticks_entry(),
            *self.load_entries(),
        ]
        for name, sink in outputs.sinks.items():
            values, text, lost = sink.report_state()
            entries.append((name, values, (ERROR, text) if lost else warning_of(text)))
        return self._report(entries)

    def standstill_report(self, age: float) -> DiagnosticArray:
        """Report that the node has not worked for a time [s], and how old its newest answer is."""
        answered = time.monotonic() - self.counts.answered
        text = f"the node stands still: it has not worked for {age:.1f} s"
        values = {
            "usable": "false",
            "because": text,
            "age of the last tick [s]": f"{answered:.1f}",
        }
        return self._report([("answers", values, (ERROR, text))])

    def _report(self, entries: Sequence[Entry]) -> DiagnosticArray:
        owner = f"{self._node.get_fully_qualified_name()}, process {os.getpid()}"
        status = [
            DiagnosticStatus(
                level=level,
                name=f"{self._name}: {name}",
                hardware_id=owner,
                message=text or "ok",
                values=[KeyValue(key=key, value=value) for key, value in values.items()],
            )
            for name, values, (level, text) in entries
        ]
        header = Header(stamp=self._node.get_clock().now().to_msg())
        return DiagnosticArray(header=header, status=status)

    def tell_first_second(self, inputs: Inputs) -> None:
        """Log rates, force and usability once, a second after the first answer; to be called by a timer."""
        if self._is_told or not self.counts.by_status:
            return
        now, answers = time.monotonic(), self.counts.by_status.total()
        received = [stream.meter.received for stream in inputs]
        if self._begun is None:
            self._begun = now, answers, received
            return
        begin, answers_before, received_before = self._begun
        span = now - begin
        if span < 1.0:
            return
        self._is_told = True
        words = [
            f"{(number - before) / span:.0f} Hz on {resolve_topic(self._node, stream.topic)}"
            for stream, number, before in zip(inputs, received, received_before, strict=True)
        ]
        words += [
            f"{(answers - answers_before) / span:.0f} answers a second",
            *self.newest_words(),
        ]
        by_status = self.counts.by_status.items()
        unusable = sum(number for (_, status), number in by_status if status & UNUSABLE)
        words.append(f"{unusable} of {answers} not usable" if unusable else "all usable")
        self._node.get_logger().info(", ".join(words))

    def newest_words(self) -> list[str]:
        """Words about the newest answer, which only a contact node has."""
        return []

    def load_entries(self) -> list[Entry]:
        """Entries for the load, which only a contact node has."""
        return []

    def doubts(self) -> list[str]:
        """Sentences about implausible answers since the last report, which only a contact node has."""
        return []

    def usability_entry(self) -> Entry:
        """Entry that says whether the newest answer may be used for control; an old one may not."""
        counts = self.counts
        age = time.monotonic() - counts.answered
        unusable = sum(
            number for (_, status), number in counts.by_status.items() if status & UNUSABLE
        )
        new = self.increase("unusable", unusable)
        is_old = age > self.parameters.diagnostics.timeout
        problem = first_problem(
            (self.mixed, ERROR, self.mixed),
            (math.isinf(age), STALE, "no answer yet"),
            (is_old, STALE, f"no answer for {age:.1f} s"),
            (new, WARN, f"not usable answers: {new}"),
            (self.namesake, WARN, self.namesake),
        )
        bits = [bit.name or "" for bit in Status if counts.status & bit & UNUSABLE]
        why = problem[1] if problem[0] in (STALE, ERROR) else ", ".join(bits)
        values = {
            "usable": "false" if why else "true",
            "because": why,
            "not usable": str(unusable),
        }
        return "answers", values, problem

    def pairing_entry(self, inputs: Inputs) -> Entry:
        """Entry for the pairing of the stamps; problems are logged."""
        paired = self._pipeline.synchroniser
        lead = paired.lead or 0.0
        full = 100.0 * paired.fill
        times: dict[str, tuple[Timeline[Any], Input]] = dict(
            zip(
                self._pipeline.sources.values(),
                zip((paired.angle_time, paired.load_time), inputs, strict=True),
                strict=True,
            )
        )
        values = {f"jumps of {topic}": str(time.jumps) for topic, (time, _) in times.items()}
        for topic, (timeline, _) in times.items():
            values[f"missing in pauses and jumps of {topic}"] = str(timeline.holes.skipped)
        missing = {topic: time.holes.missing for topic, (time, _) in times.items()}
        values |= {f"missing of {topic}": str(number) for topic, number in missing.items()}
        values["queue [%]"] = f"{full:.0f}"
        values["angles not recorded"] = str(paired.unrecorded_angles)
        if paired.lead is not None:
            values["force ahead of angle [s]"] = f"{lead:.3f}"
        if leads := paired.clock_sets.leads:
            usual = float(np.median(leads)) / NANOSECONDS
            name = "force ahead of angle, median [s]"
            values[name] = f"{usual:.4f}"
        problems = []
        lost = self.increase("unrecorded", paired.unrecorded_angles)
        if lost:
            why = "more of them than pairing.queue came without a force"
            problems.append(f"{lost} angles are not recorded: {why}")
        for topic, (timeline, stream) in times.items():
            if self.increase(topic, timeline.jumps):
                problems.append(jump_sentence(topic, timeline.last_jump / NANOSECONDS, stream))
        problems.append(self._slow_angles())
        off_time = sum(paired.refused[reason] for reason in STAMP_REFUSALS)
        off_time = self.increase("off time", off_time)
        if off_time:
            problems.append(f"{off_time} stamps fit neither the sample before nor the other topic")
        problems += self._clock_problems(missing)
        refused = paired.refused.total() - paired.refused["no_angle_before"]
        # Of refused samples or a silent topic the last stamp lies back, whatever the clocks.
        lies_back = self.increase("refused in pairing", refused) > 0
        lies_back |= time.monotonic() - min(each.meter.last for each in inputs) > abs(lead) / 2.0
        is_apart = abs(lead) > self.parameters.pairing.max_gap
        if is_apart and (paired.clocks_differ or not lies_back):
            problems.append(self._lead_problem(lead))
        if full >= 100.0 * WARNING_FILL:
            problems.append(f"{full:.0f} % of pairing.queue wait for the other topic")
        level, text = warning_of(*problems)
        self.warn("pairing", text, LOG_PERIOD)
        return "pairing", values, (ERROR if lost else level, text)

    def _clock_problems(self, missing: dict[str, int]) -> list[str]:
        """Sentences about a clock that was set, and about `missing` samples, by their topic."""
        paired, problems = self._pipeline.synchroniser, list[str]()
        if apart := paired.clock_sets.apart / NANOSECONDS:
            angles, forces = self._pipeline.sources.values()
            ahead, behind = (forces, angles) if apart > 0 else (angles, forces)
            problems.append(
                f"stamps of {ahead} have moved {abs(apart):.3f} s ahead of those of {behind}: was a clock set? The "
                "answers are flagged (STALE_INPUT) until it is set right, or ~/reset"
            )
        for topic, number in missing.items():
            if lost_now := self.increase(f"missing {topic}", number):
                lost = "1 sample is" if lost_now == 1 else f"{lost_now} samples are"
                problems.append(f"{lost} missing on {topic}: holes in its stamps")
        return problems

    def _lead_problem(self, lead: float) -> str:
        """Sentence about forces whose stamps are ahead of those of the angles by too much [s], or behind."""
        topics = self._pipeline.sources.values()
        behind, ahead = topics if lead > 0 else reversed(topics)
        problem = f"stamps of {behind} lie {abs(lead):.3f} s behind those of {ahead}"
        if abs(lead) > FROM_BOOT:
            problem += (
                "; one of them counts from boot: stamp both by one clock, or take one on arrival"
            )
        else:
            problem += ": synchronise the clocks of both senders (chrony, PTP)"
        if self._pipeline.synchroniser.clocks_differ:
            problem += ", and the answers are flagged (STALE_INPUT)"
        return problem

    def _slow_angles(self) -> str:
        """Sentence about angles that are farther apart than `pairing.max_gap`; empty if they are not."""
        steps = sorted(self._pipeline.synchroniser.angle_time.steps)
        step = steps[len(steps) // 2] / NANOSECONDS if len(steps) >= FEWEST_STEPS else 0.0
        if step <= self.parameters.pairing.max_gap:
            return ""
        topic = next(iter(self._pipeline.sources.values()))
        limit = f"pairing.max_gap is {self.parameters.pairing.max_gap:g} s"
        return (
            f"{topic} comes every {step:.2f} s, and {limit}: every answer is flagged (STALE_INPUT)"
        )

    def ticks_entry(self) -> Entry:
        """Entry for the ticks; a node that falls behind is logged too."""
        counts = self.counts
        durations = sorted(counts.durations)
        lag = 1e3 * counts.largest_lag
        counts.durations = []
        counts.largest_lag = 0.0
        values = {
            "ticks": str(counts.by_status.total()),
            "missed deadlines": str(counts.missed),
        }
        if durations:
            values["tick time median [us]"] = f"{durations[len(durations) // 2] * 1e6:.0f}"
            values["tick time max [us]"] = f"{durations[-1] * 1e6:.0f}"
        named: Counter[str] = Counter()
        for (level, status), number in counts.by_status.items():
            named[f"{self._level_name} {self._levels(level).name}"] += number
            named.update({f"status {bit.name}": number for bit in Status if status & bit})
        values |= {name: str(number) for name, number in named.items()}
        values["lag max [ms]"] = f"{lag:.1f}"
        missed = self.increase("missed", counts.missed)
        doubts = self.doubts()
        deadline = self.parameters.deadline
        late = f"{missed} answers came later than deadline ({deadline:g} s)" if missed else ""
        behind = ""
        is_busy = self.increase("ticks", counts.by_status.total()) and not counts.is_starting
        if lag > 1e3 * deadline and is_busy:
            behind = f"the node is behind by up to {lag:.0f} ms"
        self.warn("behind", behind, LOG_PERIOD)
        self.warn("doubts", "; ".join(doubts))
        return "ticks", values, warning_of(late, *doubts, behind)

    def increase(self, name: str, total: int) -> int:
        """Part of a total that came since the last report."""
        before, self._reported[name] = self._reported.get(name, 0), total
        return total - before

    def warn(self, kind: str, text: str, period: float = REMINDER_PERIOD) -> None:
        """Log a warning if it has text, unless one of its kind was logged within the last `period` [s]."""
        now = time.monotonic()
        if text and now >= self._warned.get(kind, -math.inf) + period:
            self._warned[kind] = now
            self._node.get_logger().warning(text)

    def _input_entry(self, stream: Input, conflict: PublisherConflict, joint: str = "") -> Entry:
        """Entry for an input; publishers that disagree are logged."""
        values, problem = stream.meter.report_rate()
        publishers = stream.publishers
        several = f"{publishers} publishers" if publishers > 1 else ""
        sentence = conflict.sentence(several, joint)
        conflict.clear_findings()
        self.warn(stream.topic, sentence)
        values["reliability"] = stream.reliability.replace("_", " ")
        values["publishers"] = str(publishers)
        if stream.reason and not stream.meter.received:
            problem = problem[0], f"{problem[1]}: {stream.reason}"
        return stream.topic, values, problem if problem[1] else warning_of(sentence)

    def _log_silence(self, inputs: Inputs) -> None:
        now = time.monotonic()
        silent = [stream for stream in inputs if now - stream.meter.last > SILENCE]
        if not silent or now < self._warned.get("silence", -math.inf) + REMINDER_PERIOD:
            return
        self._find_reasons(inputs)
        names = " and ".join(resolve_topic(self._node, stream.topic) for stream in silent)
        text = f"nothing received on {names} for {SILENCE:g} s or more, in {graph_words()}"
        if any(each.publishers and not (each.meter.received or each.handed) for each in silent):
            text += (
                ", although there is a publisher: it sends nothing, or it runs as another user, whose shared "
                "memory cannot be read (FASTDDS_BUILTIN_TRANSPORTS=UDPv4 for both)"
            )
        names_and_reasons = [
            f"{resolve_topic(self._node, each.topic)}: {each.reason}"
            for each in silent
            if each.reason
        ]
        self.warn("silence", "; ".join([text, *names_and_reasons]))

    def _find_reasons(self, inputs: Inputs) -> None:
        """Find in the graph why inputs are silent; it takes a while, so only a warning asks for it."""
        graph = published_by_others(self._node)
        sources, joints = self.parameters.inputs(), len(self.parameters.joints())
        by = self.parameters.angle_source, self.parameters.force_source
        for number, stream in enumerate(inputs):
            stream.reason = ""
            if stream.meter.received and not stream.publishers:
                stream.reason = "nobody publishes it any more"
            elif not (stream.meter.received or stream.handed):
                stream.reason = reason_of_silence(
                    by[number],
                    sources[number],
                    resolve_topic(self._node, stream.topic),
                    sources[1 - number].type,
                    0 if number else joints,
                    graph,
                )

    def _refusals_entry(self) -> Entry:
        """Entry for the refused samples, counted by reason."""
        refused = self._pipeline.synchroniser.refused
        values = {"total": str(refused.total())}
        values |= {reason: str(count) for reason, count in refused.items()}
        return "refused samples", values, warning_of("samples were refused" if refused else "")
