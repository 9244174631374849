"""Sessions of a node under a simulated clock and a drawn schedule: samples, timers, services, parameters, kills.

One thread works at a time. At every place where one may wait, the dice of the schedule's seed decide which goes on; the
clock goes on only when all wait. A real node is called as its executor would call it, and outputs are threads with the
code of their processes. What must hold: every force is answered once or counted, every answer is in the recording or
counted, `solve` of each recording gives the same bits, and what has its final name is whole.

python -m studies.schedules [--count N] [--seed S] [--first N]
"""

import heapq
import json
import math
import os
import pickle
import random
import select
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from functools import cache, partial
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import numpy as np
import rclpy
from mcap.records import Message
from rclpy.parameter import Parameter

from knee_contact_ros.bags import mcap_writer, metadata_file
from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.mcap_file import McapFile
from knee_contact_ros.bags.provenance import read_provenance
from knee_contact_ros.bags.recorder import INTERRUPTION
from knee_contact_ros.model.knee import KneeModel
from knee_contact_ros.model.types import FLAT, MESSAGE_FIELDS, ROW, Status
from knee_contact_ros.node import (
    diagnostics,
    inputs,
    output_process,
    outputs,
    regular_work,
    session,
)
from knee_contact_ros.node.contact_node import CONTACT_NODE
from knee_contact_ros.node.managed_node import ManagedNode, Stop
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.build import retuned
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.streams import compartments, contact_pipeline
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.strides import strides_of
from knee_contact_ros.streams.topics import KNEE_CONTACT, TickOutput
from knee_contact_ros.system import output_files
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.ros import private_graph

TELL_PERIOD = 20.0
"""Time [s] between two lines about the progress"""
LONGEST = 1.5
"""Time [s] for which samples come"""
ROOM = 8
"""Number of items that fit into a socket"""
BEGIN = 10**12
"""First stamp [ns]"""
BODY_WEIGHT = 737.0
"""Body weight [N] of the person whose strides are found"""
NOT_RECORDED = np.uint8(Status.INPUT_REJECTED)
"""Bits that `solve` of a recording does not repeat: no refused sample is in it"""
STEPPING = 4.0 * math.pi
"""Angular frequency [rad/s] of strides of half a second"""
SMALLEST = 1e-200
"""Depth [m] below which no layer may begin here"""
CHANGES = (
    ("damping", 1000.0),
    ("damping", 9000.0),
    ("damping", -1.0),
    ("layer_depth", 1e-3),
    ("layer_depth", 1e-250),
)
"""Parameters `contact.*` with values; those below 1e-4 are refused, the last one by the model only (`refusing`)"""


def refusing(model: KneeModel, parameters: Parameters) -> KneeModel:
    """`retuned`, with a law that refuses a value which its parameter may have, as a law of one's own may."""
    if parameters.contact.layer_depth < SMALLEST:
        raise ValueError(f"contact law: no layer begins at {parameters.contact.layer_depth:g} m")
    return retuned(model, parameters)


class Killed(BaseException):
    """Ends the thread of a process that is killed."""


class Task:
    """A thread, and what it waits for."""

    def __init__(self) -> None:
        self.turn = threading.Lock()  # free when it is this one's turn
        self.turn.acquire()
        self.ready: Callable[[], bool] = lambda: True
        self.until = math.inf
        self.killed = self.done = False


class Clock:
    """Simulated time, and the threads of which one works at a time."""

    def __init__(self, dice: random.Random) -> None:
        self.dice, self.now = dice, 100.0
        self.own = threading.local()
        self.tasks = [self.begin()]

    def begin(self) -> Task:
        """Make this thread a task."""
        self.own.task = task = Task()
        return task

    def monotonic(self) -> float:
        """The time [s]; a look at it takes a microsecond."""
        self.now += 1e-6
        return self.now

    perf_counter = time = monotonic

    def time_ns(self) -> int:
        """The time [ns]."""
        return round(1e9 * self.now)

    def wait(self, ready: Callable[[], bool], timeout: float | None = None) -> bool:
        """Let other threads work until this one is ready, or for a time [s]."""
        task = self.own.task
        task.ready, task.until = ready, math.inf if timeout is None else self.now + timeout
        self.pass_on()
        task.turn.acquire()
        if task.killed:
            raise Killed
        return ready()

    def pass_on(self) -> None:
        """Choose the thread that works next."""
        able = [one for one in self.tasks if one.killed or one.until <= self.now or one.ready()]
        if not able:
            self.now = min(one.until for one in self.tasks)
            assert self.now < math.inf, "all threads wait for ever"  # noqa: S101
            able = [one for one in self.tasks if one.until <= self.now]
        self.dice.choice(able).turn.release()

    def start(self, act: Callable[[], None]) -> Task:
        """Start a thread."""
        task = Task()

        def run() -> None:
            self.own.task = task
            task.turn.acquire()
            try:
                act()
            except Killed:
                pass
            finally:
                task.done = True
                self.tasks.remove(task)
                self.pass_on()

        self.tasks.append(task)
        threading.Thread(target=run, daemon=True).start()
        return task


