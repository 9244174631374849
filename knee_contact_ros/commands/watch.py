"""What a live node hears and says: found in the ROS graph, and shown on a terminal that stays still, or as JSON."""

import json
import math
import os
import sys
import time
from contextlib import ExitStack, suppress
from typing import Any, NamedTuple

import click
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import GetState
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rclpy.signals import SignalHandlerOptions

from ..model.types import MM, NANOSECOND, UNUSABLE, ContactState, Status
from ..msg import KneeContact, LoadEstimate
from ..streams.topics import is_lateral
from ..system.errors import IncompleteError, UsageError, printable, suggest
from ..system.processes import unwinding_on_signals
from ..system.ros import graph_words, make_executor, one_line_ros_errors
from ..system.terminal import say

ANSWERS = {
    "knee_contact_ros/msg/KneeContact": KneeContact,
    "knee_contact_ros/msg/LoadEstimate": LoadEstimate,
}
"""Types of answers, by name; a contact is looked for first"""
QOS = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
"""A reliable listener that is slow would hold up the node"""
REDRAW_PERIOD = 0.5
"""Time [s] between two pictures"""
RATE_TIME = 1.0
"""Time [s] over which the rate of the answers is measured"""
NO_ANSWER = "no answer yet"
"""Words where none came since the command began"""
MEMORY_TIME = 2.0
"""Time [s] without a message after which what came before no longer counts"""
SETTLING = 1.0
"""Time [s] after the first node was found in which another one may be"""
LEVEL_WORDS = ("ok", "warning", "error", "stale")
"""Words for the levels of a `DiagnosticStatus`"""
WORDS = {
    Status.STALE_INPUT: "too long between stamps",
    Status.TIME_RESET: "started anew",
    Status.INPUT_HELD: "no angle came in time",
    Status.NOT_CONVERGED: "error above the tolerance",
    Status.INPUT_REJECTED: "a sample was refused",
    Status.IMPLAUSIBLE: "no knee does that",
    Status.DOUBTFUL_LOAD: "the load is doubtful",
    Status.SEVERAL_PUBLISHERS: "another node sends answers, too",
}
"""Flags of an answer, for people"""


class Answers:
    """Answers of one topic: the newest one, and their rate."""

    def __init__(self, node: Node, topic: str, kind: type) -> None:
        """Subscribe."""
        self.kind, self.received, self.newest, self.arrived = kind, 0, b"", -math.inf
        self.rate = math.nan
        """Rate [Hz] over about the last second; NaN until known"""
        self._since = 0.0
        self._before = 0
        node.create_subscription(kind, topic, self._on_answer, QOS, raw=True)

    def _on_answer(self, data: bytes) -> None:
        self.received += 1
        self.newest, self.arrived = data, time.monotonic()

    def measure_rate(self) -> None:
        """Measure the rate, if it is time; silence before the first answer does not count."""
        now = time.monotonic()
        if not self.received or not self._since:
            self._since, self._before = now, self.received
        elif now - self._since >= RATE_TIME:
            self.rate = (self.received - self._before) / (now - self._since)
            self._since, self._before = now, self.received

    def numbers(self) -> dict[str, Any]:
        """Numbers of the newest answer by field, in SI units; None where one is not finite. Empty without an answer."""
        if not self.newest:
            return {}
        try:
            message = deserialize_message(self.newest, self.kind)
        except Exception:  # whatever foreign bytes provoke
            return {}
        stamp = message.header.stamp
        fields = {
            name: getattr(message, name)
            for name, kind in message.get_fields_and_field_types().items()
            if "/" not in kind
        }
        plain = {name: value if math.isfinite(value) else None for name, value in fields.items()}
        flags = [bit.name for bit in Status if bit & message.status]
        return {"stamp": stamp.sec + NANOSECOND * stamp.nanosec, **plain, "flags": flags}


class Found(NamedTuple):
    """A node that publishes answers."""

    name: str
    """Its full name"""
    topics: dict[str, type]
    """Its topics of answers, with their types"""


