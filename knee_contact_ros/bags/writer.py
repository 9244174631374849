"""Writing of a recording as a ROS 2 recorder does: MCAP files (`mcap_writer.py`) and their `metadata.yaml`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import NamedTuple

from mcap.writer import CompressionType

from knee_contact_ros.bags.mcap_writer import BagFile
from knee_contact_ros.bags.metadata import FileFacts, Identity, information, prepare_metadata
from knee_contact_ros.streams.topics import Record
from knee_contact_ros.system.output_files import all_names, claim, claim_first, later_names

REFUSED_SAMPLES = "refused_samples"
"""Name of the metadata record with the number of refused samples by reason"""
CONTINUED = "continued"
"""Name of the metadata record in the later files of a recording, which names the first one"""
MANY_FILES, LISTING_SHARE = 100, 0.02
"""Number of files from which only that share of the time is spent on `metadata.yaml`, which grows with each file"""
MB = 10**6
"""Bytes in a megabyte"""


class Limits(NamedTuple):
    """Limits of a file, beyond which a recording continues in a new one."""

    size: float = math.inf
    """Size [B] at which a file is full"""
    duration: float = math.inf
    """Duration [ns] that the stamps in a file must not reach"""


class Settings(NamedTuple):
    """Settings of a recorder beside a node."""

    flush_period: float
    """Time [s] between two flushes: a crash loses as much"""
    limits: Limits = Limits()
    """Limits of each file"""
    min_free: float = 0.0
    """Space [B] that must stay free on the disk"""
    sync_period: float = 0.0
    """Time [s] between two syncs to the disk: a power failure loses as much; 0 means no syncs"""


class BagWriter:
    """Recording that is being written, in files that get their final names when they are complete.

    Until then a file has the suffix `.partial`. With limits there are several files: `split_if_due`, called between
    messages that may be separated, begins the next one. A thread completes the full file while writing continues.
    """

    def __init__(
        self,
        path: Path,
        compression: CompressionType = CompressionType.ZSTD,
        overwrite: bool = False,
        limits: Limits = Limits(),  # noqa: B008  (a tuple: it cannot change)
        next_free_name: bool = False,
        alone: bool = False,
    ) -> None:
        """Open the first file for writing.

        Args:
            path: Name of the first file.
            compression: Compression of the chunks.
            overwrite: Whether a file of that name is replaced when the new one is complete.
            limits: Limits of each file.
            next_free_name: Whether to use the next free name, numbered like later files, if `path` is taken.
            alone: Whether to write no `metadata.yaml`, so that the folder does not become a rosbag2 folder.

        Raises:
            UsageError: The file cannot be written; see `claim` and `open_claimed`.
        """
        self._types: dict[str, str] = {}  # message type of each topic
        self._compression = compression
        self._limits = limits
        self._names = all_names(path) if next_free_name else later_names(path)
        self.path, partial = claim_first(self._names) if next_free_name else (path, claim(path, overwrite))
        """Path of the first file"""
        self.remarks: list[str] = []
        """Messages for the user"""
        self._alone = alone
        self._complete: list[FileFacts] = []
        self._completing: list[tuple[BagFile, Future[None]]] = []
        self._thread: ThreadPoolExecutor | None = None
        self._list_at = -math.inf  # when [s] to write `metadata.yaml` again
        self._listed: Identity | None = None  # the `metadata.yaml` that was written last
        self.file = BagFile(self.path, partial, compression, overwrite, {})
        """File that is being written"""

    def add_topic(self, topic: str, type_name: str) -> None:
        """Declare a topic by its absolute name and message type; channels have the order of the declarations."""
        if topic not in self._types:
            self._types[topic] = type_name
            self.file.add_topic(topic, type_name)

    def write(self, topic: str, stamp: int, data: bytes) -> None:
        """Write a message's CDR bytes; log time and publish time are its stamp [ns]."""
        self.write_all([(topic, stamp, data)], {topic: topic})

    def write_all(self, records: Iterable[Record], names: Mapping[str, str]) -> None:
        """Write messages into one file, under the absolute names of their topics: the same bytes as one by one."""
        self.file.write_all(records, names)

    @property
    def has_limits(self) -> bool:
        """Whether `split_if_due` may begin a new file."""
        return self._limits != Limits()

    def split_if_due(self, stamp: int) -> None:
        """Continue in a new file if the present one is full, or would span too much time with this stamp [ns].

        Raises:
            UsageError: The new file cannot be opened; the present one is unchanged.
        """
        statistics, limits = self.file.mcap.statistics, self._limits
        if not statistics.message_count:
            return
        span = max(statistics.message_end_time, stamp) - min(statistics.message_start_time, stamp)
        if span >= limits.duration or self.file.mcap.size >= limits.size:
            self._split()

    def flush(self) -> None:
        """Hand all written data to the operating system."""
        self.file.mcap.flush()
        self._settle(wait=False)

    def sync(self) -> None:
        """Sync all flushed data to the disk; may be called by another thread.

        Raises:
            OSError: The sync has failed.
        """
        for file, _ in self._completing.copy():
            file.sync()
        self.file.sync()

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        self.file.mcap.add_metadata(name, values)

    def free_space(self) -> int:
        """Free space [B] on the disk of the recording.

        Raises:
            OSError: The file has been removed.
        """
        return self.file.free_space()

    def close(self) -> None:
        """Complete the recording and its `metadata.yaml`, unless it is alone or there is one of another bag."""
        self._settle(wait=True)
        self._list_at = -math.inf
        self._complete_file(self.file)
        self._end_thread()

    def discard(self) -> None:
        """Remove the unfinished files."""
        self._end_thread()
        for file in (*(file for file, _ in self._completing), self.file):
            file.discard()

    def _split(self) -> None:
        """Begin a new file, after all data have been handed to the old one."""
        self.file.mcap.flush()
        earlier = {topic: self.file.next_number(topic) for topic in self._types}
        following = BagFile(*claim_first(self._names), self._compression, overwrite=False, earlier=earlier)
        for topic, type_name in self._types.items():
            following.add_topic(topic, type_name)
        following.mcap.add_metadata(CONTINUED, {"first": self.path.name})
        full, self.file = self.file, following
        if self._thread is None:
            self._thread = ThreadPoolExecutor(1, "completing")
        self._completing.append((full, self._thread.submit(self._complete_file, full)))

    def _complete_file(self, file: BagFile) -> None:
        """Complete a file, and put it and the new `metadata.yaml` in place at nearly the same moment.

        So a kill leaves a bag that lists all of its whole files; from `MANY_FILES` on, the latest may be missing there.
        """
        file.complete()
        intended, begun = file.path, time.thread_time()
        self._complete.append(file.facts())
        prepare = self._prepare_metadata if time.monotonic() >= self._list_at else self._leave_metadata
        try:
            put_metadata = prepare()
        finally:
            file.take_name()
        if file.path != intended:
            self.remarks.append(f"something took the name {intended} meanwhile: the recording is {file.path}")
            self._complete[-1] = file.facts()
            self.path = file.path if self.path == intended else self.path
            put_metadata = prepare()
        self._listed = put_metadata()
        if len(self._complete) >= MANY_FILES:
            self._list_at = max(self._list_at, time.monotonic() + (time.thread_time() - begun) / LISTING_SHARE)

    def _prepare_metadata(self) -> Callable[[], Identity | None]:
        """Prepare the next `metadata.yaml`; the returned function puts it in place."""
        if self._alone:
            return self._leave_metadata()
        return prepare_metadata(self.path.parent, information(self._complete, self._types), self._listed)

    def _leave_metadata(self) -> Callable[[], Identity | None]:
        """Leave `metadata.yaml` as it is, as a replacement for `_prepare_metadata`."""
        return lambda: self._listed

    def _settle(self, wait: bool) -> None:
        """Take the results of the thread for completed files; `wait` for all full files or not.

        Raises:
            OSError: A file could not be completed.
        """
        while self._completing and (wait or self._completing[0][1].done()):
            self._completing.pop(0)[1].result()

    def _end_thread(self) -> None:
        if self._thread:
            self._thread.shutdown()

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        closed = False
        try:
            if kind is None:
                self.close()
                closed = True
        finally:
            if not closed:
                self.discard()