class End:
    """End of a pair of connected sockets."""

    def __init__(self, clock: Clock) -> None:
        self.clock, self.came, self.closed = clock, deque[bytes](), False
        self.other: End

    def poll(self, timeout: float = 0.0) -> bool:
        """Whether something can be received within a time [s]."""
        return self.clock.wait(lambda: bool(self.came) or self.other.closed, timeout)

    def recv(self) -> Any:
        """The next item."""
        self.clock.wait(lambda: bool(self.came) or self.other.closed)
        if not self.came:
            raise EOFError
        return pickle.loads(self.came.popleft())  # noqa: S301

    def send_bytes(self, data: bytes) -> None:
        """Send an item."""
        if self.other.closed:
            raise BrokenPipeError
        self.other.came.append(data)

    def send(self, item: Any) -> None:
        """Send an object."""
        self.send_bytes(pickle.dumps(item))

    def fileno(self) -> Any:
        """What is polled."""
        return self

    def __enter__(self) -> Any:
        return self

    def __exit__(self, *_: object) -> None:
        self.closed = True


class Poll:
    """`select.poll` of one end."""

    def register(self, end: Any, what: int) -> None:
        """Poll an end."""
        self.end, self.reads = end, what == select.POLLIN

    def poll(self, _timeout: float) -> bool:
        """Whether it is ready."""
        other = self.end.other
        return other.closed or bool(self.end.came if self.reads else len(other.came) < ROOM)


class World:
    """What modules of the package see in place of clocks, threads, sockets and processes."""

    def __init__(self, dice: random.Random) -> None:
        self.clock = clock = Clock(dice)
        self.processes: list[Task] = []

        class Event:
            def __init__(self) -> None:
                self.flag = False
                self.set, self.clear = partial_set(self, True), partial_set(self, False)

            def wait(self, timeout: float | None = None) -> bool:
                return clock.wait(lambda: self.flag, timeout)

        class Thread:
            def __init__(self, target: Callable[[], None], **_: Any) -> None:
                self.target = target

            def start(self) -> None:
                self.task = clock.start(self.target)

            def join(self, timeout: float | None = None) -> None:
                clock.wait(lambda: self.task.done, timeout)

        self.threads = SimpleNamespace(Event=Event, Thread=Thread)

    def start_connected(self, *_: str) -> tuple[End, Any]:
        """Start a process of an output."""
        ours: Any = End(self.clock)
        theirs: Any = End(self.clock)
        ours.other, theirs.other = theirs, ours
        code = []

        def run() -> None:
            with theirs:
                asked = theirs.recv()
                code.append(int(not output_process.write_output(theirs, *asked)))

        task = self.clock.start(run)
        self.processes.append(task)
        return ours, SimpleNamespace(pid=len(self.processes), task=task, code=code)

    def reap_process(self, process: Any) -> int:
        """Wait for the end of a process."""
        self.clock.wait(lambda: process.task.done)
        return process.code[0] if process.code else -9

    @contextmanager
    def in_force(self) -> Iterator[None]:
        """Let the modules see this world."""
        replaced = [
            *[(module, "time", self.clock) for module in TIMED],
            *[(module, "retuned", refusing) for module in (compartments, contact_pipeline)],
            (session, "gc", NO_COLLECTOR),
            *[(module, "to_yaml", json.dumps) for module in (mcap_writer, metadata_file)],
            (output_files, "LOCK_TRIES", 1),  # nobody else works during its pauses
            (outputs, "threading", self.threads),
            (outputs, "select", SimpleNamespace(poll=Poll, POLLIN=1, POLLOUT=4)),
            (outputs, "start_connected", self.start_connected),
            (outputs, "reap_process", self.reap_process),
        ]
        before = [(module, name, getattr(module, name)) for module, name, _ in replaced]
        try:
            for module, name, value in replaced:
                setattr(module, name, value)
            yield
        finally:
            for module, name, value in before:
                setattr(module, name, value)


