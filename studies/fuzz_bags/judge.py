"""What is read of a damaged bag, and whether it is wrong in silence; in processes that may die."""

from __future__ import annotations

import multiprocessing
import sqlite3
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, suppress
from functools import cache
from multiprocessing.connection import Connection, wait
from pathlib import Path
from random import Random
from typing import NamedTuple

from mcap import records
from mcap.reader import McapReader, NonSeekingReader, make_reader

from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.mcap_file import McapFile
from knee_contact_ros.bags.recover import recover
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.parameters.schema import Parameters
from knee_contact_ros.streams.contact_pipeline import ContactPipeline
from knee_contact_ros.streams.topics import KNEE_CONTACT, KNEE_CONTACT_WRENCH
from knee_contact_ros.system.errors import UsageError
from studies.fuzz_bags.bags import MAKERS, UNPROTECTED, Message, copy, make, messages, mutate

SAME = "no damage found, same answers"
SAID = "damage said, rest solved"
REFUSED = "refused"
UNNOTICEABLE = "nothing can notice it"
TRACEBACK = "TRACEBACK"
HANG = "HANG"
SILENT = "SILENT WRONG ANSWER"
BAD_RECOVERY = "BAD RECOVERY"
GOOD = (SAME, SAID, REFUSED, UNNOTICEABLE)
BAD = (SILENT, BAD_RECOVERY, TRACEBACK, HANG)


class Verdict(NamedTuple):
    """Outcome of a case."""

    seed: int
    kind: str
    """Kind of the bag"""
    mutation: str
    outcome: str
    """One of `GOOD` and `BAD`"""
    detail: str
    foreign: int = 0
    """Number of messages read whose bytes were not in the undamaged bag"""
    lost: int = 0
    """Number of messages of the undamaged bag that were not read"""


def try_case(seed: int, bags: dict[str, Path], folder: Path) -> Verdict:
    """Damage a bag and use it."""
    random = Random(seed)  # noqa: S311  (chance, no secret)
    kind = list(MAKERS)[seed % len(MAKERS)]
    bag = copy(bags[kind], folder)
    mutation = mutate(bag, random)
    try:
        outcome, detail = solved(kind, bag, folder)
        wrong = recovery_fault(bag, folder) if bag.suffix == ".mcap" and outcome in GOOD else ""
        if wrong:
            outcome, detail = BAD_RECOVERY, wrong
        foreign, lost = compared(bag) if outcome in {SAID, SAME} else (0, 0)
    except Exception as error:  # that is what is looked for
        return Verdict(seed, kind, mutation, TRACEBACK, repr(error))
    return Verdict(seed, kind, mutation, outcome, detail, foreign, lost)


def solved(kind: str, bag: Path, folder: Path) -> tuple[str, str]:
    """Outcome of `solve` with a bag."""
    output = folder / "out" / "out.mcap"
    try:
        with Bag(bag) as opened:
            summary = solve(opened, parameters(), output)
    except UsageError as error:
        left = list(output.parent.iterdir()) if output.parent.exists() else []
        return (SILENT, f"left {left}") if left else (REFUSED, str(error))
    if summary.damage:
        return SAID, summary.damage[0]
    found = answers_in(output)
    if found == expected():
        return SAME, ""
    if kind in UNPROTECTED and found in otherwise(bag):
        return UNNOTICEABLE, ""
    return SILENT, f"{len(found)} answers, {len(expected())} expected"


def recovery_fault(bag: Path, folder: Path) -> str:
    """Fault of what `recover` makes of an MCAP file; empty if there is none."""
    output, before = folder / "recovered" / "r.mcap", bag.read_bytes()
    try:
        recovery = recover(bag, output)
    except UsageError:
        return "left something" if output.parent.exists() and list(output.parent.iterdir()) else ""
    if bag.read_bytes() != before:
        return "the input was changed"
    with closing(McapFile(output)) as new, closing(McapFile(bag)) as old:
        if new.faults:
            return f"the output is damaged: {new.faults[0]}"
        if everything(new) != everything(old):
            return "the output holds something else"
        if new.message_counts.total() != sum(topic.messages for topic in recovery.topics):
            return "the output holds another number of messages"
    return ""


def everything(file: McapFile) -> list[tuple[str, int, int, int, bytes]]:
    """All messages of a file, in its order."""
    return [
        (
            file.declared[entry.channel_id][0].topic,
            entry.sequence,
            entry.log_time,
            entry.publish_time,
            entry.data,
        )
        for _, entry in file.in_file_order()
        if isinstance(entry, records.Message)
    ]


def compared(bag: Path) -> tuple[int, int]:
    """Numbers of messages read that were not in the undamaged bag, and of messages of it that were not read."""
    with Bag(bag) as opened:
        found = {(message.topic, message.data) for message in opened.select().raw_messages()}
    original = {(topic, data) for topic, _, data in messages()}
    return len(found - original), len(original - found)


@cache
def parameters() -> Parameters:
    """Parameters of a model that is quickly computed."""
    return load_parameters({"fidelity.level": "quasi_static"})