def answering_nodes(node: Node) -> list[Found]:
    """Find the nodes that publish answers, those with contacts first."""
    found: dict[str, dict[str, type]] = {}
    for topic, types in node.get_topic_names_and_types():
        for kind in set(types) & ANSWERS.keys():
            for each in node.get_publishers_info_by_topic(topic):
                name = "/".join((each.node_namespace.rstrip("/"), each.node_name))
                found.setdefault(name, {})[topic] = ANSWERS[kind]
    ordered = sorted(found, key=lambda name: (KneeContact not in found[name].values(), name))
    return [Found(name, dict(sorted(found[name].items()))) for name in ordered]


def chosen(found: list[Found], wanted: str) -> Found | None:
    """Choose the node with the wanted name; without one the only node with contacts, or the only one. None: not there.

    Raises:
        UsageError: no name is wanted, and there are several.
    """
    if wanted:
        name = f"/{wanted.strip('/')}"
        return next((each for each in found if each.name == name), None)
    contacts = [each for each in found if KneeContact in each.topics.values()]
    several = contacts or found
    if len(several) > 1:
        names = ", ".join(each.name for each in several)
        raise UsageError(f"several nodes answer: {names}; name one of them")
    return several[0] if several else None


class Watcher:
    """Listens to a node's answers and diagnostics."""

    def __init__(self, node: Node, wanted: str) -> None:
        """Look for a node by name; for the only one without."""
        self._node, self._wanted = node, wanted
        self._first_seen = math.inf
        self.found: Found | None = None
        self.answers: dict[str, Answers] = {}
        self.state = ""
        """State in the life cycle; empty: not known"""
        self.diagnostics: dict[str, dict[str, str]] = {}
        self._states: Any = None
        self._reported = self._heard = -math.inf  # monotonic times [s] of diagnostics and state
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, QOS)

    def look(self) -> None:
        """Look for the node until it is found, and ask for its state; call it a few times a second."""
        now = time.monotonic()
        if self.found is None:
            found = answering_nodes(self._node)
            self._first_seen = min(self._first_seen, now) if found else math.inf
            if not self._wanted and now < self._first_seen + SETTLING:
                return
            self.found = chosen(found, self._wanted)
            if self.found is None:
                return
            name, topics = self.found
            self.answers = {each: Answers(self._node, each, kind) for each, kind in topics.items()}
            self._states = self._node.create_client(GetState, f"{name}/get_state")
        for answers in self.answers.values():
            answers.measure_rate()
        if self._states.service_is_ready():
            self._states.call_async(GetState.Request()).add_done_callback(self._on_state)

    def _on_state(self, future: Any) -> None:
        with suppress(Exception):  # the node may be gone
            self.state, self._heard = future.result().current_state.label, time.monotonic()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        before = f"{self.found.name[1:]}: " if self.found else ""
        for status in message.status:
            if before and status.name.startswith(before):
                values = {value.key: value.value for value in status.values}
                level = LEVEL_WORDS[min(status.level[0], len(LEVEL_WORDS) - 1)]
                entry = {"level": level, "message": status.message, **values}
                self.diagnostics[status.name.removeprefix(before)] = entry
                self._reported = time.monotonic()

    @property
    def is_complete(self) -> bool:
        """Whether answers, their rate and diagnostics are known."""
        rates = [answers.rate for answers in self.answers.values()]
        return bool(rates and self.diagnostics) and not any(map(math.isnan, rates))

    def report(self) -> dict[str, Any]:
        """All that is known, for JSON, in SI units."""
        self._notice_end()
        answers = {}
        for topic, each in self.answers.items():
            rate = None if math.isnan(each.rate) else round(each.rate, 1)
            age = round(time.monotonic() - each.arrived, 3) if each.received else None
            answers[topic] = {"rate": rate, "age": age, **each.numbers()}
        if time.monotonic() - self._reported > MEMORY_TIME:
            self.diagnostics = {}
        why = next(filter(None, map(self._fault, answers.values())), "")
        told = self.diagnostics.get("answers", {}).get("because", "")
        why = told if not why or (told and why == NO_ANSWER) else why  # the node knows since when
        return {
            "node": self.found.name if self.found else None,
            "state": self.state or None,
            "usable": bool(answers) and not why,
            "because": why or None,
            "answers": answers,
            "diagnostics": self.diagnostics,
        }

    def _notice_end(self) -> None:
        """Let the state be that nothing is heard of the node any more."""
        heard = max(
            [self._reported, self._heard, *(each.arrived for each in self.answers.values())]
        )
        if -math.inf < heard < time.monotonic() - MEMORY_TIME:
            there = any(map(self._node.count_publishers, self.answers))
            self.state = "silent: it was killed or hangs" if there else "gone"

    def _fault(self, numbers: dict[str, Any]) -> str:
        """Why the newest answer of a topic is not usable; empty if it is."""
        silent = NO_ANSWER if numbers["age"] is None else ""
        if not silent and numbers["age"] > MEMORY_TIME:
            silent = f"no answer for {numbers['age']:.0f} s"
        if silent:
            return (
                f"{silent}: the node is {self.state}"
                if self.state not in ("", "active")
                else silent
            )
        if "status" not in numbers:
            return "the answers are those of another version of this package"
        return ", ".join(bit.name or "" for bit in Status if numbers["status"] & bit & UNUSABLE)