TIMED: Any = (session, regular_work, diagnostics, inputs, outputs, output_process)
"""Modules that look at clocks"""
NO_COLLECTOR = SimpleNamespace(
    **dict.fromkeys(("collect", "freeze", "unfreeze", "enable", "disable"), lambda *_: None)
)
"""In place of `gc`: a full collection takes as long as a quarter of a schedule, and changes no answer"""
MEMORY = Path("/dev/shm")  # noqa: S108
"""Folder in memory, where files are synced at once"""


def partial_set(event: Any, flag: bool) -> Callable[[], None]:
    """A function that sets the flag of an event."""
    return lambda: setattr(event, "flag", flag)


class Schedule:
    """One life of a session."""

    def __init__(self, node: ManagedNode, dice: random.Random, folder: Path) -> None:
        self.node, self.dice, self.folder = node, dice, folder
        self.world = World(dice)
        self.forces = self.jump = 0
        self.rows: list[bytes] = []
        self.sinks: list[tuple[Any, list[Any]]] = []
        self.wrong: list[str] = []
        self.session: Any = None

    def run(self) -> list[str]:
        """Live, and return what is wrong."""
        path = str(self.folder / "r.mcap") if self.dice.random() < 0.8 else ""
        values = {
            "record.path": path,
            "record.min_free": 0.0,
            "record.sync_period": 0.0,
            "record.snapshot": self.dice.choice((0.2, 10.0)),
            "contact.damping": 4000.0,
            "contact.layer_depth": 2e-3,
        }
        self._set(values)
        with self.world.in_force(), self._watched():
            self.node.configure()
            self.session = self.node.session
            self._watch_answers()
            self.session.start_listening()
            self._live()
            self.session.request_end()
            pipeline = self.session.pipeline
            self.node.complete = True
            self.node.finish_session()
            missing = [sink.name for sink, _ in self.sinks if not Path(sink.name).exists()]
            if self.node.complete and missing:
                self.wrong.append(f"the node ends well, without {missing}")
            self.world.clock.wait(lambda: len(self.world.clock.tasks) == 1, 60.0)
        refused = pipeline.synchroniser.refused
        lost = sum(n for why, n in refused.items() if not why.startswith("angle"))
        if self.forces != pipeline.ticks + lost:
            self.wrong.append(f"{self.forces} forces, {pipeline.ticks} answers, {dict(refused)}")
        self._check_files()
        self._check_strides()
        return self.wrong

    def _set(self, values: dict[str, Any]) -> bool:
        """Set parameters, all or none; whether they were taken."""
        given = [Parameter(name, value=value) for name, value in values.items()]
        return bool(self.node.set_parameters_atomically(given).successful)

    @contextmanager
    def _watched(self) -> Iterator[None]:
        """Note what is handed to each output."""
        kind: Any = outputs.SinkProcess
        put, init = kind.put_item, kind.__init__

        def watched_init(sink: Any, *arguments: Any) -> None:
            self.sinks.append((sink, []))
            init(sink, *arguments)

        def watched_put(sink: Any, item: Any) -> None:
            if isinstance(item, TickOutput) and not sink._closed:
                next(items for one, items in self.sinks if one is sink).append(item)
            put(sink, item)

        kind.__init__, kind.put_item = watched_init, watched_put
        try:
            yield
        finally:
            kind.__init__, kind.put_item = init, put

    def _watch_answers(self) -> None:
        publish = self.session._publish

        def noted(answer: Any, begin: float) -> None:
            self.rows += answer.rows
            publish(answer, begin)

        self.session._publish = noted

    def _live(self) -> None:
        """Let samples and timers come, and what is drawn."""
        dice, clock = self.dice, self.world.clock
        begin, rate = clock.now, dice.choice((50, 100, 200))
        latencies = [dice.choice((0.0, 0.003, 0.03)) for _ in range(2)]
        events: list[tuple[float, int, Callable[[], object]]] = []

        def add(time: float, act: Callable[[], object]) -> None:
            heapq.heappush(events, (time, len(events), act))

        for i in range(int(LONGEST * rate)):
            for stream in (0, 1):
                if dice.random() > 0.01:
                    add(i / rate + latencies[stream], self._sample(stream, i / rate))
        acts: list[Callable[[], object]] = [
            self._reset,
            self._service("start_recording"),
            self._service("stop_recording"),
            self._service("save_snapshot"),
            self._change,
            self._kill,
            self._pause,
            self._meet_unfit_publisher,
        ]
        for act in dice.choices(acts, k=dice.randint(0, 6)):
            add(dice.uniform(0.0, LONGEST), act)
        period = self.session._wait_period
        for i in range(int((LONGEST + 0.2) / period)):
            add((i + dice.random()) * period, self.session._on_timer)
        end = dice.choice((LONGEST + 0.2, dice.uniform(0.0, LONGEST)))  # of a signal
        while events and events[0][0] < end:
            time, _, act = heapq.heappop(events)
            clock.wait(lambda: False, max(begin + time - clock.now, 0.0))
            act()

    def _reset(self) -> None:
        """Reset, perhaps as the clocks of the sensors were set."""
        self._service("reset")()
        self.jump += self.dice.choice((0, -50_000_000, -500_000_000, 10**10))

    def _sample(self, stream: int, time: float) -> Callable[[], None]:
        def push() -> None:
            if not self.session._timer:
                return
            stamp = BEGIN + self.jump + round(1e9 * time)
            if stream == 0:
                state = JointState(
                    stamp, "", ("knee",), (0.5 - 0.4 * math.cos(STEPPING * time),), (), ()
                )
                self.session.inputs[0]._on_message(encode_joint_state(state))
                return
            self.forces += 1
            force = (0.0, -1600.0 * max(math.cos(STEPPING * (time - 0.05)), 0.0025), 0.0)
            wrench = WrenchStamped(stamp, "tibia", force, (0.0, 0.0, 0.0))
            self.session.inputs[1]._on_message(encode_wrench_stamped(wrench))

        return push

    def _service(self, name: str) -> Callable[[], None]:
        service = next(one for one in self.session._services if one.srv_name.endswith(f"/{name}"))
        return lambda: service.callback(None, SimpleNamespace())

    def _change(self) -> None:
        """Change a parameter; one that is refused must leave it and later changes as they are."""
        name, value = self.dice.choice(CHANGES)
        taken = self._set({f"contact.{name}": value})
        has = getattr(self.session.pipeline.parameters.contact, name)
        if taken != (value >= 1e-4) or taken != (has == value):
            self.wrong.append(f"{name} {value}: taken {taken}, and the model has {has}")

    def _kill(self) -> None:
        """Kill the process of an output."""
        running = [task for task in self.world.processes if not task.done]
        if running:
            self.dice.choice(running).killed = True

    def _pause(self) -> None:
        self.session.stop_listening()
        self.session.start_listening()

    def _meet_unfit_publisher(self) -> None:
        """One that the user's override of the reliability does not fit."""
        self.dice.choice(self.session.inputs)._unheard.add("/joint_states")

    def _check_files(self) -> None:
        """Check every recording beside what its sink was given."""
        for sink, items in self.sinks:
            path, unfinished = Path(sink.name), Path(f"{sink.name}.partial")
            if path.exists():
                with Bag(path) as bag:
                    (file,) = bag.files
                    found = self._check_answers(sink, items, file)
                    self._check_whole(bag, items[:found])
                continue
            if unfinished.exists():
                with closing(McapFile(unfinished)) as file:
                    self._check_answers(sink, items, file)
            elif items:
                self._check_answers(sink, items, None)
            if not sink.failure:
                self.wrong.append(f"{path.name} is not there, and nothing is said")

    def _check_answers(self, sink: Any, items: list[TickOutput], file: Any) -> int:
        """Check that a file holds the first answers of its sink, and the rest is counted; their number."""
        given = [
            (stamp, data)
            for item in items
            for topic, stamp, data in item.records
            if topic == KNEE_CONTACT
        ]
        found = recorded(file) if file else []
        if found != given[: len(found)] or len(found) < len(given) - sink.dropped:
            told = f"{len(given)} answers, {len(found)} in it, {sink.dropped} lost"
            self.wrong.append(f"{Path(sink.name).name}: {told}; {sink.failure}")
        return len(found)

    def _check_strides(self) -> None:
        """Check that a stride is not usable if the answer beside one of its ends is not; not where stamps went back."""
        rows = np.frombuffer(b"".join(self.rows), ROW)
        if len(rows) and (np.diff(rows["stamp"]) > 0).all():
            for stride in strides_of(rows, BODY_WEIGHT):
                for beside in (
                    np.flatnonzero(rows["stamp"] <= stride.span.start)[-1:],
                    np.flatnonzero(rows["stamp"] >= stride.span.end)[:1],
                ):
                    flagged = rows.copy()
                    flagged["status"][beside] = Status.IMPLAUSIBLE
                    again = strides_of(flagged, BODY_WEIGHT)
                    if len(beside) and any(
                        each.span == stride.span and each.usable for each in again
                    ):
                        self.wrong.append(f"{stride.span} is usable beside an answer that is not")

    def _check_whole(self, bag: Bag, items: list[TickOutput]) -> None:
        """Check a file that has its final name, and holds these answers."""
        if bag.damage and items:
            self.wrong.append(f"{bag.path.name}: {bag.damage}")
        if bag.first_metadata(INTERRUPTION) or not items:
            return
        recording = read_provenance(bag)
        assert recording  # noqa: S101  (by the recorder)
        blocks: list[Any] = []
        try:
            solve(bag, recording, None, keep=lambda block: blocks.append(block.rows[0].copy()))
        except UsageError as error:
            self.wrong.append(str(error))
            return
        live = np.frombuffer(b"".join([item.row for item in items]), ROW).copy().view(FLAT)
        again = np.concatenate(blocks).view(FLAT)
        held = np.flatnonzero(live["status"] & Status.INPUT_HELD)
        most = min(int(held[0]) if len(held) else len(live) - 1, len(live) - 1)
        for rows in (live, again):
            rows["status"] &= ~NOT_RECORDED
        different = [
            name
            for name in MESSAGE_FIELDS
            if not np.array_equal(live[name][:most], again[name][:most])
        ]
        if different:
            self.wrong.append(f"{bag.path.name}: solve differs in {' '.join(different)}")


