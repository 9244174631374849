"""How well `knee-contact replay` keeps time: a minute at 1 kHz per topic, at the bag's rate and ten times faster.

python -m studies.replay_timing [--seconds S] [--output FILE]
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
import rclpy
from rclpy.node import Node

from benchmarks.latency.driver import read
from benchmarks.report import Section, machine, save
from knee_contact_ros.bags.reader import INPUT_TYPES, BagReader, RawMessage
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.commands.player import LATE, Keyboard, Lateness, Player
from knee_contact_ros.commands.replay import ReadAhead, Replayer, undisturbed
from knee_contact_ros.streams.messages import JointState, WrenchStamped, encode_joint_state, encode_wrench_stamped
from knee_contact_ros.streams.topics import NANOSECONDS
from knee_contact_ros.system.ros import private_graph
from knee_contact_ros.system.terminal import progress

PERIOD = 1_000_000
"""Time [ns] from one sample of a topic to the next"""
RATES = (1.0, 10.0)
MS = 1e3
QUANTILES = (50.0, 99.0, 99.9, 100.0)
SINK = """
import sys, rclpy
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

rclpy.init()
node = Node("sink")
for kind, topic in ((JointState, "joint_states"), (WrenchStamped, "joint_reaction_force")):
    node.create_subscription(kind, topic, print, QoSProfile(depth=1000))
sys.stdin.read()
"""
"""Program of a subscriber of both topics, whose middleware receives the messages and which never takes them"""
TEXT = """
A bag of two topics with 1000 samples a second each, in pairs of one time, is played into a subscriber in another
process (reliable, over the loopback interface). Every message is noted when it is handed to the middleware, by the
machine's monotonic clock. *Late* is against the message's due time, (log time - first log time) / rate after the
beginning; *drift* is that of the last message. Neither is the schedule's own account. Memory is looked at every
10 000 messages.
"""
LOOK_EVERY = 10_000
"""Number of messages between two looks at the memory"""


class Run(NamedTuple):
    """Result of one replay."""

    rate: float
    seconds: float
    """Duration of the replay [s]"""
    late: tuple[float, ...]
    """Quantiles of the lateness [s]"""
    share: float
    """Share of messages that come more than 1 ms late"""
    messages: int
    drift: float
    """Lateness of the last message [s]"""
    busy: float
    """Processor time of the process per second"""
    grown: float
    """Growth of the memory [MB]"""
    said: str
    """Last line that the command prints"""


@click.command()
@click.option("--seconds", default=60.0, show_default=True, help="How long each replay takes.")
@click.option(
    "--output", default=Path("docs/studies/replay_timing.md"), show_default=True, type=click.Path(path_type=Path)
)
def main(seconds: float, output: Path) -> None:
    """Measure and write the page."""
    with tempfile.TemporaryDirectory() as folder, private_graph() as environment:
        os.environ.update(environment)
        bag = Path(folder) / "bag.mcap"
        with progress("Writing a bag") as advance:
            write(bag, round(seconds * max(RATES) * NANOSECONDS / PERIOD), advance)
        runs = [measured(bag, rate, seconds) for rate in RATES]
    save(output, "Timing of a replay", "python -m studies.replay_timing", [section(runs)], machine())


def write(path: Path, samples: int, advance: Callable[[int, int], None]) -> None:
    """Write a bag of a slow sine."""
    with BagWriter(path) as bag:
        for topic, name in INPUT_TYPES.items():
            bag.add_topic(topic, name)
        for number in range(samples):
            stamp = number * PERIOD
            angle = 0.5 + 0.5 * np.sin(stamp * 6e-9)
            state = JointState(stamp, "tibia_r", ("knee",), (float(angle),), (), ())
            wrench = WrenchStamped(stamp, "tibia_r", (0.0, -800.0, 0.0), (0.0, 0.0, 0.0))
            bag.write("/joint_states", stamp, encode_joint_state(state))
            bag.write("/joint_reaction_force", stamp, encode_wrench_stamped(wrench))
            advance(number, samples)


def measured(path: Path, rate: float, seconds: float) -> Run:
    """Replay a number of seconds as the command does, and measure it."""
    lateness = Lateness()
    with ExitStack() as opened:
        opened.enter_context(sink())
        rclpy.init(args=None)
        opened.callback(rclpy.shutdown)
        node = Node("knee_contact_replay")
        opened.callback(node.destroy_node)
        replayer = Replayer(node)
        replayer.wait_for_subscribers(60.0, time.sleep)

        reader = opened.enter_context(BagReader(path))
        sent, stamps = np.ones(reader.count), np.ones(reader.count)  # in memory already: it does not grow by them

        def publish(message: RawMessage) -> None:
            sent[lateness.messages] = time.perf_counter()
            stamps[lateness.messages] = message.log_time
            replayer.publish(message)

        opened.enter_context(undisturbed())
        keyboard = opened.enter_context(Keyboard(lambda _seconds: None))
        bar = opened.enter_context(progress(f"Playing at rate {rate:g}"))
        stop = round(seconds * rate * NANOSECONDS)
        ahead = opened.enter_context(ReadAhead(reader.raw_messages(stop=stop)))
        largest = before = read(os.getpid()).resident
        busy = time.process_time()
        first_late: float | None = None
        for message, late in Player(publish, keyboard.wait, rate=rate).play(ahead):
            first_late = late if first_late is None else first_late
            lateness.add(late)
            bar(message.log_time, stop)
            if not lateness.messages % LOOK_EVERY:
                largest = max(largest, read(os.getpid()).resident)
        lateness.end()
        busy = time.process_time() - busy
    count = lateness.messages
    times = sent[:count] - (sent[0] - (first_late or 0.0))
    late_by = times - (stamps[:count] - stamps[0]) / (NANOSECONDS * rate)
    return Run(
        rate=rate,
        seconds=float(times[-1]),
        late=tuple(map(float, np.percentile(late_by, QUANTILES))),
        share=float(np.mean(late_by > LATE)),
        messages=count,
        drift=float(late_by[-1]),
        busy=busy / float(times[-1]),
        grown=(largest - before) / 1e6,
        said=str(lateness),
    )


@contextmanager
def sink() -> Iterator[None]:
    """Run the subscriber in a process of its own."""
    process = subprocess.Popen([sys.executable, "-c", SINK], stdin=subprocess.PIPE)
    try:
        yield
    finally:
        process.communicate()


def section(runs: list[Run]) -> Section:
    """Section with the table of all replays, and the command's own last lines."""
    header = (
        "rate", "lasted [s]", "messages", *(f"late, {'max' if q == 100.0 else f'p{q:g}'} [ms]" for q in QUANTILES),
        "later than 1 ms [%]", "drift at the end [ms]", "memory grown by [MB]", "processor time [%]",
    )  # fmt: skip
    rows = [
        [
            f"{run.rate:g}", f"{run.seconds:.3f}", str(run.messages), *(f"{late * MS:.3f}" for late in run.late),
            f"{100.0 * run.share:.3f}", f"{run.drift * MS:.3f}", f"{run.grown:.1f}", f"{100.0 * run.busy:.0f}",
        ]
        for run in runs
    ]  # fmt: skip
    said = "\n".join(f"- rate {run.rate:g}: {run.said}" for run in runs)
    load = f"Load average (of {os.cpu_count()} processors) at the end: {os.getloadavg()[0]:.1f}."
    return Section("", f"{TEXT.strip()}\n\nThe command's own last line:\n\n{said}\n\n{load}", header, rows)


if __name__ == "__main__":
    main()