def lines_of(report: dict[str, Any], missing: str) -> list[str]:
    """Lines for people of a report; `missing` says why there is no node."""
    if report["node"] is None:
        return [missing]
    lines = [f"{report['node']}  {report['state'] or ''}"]
    usable = "yes" if report["usable"] else f"NO: {report['because']}"
    lines.append(f"{'usable':22}{usable}")
    for topic, numbers in report["answers"].items():
        lines += ["", *_answer_lines(topic, numbers)]
    lines.append("")
    for name, entry in report["diagnostics"].items():
        rate = f"{entry['rate [Hz]']:>8} Hz  " if "rate [Hz]" in entry else ""
        level = "" if entry["level"] == "ok" else f"{entry['level'].upper()}: "
        lines.append(f"{name:22}{rate}{level}{entry['message']}")
    if not report["diagnostics"]:
        lines.append("no diagnostics")
    return [printable(line) for line in lines]


def _answer_lines(topic: str, numbers: dict[str, Any]) -> list[str]:
    """Lines about the newest answer of a topic."""
    if "status" not in numbers:
        return [f"{topic:22}no answer that can be read"]
    rate = f"{numbers['rate']:8.1f} Hz" if numbers["rate"] is not None else "       - Hz"
    lines = [f"{topic:22}{rate}, the newest {numbers['age']:.1f} s ago"]
    flags = [f"{name} ({WORDS[Status[name]]})" for name in numbers["flags"]]
    rows = {
        "angle": ("flexion_angle", math.degrees(1.0), 2, "deg"),
        "load": ("load", 1.0, 1, "N"),
        "axial force": ("axial_force", 1.0, 1, "N"),
        "contact force": ("contact_force", 1.0, 1, "N"),
        "depth": ("penetration_depth", MM, 4, "mm"),
    }
    hidden = ("angle",) if is_lateral(topic) else ()
    for name, (field, factor, digits, unit) in rows.items():
        if field in numbers and name not in hidden:
            value = math.nan if numbers[field] is None else factor * numbers[field]
            lines.append(f"  {name:20}{value:10.{digits}f} {unit}")
    with suppress(KeyError, ValueError):
        lines[-1] += f"  {ContactState(numbers['contact_state']).name.lower()}"
    return [*lines, f"  {'status':20}{', '.join(flags) or 'OK'}"]