def recorded(file: Any) -> list[tuple[int, bytes]]:
    """Stamps and bytes of the answers in an open file."""
    answers = {key for key, (one, _) in file.declared.items() if one.topic == f"/{KNEE_CONTACT}"}
    messages = [each for _, each in file.in_file_order() if isinstance(each, Message)]
    return [(each.log_time, each.data) for each in messages if each.channel_id in answers]


GRAPH = ExitStack()
"""Holds the ROS graph of this process until it ends"""


@cache
def own_node() -> ManagedNode:
    """The node of this process, alone in its graph."""
    os.environ.update(GRAPH.enter_context(private_graph()))
    rclpy.init(args=["--ros-args", "--log-level", "fatal"])
    return ManagedNode(CONTACT_NODE, Stop())


def found_in(seed: int, number: int) -> list[str]:
    """What is wrong in a schedule."""
    with tempfile.TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as folder:
        before = Path.cwd()
        os.chdir(folder)  # where a snapshot goes while nothing is recorded
        try:
            return Schedule(own_node(), random.Random(f"{seed} {number}"), Path(folder)).run()  # noqa: S311
        finally:
            os.chdir(before)


@click.command()
@click.option("--count", default=1000, show_default=True)
@click.option("--seed", default=1, show_default=True)
@click.option("--first", default=0, show_default=True, help="Number of the first schedule.")
@click.option("--jobs", default=os.cpu_count(), show_default=True, help="Number of processes.")
def main(count: int, seed: int, first: int, jobs: int) -> None:
    """Run schedules; exit code 1 if anything is wrong."""
    wrong, begin = 0, time.monotonic()
    tell_at = begin + TELL_PERIOD
    # Forked, the processes have what a test has put in place of parts of the package.
    with ProcessPoolExecutor(jobs, get_context("fork")) as pool:
        numbers = range(first, first + count)
        for number, found in zip(numbers, pool.map(partial(found_in, seed), numbers), strict=True):
            if found:
                wrong += 1
                click.echo(f"{number}: {'; '.join(found)}")
            if (now := time.monotonic()) >= tell_at:
                tell_at = now + TELL_PERIOD
                done = number - first + 1
                click.echo(f"{done} of {count} done, {wrong} wrong, {now - begin:.0f} s", err=True)
    click.echo(f"seed {seed}: {wrong} of {count} wrong")
    raise SystemExit(wrong > 0)


if __name__ == "__main__":
    main()
