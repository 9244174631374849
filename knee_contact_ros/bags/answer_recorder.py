"""Record answers: the inputs that led to a tick, then its outputs, in the order of the ticks.

That order depends on stamps only, so a live recording and an offline one hold the same messages in the same order.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from shutil import disk_usage
from threading import Event, Thread

from knee_contact_ros.bags.writer import MB, REFUSED_SAMPLES, BagWriter, Limits, Settings
from knee_contact_ros.messages.answer import Ending, Record
from knee_contact_ros.messages.ros_types import NANOSECONDS
from knee_contact_ros.messages.topics import MESSAGE_TYPES, RECORDED
from knee_contact_ros.sinks.protocol import PROVENANCE, Job, Knee, Sink
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import cut_off, leftovers, refuse_impossible

INTERRUPTED = "interrupted"
"""Name of the metadata record of a recording that the node could not end, or that ended before it"""
NODE_GONE = "the node was gone, or had given the recording up, before it was closed"
GATHER = 0.03
"""How long [s] answers are gathered in the node at most: what a kill of it loses of a recording"""
ABSOLUTE_NAMES = {topic: f"/{topic}" for topic in RECORDED}


class AnswerWriter:
    """Writes answers into a bag."""

    def __init__(
        self, bag: BagWriter, provenance: Mapping[str, str], names: Mapping[str, str] = ABSOLUTE_NAMES,
        told_as: str = PROVENANCE,
    ) -> None:  # fmt: skip
        """A recording that begins.

        Args:
            bag: Where to write.
            provenance: Says how the answers come about.
            names: The absolute name under which a topic is recorded.
            told_as: Name of the metadata record of the provenance.
        """
        self.bag = bag
        self._names = names
        for topic, name in names.items():
            bag.add_topic(name, MESSAGE_TYPES[topic])
        bag.add_metadata(told_as, dict(provenance))

    def write(self, records: Sequence[Record]) -> None:
        """Write an answer's inputs and outputs, the outputs last; they are never split over two files."""
        self.bag.split_if_due(records[-1][1])
        self._write(records)

    def write_all(self, answers: Sequence[Sequence[Record]]) -> None:
        """Write many answers: the same bytes as one by one, but for where chunks end if they are flushed otherwise."""
        if self.bag.has_limits:
            for records in answers:
                self.bag.split_if_due(records[-1][1])
                self.bag.write_all(records, self._names)
        else:
            self.bag.write_all(chain.from_iterable(answers), self._names)

    def note(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record behind the answers so far."""
        self.bag.flush()  # messages go by chunks, and metadata at once
        self.bag.add_metadata(name, values)

    def finish(self, ending: Ending) -> None:
        """Write the inputs without an answer, and how many samples were refused and why."""
        self._write(ending.inputs)
        counts = {"total": sum(ending.refused.values())} | ending.refused
        self.bag.add_metadata(REFUSED_SAMPLES, {reason: str(count) for reason, count in counts.items()})

    def _write(self, records: Iterable[Record]) -> None:
        self.bag.write_all(records, self._names)


class Recorder:
    """A recording as a sink's process writes it (`protocol.Output`)."""

    def __init__(self, writer: AnswerWriter, settings: Settings, remarks: Iterable[str] = ()) -> None:
        """`remarks` are what the user shall know of the beginning."""
        self.name = str(writer.bag.path)
        self.period = settings.flush_period
        self._news = tuple(remarks)
        self._writer = writer
        self._min_free = settings.min_free
        self._interruption = NODE_GONE
        self._sync_error: OSError | None = None
        self._done = Event()
        if settings.sync_period:
            Thread(target=self._sync, args=(settings.sync_period,), name="sync", daemon=True).start()

    def write(self, parts: Sequence[Sequence[Record]]) -> None:
        """Write answers' records."""
        self._writer.write_all(parts)

    def note(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record behind the answers so far."""
        self._writer.note(name, values)

    def flush(self) -> None:
        """Hand all that was written to the operating system, and tell whether what came before is on the disk.

        Raises:
            OSError: it is not.
        """
        if self._sync_error:
            raise self._sync_error
        self._writer.bag.flush()

    def must_end(self) -> str:
        """Tell that the disk is nearly full; see `protocol.Output`.

        Raises:
            OSError: the file is not there any more.
        """
        bag = self._writer.bag
        shortage = too_little(bag.free_space(), self._min_free)
        if shortage:
            self._interruption = shortage
            shortage = f"recording {bag.path} has ended, complete up to here: {shortage}"
        return shortage

    def news(self) -> tuple[str, ...]:
        """The remarks, once; see `protocol.Output`."""
        bag = self._writer.bag
        news, self._news, bag.remarks = (*self._news, *bag.remarks), (), []
        return news

    def finish(self, ending: Ending | None) -> None:
        """Complete the file; without an ending it says so."""
        if ending is None:
            self._writer.bag.add_metadata(INTERRUPTED, {"reason": self._interruption})
        else:
            self._writer.finish(ending)
        self._done.set()
        self._writer.bag.close()
        self.name = str(self._writer.bag.path)

    def discard(self) -> None:
        """Leave no file behind."""
        self._done.set()
        self._writer.bag.discard()

    def _sync(self, period: float) -> None:
        """The thread: a disk may take its time, and who writes does not wait for it."""
        try:
            while not self._done.wait(period):
                self._writer.bag.sync()
        except OSError as error:
            self._sync_error = error


def too_little(free: float, least: float) -> str:
    """What is wrong with so much free space [B]; empty if it is enough."""
    if free >= least:
        return ""
    return f"{free / MB:.1f} MB are free on its disk, and parameter record.min_free keeps {least / MB:g} MB"


def refuse(path: Path, min_free: float) -> None:
    """Refuse a recording that cannot be written, or that would leave less than so much space [B]; looks, and quickly.

    Raises:
        UsageError: see `refuse_impossible`, or the disk is nearly full.
    """
    refuse_impossible(path)
    folder = next(folder for folder in path.absolute().parents if folder.exists())
    if shortage := too_little(disk_usage(folder).free, min_free):
        raise UsageError(f"cannot write {path}: {shortage}")


def sink_for(knee: Knee) -> Sink | None:
    """A process that records to MCAP."""
    record = knee.parameters.record
    if not record.path:
        return None
    limits = Limits(record.max_size * MB or math.inf, record.max_duration * NANOSECONDS or math.inf)
    settings = Settings(record.flush_period, limits, record.min_free * MB, record.sync_period)
    job = Job(__name__, (Path(record.path), dict(knee.provenance), dict(knee.names), settings, knee.told_as))
    gather = min(record.flush_period, GATHER)
    return Sink("recorder", "recording", record.path, job, "records", gaps_allowed=False, gather=gather)


def open_output(
    path: Path, provenance: Mapping[str, str], names: Mapping[str, str], settings: Settings, told_as: str = PROVENANCE
) -> Recorder:
    """Open a recording for a sink's process, under the first free one of its names.

    It remarks on its name, and on recordings beside it that were cut off.

    Raises:
        UsageError: see `refuse` and `BagWriter`.
    """
    refuse(path, settings.min_free)
    bag = BagWriter(path, limits=settings.limits, go_on=True)
    remarks = [] if bag.path == path else [f"{path} is there already: this recording is {bag.path}"]
    remarks += map(cut_off, leftovers(path.parent, ".mcap"))
    return Recorder(AnswerWriter(bag, provenance, names, told_as), settings, remarks)