def brief_line(report: dict[str, Any], missing: str) -> str:
    """Line with the most important of a report; `missing` says why there is no node."""
    if report["node"] is None:
        return missing
    words = [report["node"], "usable" if report["usable"] else f"NOT USABLE: {report['because']}"]
    for topic, numbers in report["answers"].items():
        force = numbers.get("contact_force", numbers.get("axial_force"))
        if force is not None and numbers["rate"] is not None:
            words.append(f"{topic} {numbers['rate']:.0f} Hz {force:.0f} N")
    faults = [
        f"{name}: {entry['message']}"
        for name, entry in report["diagnostics"].items()
        if entry["level"] != "ok"
    ]
    return printable("; ".join([*words, *faults]))


def missing_sentence(node: Node, wanted: str) -> str:
    """Sentence that no such node answers, with the names that come near and where was looked."""
    name = f"/{wanted.strip('/')}"
    everyone = {
        f"{space.rstrip('/')}/{each}" for each, space in node.get_node_names_and_namespaces()
    }
    if wanted and name in everyone:
        return f"{name} offers no answers: it is not configured, or another kind of node"
    others = sorted(everyone - {node.get_fully_qualified_name()})
    hint = suggest(name, others, f"there are {', '.join(others) or 'no nodes'}")
    what = name if wanted else "node with knee_contact or load_estimate"
    return f"no {what} in {graph_words()}; {hint}"


def run_watch(wanted: str, once: bool, as_json: bool, wait: float) -> None:
    """Watch a node until Ctrl-C, or `once` as soon as all is known, for at most `wait` seconds.

    Raises:
        UsageError: several nodes answer and none is wanted by name; or, once, there is none.
        IncompleteError: once, the newest answer is not usable.
    """
    with ExitStack() as opened:
        opened.enter_context(unwinding_on_signals())
        with one_line_ros_errors():
            context = rclpy.Context()
            rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
            opened.callback(context.try_shutdown)
            name = f"knee_contact_watch_{os.getpid()}"
            node = Node(name, context=context, enable_rosout=False)
            opened.callback(node.destroy_node)
        watcher, executor = Watcher(node, wanted), make_executor(node)

        def spin(seconds: float) -> None:
            end = time.monotonic() + seconds
            while (left := end - time.monotonic()) > 0.0:
                executor.spin_once(timeout_sec=left)

        if once:
            _watch_once(watcher, node, wanted, as_json, wait, spin)
            return
        with suppress(KeyboardInterrupt):
            _watch_on(watcher, node, wanted, as_json, spin)


def _watch_once(
    watcher: Watcher, node: Node, wanted: str, as_json: bool, wait: float, spin: Any
) -> None:
    deadline = time.monotonic() + wait
    while not watcher.is_complete and time.monotonic() < deadline:
        watcher.look()
        spin(0.1)
    if watcher.found is None:
        raise UsageError(missing_sentence(node, wanted))
    report = watcher.report()
    click.echo(json.dumps(report) if as_json else "\n".join(lines_of(report, "")))
    if not report["usable"]:
        raise IncompleteError(f"{report['node']}: no usable answer: {report['because']}")


def _watch_on(watcher: Watcher, node: Node, wanted: str, as_json: bool, spin: Any) -> None:
    """Show a picture again and again: in its place on a terminal, and otherwise a line a second."""
    if as_json or not sys.stdout.isatty():
        while True:
            watcher.look()
            report = watcher.report()
            missing = f"waiting: {missing_sentence(node, wanted)}"
            click.echo(json.dumps(report) if as_json else brief_line(report, missing))
            sys.stdout.flush()
            spin(2 * REDRAW_PERIOD)
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    lines: list[str] = []
    try:
        with Live(console=Console(emoji=False), screen=True, auto_refresh=False) as live:
            while True:
                watcher.look()
                missing = f"waiting: {missing_sentence(node, wanted)}"
                lines = lines_of(watcher.report(), missing)
                picture = Text("\n".join(lines), no_wrap=True, overflow="ellipsis")
                live.update(picture, refresh=True)
                spin(REDRAW_PERIOD)
    finally:  # the last picture stays, below what was on the terminal before
        for line in lines:
            say(line)
