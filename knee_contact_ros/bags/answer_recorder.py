"""Recording of answers: for each tick the inputs that led to it, then its outputs, in the order of the ticks.

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
from knee_contact_ros.streams.output import PROVENANCE, Job, Knee, Sink
from knee_contact_ros.streams.topics import MESSAGE_TYPES, NANOSECONDS, RECORDED, Ending, Record
from knee_contact_ros.system.errors import UsageError
from knee_contact_ros.system.output_files import cut_off, leftovers, refuse_impossible

INTERRUPTED = "interrupted"
"""Name of the metadata record of a recording that the node did not complete, with the reason"""
NODE_GONE = "the node was gone, or had given the recording up, before it was closed"
GATHER = 0.03
"""Longest time [s] for which answers are gathered in the node: a kill of the node loses them"""
ABSOLUTE_NAMES = {topic: f"/{topic}" for topic in RECORDED}
"""Absolute name under which each topic is recorded if nothing else is given"""


class AnswerWriter:
    """Writer of answers, with their inputs and outputs, into a bag."""

    def __init__(
        self, bag: BagWriter, provenance: Mapping[str, str], names: Mapping[str, str] = ABSOLUTE_NAMES,
        told_as: str = PROVENANCE,
    ) -> None:  # fmt: skip
        """Declare the topics in a new bag and write the provenance.

        Args:
            bag: Bag to write to.
            provenance: Content of the metadata record that describes how the answers are computed.
            names: Absolute name under which each topic is recorded.
            told_as: Name of the metadata record of the provenance.
        """
        self.bag = bag
        self._names = names
        for topic, name in names.items():
            bag.add_topic(name, MESSAGE_TYPES[topic])
        bag.add_metadata(told_as, dict(provenance))

    def write(self, records: Sequence[Record]) -> None:
        """Write the inputs and outputs of one answer, the outputs last; they are never split over two files."""
        self.write_all([records])

    def write_all(self, answers: Sequence[Sequence[Record]]) -> None:
        """Write many answers: without flushes between them, the same bytes as one by one."""
        if self.bag.has_limits:
            for records in answers:
                self.bag.split_if_due(records[-1][1])
                self.bag.write_all(records, self._names)
        else:
            self.bag.write_all(chain.from_iterable(answers), self._names)

    def note(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record after the answers so far."""
        self.bag.flush()  # messages wait for the end of their chunk, metadata does not
        self.bag.add_metadata(name, values)

    def finish(self, ending: Ending) -> None:
        """Write the remaining inputs, which led to no answer, and the numbers of refused samples by reason."""
        self.bag.write_all(ending.inputs, self._names)
        counts = {"total": sum(ending.refused.values())} | ending.refused
        self.bag.add_metadata(REFUSED_SAMPLES, {reason: str(count) for reason, count in counts.items()})


class Recorder:
    """Recording that is written in the process of a sink (`protocol.Output`)."""

    def __init__(self, writer: AnswerWriter, settings: Settings, remarks: Iterable[str] = ()) -> None:
        """Begin to sync if the settings ask for it; `remarks` are the first messages for the user."""
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
        """Write the records of several answers."""
        self._writer.write_all(parts)

    def note(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record after the answers so far."""
        self._writer.note(name, values)

    def flush(self) -> None:
        """Hand all written data to the operating system.

        Raises:
            OSError: Writing has failed, or the last sync to the disk has.
        """
        if self._sync_error:
            raise self._sync_error
        self._writer.bag.flush()

    def must_end(self) -> str:
        """Reason to complete the recording early: the disk is nearly full; empty if it is not.

        Raises:
            OSError: The file has been removed.
        """
        bag = self._writer.bag
        shortage = space_shortage(bag.free_space(), self._min_free)
        if shortage:
            self._interruption = shortage
            shortage = f"recording {bag.path} has ended, complete up to here: {shortage}"
        return shortage

    def news(self) -> tuple[str, ...]:
        """Remarks that are new since the last call."""
        bag = self._writer.bag
        news, self._news, bag.remarks = (*self._news, *bag.remarks), (), []
        return news

    def finish(self, ending: Ending | None) -> None:
        """Complete the file; without an `ending`, a metadata record gives the reason of the interruption."""
        if ending is None:
            self._writer.bag.add_metadata(INTERRUPTED, {"reason": self._interruption})
        else:
            self._writer.finish(ending)
        self._done.set()
        self._writer.bag.close()
        self.name = str(self._writer.bag.path)

    def discard(self) -> None:
        """Remove the unfinished files."""
        self._done.set()
        self._writer.bag.discard()

    def _sync(self, period: float) -> None:
        """Sync in a thread of its own, because writing must not wait for a slow disk."""
        try:
            while not self._done.wait(period):
                self._writer.bag.sync()
        except OSError as error:
            self._sync_error = error


def space_shortage(free: float, least: float) -> str:
    """Message about too little free disk space [B]; empty if there is at least `least`."""
    if free >= least:
        return ""
    return f"{free / MB:.1f} MB are free on its disk, and parameter record.min_free keeps {least / MB:g} MB"


def refuse(path: Path, min_free: float) -> None:
    """Refuse a path that cannot be written, or whose disk has less than `min_free` [B] free; nothing is created.

    Raises:
        UsageError: The path cannot be written (see `refuse_impossible`), or the disk is nearly full.
    """
    refuse_impossible(path)
    folder = next(folder for folder in path.absolute().parents if folder.exists())
    if shortage := space_shortage(disk_usage(folder).free, min_free):
        raise UsageError(f"cannot write {path}: {shortage}")


def sink_for(knee: Knee) -> Sink | None:
    """Description of the recorder of a knee as a sink, which writes MCAP; None if the parameters name no file."""
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
    """Open a recording in the process of a sink, under the first of its possible names that is free.

    Its remarks tell of another name than `path`, and of interrupted recordings in the same folder.

    Raises:
        UsageError: The recording cannot be written; see `refuse` and `BagWriter`.
    """
    refuse(path, settings.min_free)
    bag = BagWriter(path, limits=settings.limits, next_free_name=True)
    remarks = [] if bag.path == path else [f"{path} is there already: this recording is {bag.path}"]
    remarks += map(cut_off, leftovers(path.parent, ".mcap"))
    return Recorder(AnswerWriter(bag, provenance, names, told_as), settings, remarks)