@cache
def expected() -> list[tuple[str, bytes]]:
    """Answers to the undamaged bag."""
    return answers_to(messages())


def answers_to(inputs: Iterable[Message]) -> list[tuple[str, bytes]]:
    """Answers of the pipeline to messages."""
    pipeline, answers = ContactPipeline(parameters(), compiled=False), []
    for topic, _, data in inputs:
        feed = pipeline.push_joint_state if topic == "/joint_states" else pipeline.push_force
        answers += list(feed(data))
    answers += list(pipeline.finish_streams())
    wanted = (KNEE_CONTACT, KNEE_CONTACT_WRENCH)
    return [
        (f"/{topic}", data)
        for answer in answers
        for topic, _, data in answer.records()
        if topic in wanted
    ]


def answers_in(recording: Path) -> list[tuple[str, bytes]]:
    """Answers in a recording."""
    with recording.open("rb") as file:
        found = make_reader(file).iter_messages(
            ["/knee_contact", "/knee_contact/wrench"], log_time_order=False
        )
        return [(channel.topic, message.data) for _, channel, message in found]


def otherwise(bag: Path) -> list[list[tuple[str, bytes]]]:
    """Answers to a bag as other libraries read it, by the index of MCAP files and without it, if they can."""
    answers = []
    for way in (make_reader, NonSeekingReader):
        with suppress(Exception):  # what they make of it is not ours
            answers.append(answers_to(read_otherwise(bag, way)))
    return answers


def read_otherwise(bag: Path, way: Callable[..., McapReader]) -> Iterator[Message]:
    """Messages of a bag as read by other libraries than those that `solve` uses."""
    for path in (
        [bag]
        if bag.is_file()
        else sorted(path for path in bag.iterdir() if path.suffix != ".yaml")
    ):
        yield from _rows(path) if path.suffix == ".db3" else _messages(path, way)


def _messages(path: Path, way: Callable[..., McapReader]) -> Iterator[Message]:
    with path.open("rb") as file:
        for _, channel, message in way(file).iter_messages():
            yield channel.topic, message.log_time, message.data


def _rows(path: Path) -> Iterator[Message]:
    query = "SELECT name, timestamp, data FROM messages JOIN topics ON topics.id = topic_id ORDER BY timestamp"
    with closing(sqlite3.connect(f"file:{path}?immutable=1", uri=True)) as database:
        yield from database.execute(query)


LIMIT = 20.0
"""Time [s] that a case may take"""


class Worker:
    """A process that tries one case after another."""

    def __init__(self, bags: dict[str, Path], folder: Path) -> None:
        self._bags, self._folder = bags, folder
        self.seed = 0
        self.begun = 0.0
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self._process = context.Process(
            target=_work, args=(theirs, self._bags, self._folder), daemon=True
        )
        self._process.start()
        theirs.close()

    def give(self, seed: int) -> None:
        """Give a case to the process."""
        self.seed, self.begun = seed, time.monotonic()
        self.connection.send(seed)

    def replace(self) -> None:
        """End the process, and start another one."""
        self._process.kill()
        self._process.join()
        self.connection.close()
        self._start()

    def end(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()


def run(seeds: Sequence[int], workers: int) -> Iterator[Verdict]:
    """Try cases, and yield every verdict as it comes."""
    with tempfile.TemporaryDirectory() as name:
        folder, left = Path(name), iter(seeds)
        (folder / "whole").mkdir()
        bags = make(folder / "whole")
        busy = {
            worker.connection: worker
            for worker in (Worker(bags, folder / str(n)) for n in range(workers))
        }
        for worker in list(busy.values()):
            _next(worker, left, busy)
        while busy:
            for connection in wait(list(busy), timeout=1.0):
                assert isinstance(connection, Connection)  # noqa: S101
                worker = busy[connection]
                try:
                    yield connection.recv()
                except EOFError:  # it died, of memory for instance
                    yield _lost(worker, "the process died")
                    _replace(worker, busy)
                _next(worker, left, busy)
            for worker in [
                worker for worker in busy.values() if time.monotonic() - worker.begun > LIMIT
            ]:
                yield _lost(worker, f"longer than {LIMIT:g} s")
                _replace(worker, busy)
                _next(worker, left, busy)


def _work(connection: Connection, bags: dict[str, Path], folder: Path) -> None:
    while True:
        connection.send(try_case(connection.recv(), bags, folder))


def _next(worker: Worker, left: Iterator[int], busy: dict[Connection, Worker]) -> None:
    seed = next(left, None)
    if seed is None:
        del busy[worker.connection]
        worker.end()
    else:
        worker.give(seed)


def _replace(worker: Worker, busy: dict[Connection, Worker]) -> None:
    del busy[worker.connection]
    worker.replace()
    busy[worker.connection] = worker


def _lost(worker: Worker, why: str) -> Verdict:
    kind = list(MAKERS)[worker.seed % len(MAKERS)]
    return Verdict(worker.seed, kind, "unknown", HANG, why)
