"""Write a recording as a ROS 2 recorder does: one MCAP file (`mcap_writer.py`) or several, `metadata.yaml` beside."""

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
from knee_contact_ros.messages.answer import Record
from knee_contact_ros.system.output_files import all_names, claim, claim_first, later_names

REFUSED_SAMPLES = "refused_samples"
"""Name of the metadata record that counts refused samples by reason."""
CONTINUED = "continued"
"""Name of the metadata record of a file that goes on with a recording"""
MANY_FILES, LISTING_SHARE = 100, 0.02
"""From so many on, only that share of the time is spent on `metadata.yaml`, which grows with every file"""
MB = 10**6


class Limits(NamedTuple):
    """When a recording goes on in a new file."""

    size: float = math.inf
    """[B] that a file has reached"""
    duration: float = math.inf
    """[ns] of stamps that a file spans less than"""


class Settings(NamedTuple):
    """How to record beside a node."""

    flush_period: float
    """[s] what a crash may lose"""
    limits: Limits = Limits()
    """When to go on in a new file"""
    min_free: float = 0.0
    """[B] that must stay free on the disk"""
    sync_period: float = 0.0
    """[s] what a power failure may lose; 0: no care is taken"""


class BagWriter:
    """A recording, in files that appear under their final names when they are complete.

    Until then a file carries the suffix `.partial`. With limits there are several, and `split_if_due` between what
    belongs together begins the next one; a full one is completed by a thread, so that writing goes on meanwhile.
    """

    def __init__(
        self,
        path: Path,
        compression: CompressionType = CompressionType.ZSTD,
        overwrite: bool = False,
        limits: Limits = Limits(),  # noqa: B008  (a tuple: it cannot change)
        go_on: bool = False,
        alone: bool = False,
    ) -> None:
        """Open `path` for writing; with `overwrite`, a file of that name is replaced when the new one is complete.

        With `go_on`, the first free one of its names is used, as those of further files are. A file that is `alone`,
        as one wherever a user wants it, makes no rosbag2 folder of where it lies.

        Raises:
            UsageError: see `claim` and `open_claimed`.
        """
        self._types: dict[str, str] = {}  # topic to message type
        self._compression = compression
        self._limits = limits
        self._names = all_names(path) if go_on else later_names(path)
        self.path, partial = claim_first(self._names) if go_on else (path, claim(path, overwrite))
        """Name of the first file"""
        self.remarks: list[str] = []
        """What the user shall know"""
        self._alone = alone
        self._complete: list[FileFacts] = []
        self._completing: list[tuple[BagFile, Future[None]]] = []
        self._behind: ThreadPoolExecutor | None = None
        self._list_at = -math.inf  # when [s] to write `metadata.yaml` again
        self._listed: Identity | None = None  # the one that was written last
        self.file = BagFile(self.path, partial, compression, overwrite, {})
        """The one that is being written"""

    def add_topic(self, topic: str, type_name: str) -> None:
        """Declare a topic (absolute name) and its message type; the order of declaration is that in the file."""
        if topic not in self._types:
            self._types[topic] = type_name
            self.file.add_topic(topic, type_name)

    def write(self, topic: str, stamp: int, data: bytes) -> None:
        """Write a message's CDR bytes under its stamp [ns], which is log time and publish time alike."""
        self.write_all([(topic, stamp, data)], {topic: topic})

    def write_all(self, records: Iterable[Record], names: Mapping[str, str]) -> None:
        """Write messages into one file, under the names of their topics: the same bytes as one by one."""
        self.file.write_all(records, names)

    @property
    def has_limits(self) -> bool:
        """Whether `split_if_due` ever begins a new file."""
        return self._limits != Limits()

    def split_if_due(self, stamp: int) -> None:
        """Go on in a new file if the present one is full, or would span too much with this stamp [ns].

        Raises:
            UsageError: the new file cannot be opened; the present one is then left as it is.
        """
        told, limits = self.file.mcap.statistics, self._limits
        if not told.message_count:
            return
        span = max(told.message_end_time, stamp) - min(told.message_start_time, stamp)
        if span >= limits.duration or self.file.mcap.size >= limits.size:
            self._split()

    def flush(self) -> None:
        """Hand all that was written to the operating system."""
        self.file.mcap.flush()
        self._settle(wait=False)

    def sync(self) -> None:
        """Have all that was flushed on the disk; may be called by another thread.

        Raises:
            OSError: it cannot be.
        """
        for file, _ in self._completing.copy():
            file.sync()
        self.file.sync()

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        """Write a metadata record."""
        self.file.mcap.add_metadata(name, values)

    def free_space(self) -> int:
        """[B] that are free on the disk that is written to.

        Raises:
            OSError: the file is not there any more.
        """
        return self.file.free_space()

    def close(self) -> None:
        """Complete the recording, and write `metadata.yaml` beside it unless it is alone, or that is another bag's."""
        self._settle(wait=True)
        self._list_at = -math.inf
        self._complete_file(self.file)
        self._end_thread()

    def discard(self) -> None:
        """Give up: leave no unfinished file behind."""
        self._end_thread()
        for file in (*(file for file, _ in self._completing), self.file):
            file.discard()

    def _split(self) -> None:
        """Everything is in the old file's `.partial` before the new one begins."""
        self.file.mcap.flush()
        earlier = {topic: self.file.next_number(topic) for topic in self._types}
        following = BagFile(*claim_first(self._names), self._compression, overwrite=False, earlier=earlier)
        for topic, type_name in self._types.items():
            following.add_topic(topic, type_name)
        following.mcap.add_metadata(CONTINUED, {"first": self.path.name})
        full, self.file = self.file, following
        if self._behind is None:
            self._behind = ThreadPoolExecutor(1, "completing")
        self._completing.append((full, self._behind.submit(self._complete_file, full)))

    def _complete_file(self, file: BagFile) -> None:
        """Both names change at nearly the same moment, so that a kill leaves a bag with all of its whole files.

        Of a hundred and more, `metadata.yaml` may not name the latest ones yet.
        """
        file.complete()
        asked, begun = file.path, time.thread_time()
        self._complete.append(file.facts())
        prepare = self._prepare_metadata if time.monotonic() >= self._list_at else self._leave_metadata
        try:
            put_metadata = prepare()
        finally:
            file.take_name()
        if file.path != asked:
            self.remarks.append(f"something took the name {asked} meanwhile: the recording is {file.path}")
            self._complete[-1] = file.facts()
            self.path = file.path if self.path == asked else self.path
            put_metadata = prepare()
        self._listed = put_metadata()
        if len(self._complete) >= MANY_FILES:
            self._list_at = max(self._list_at, time.monotonic() + (time.thread_time() - begun) / LISTING_SHARE)

    def _prepare_metadata(self) -> Callable[[], Identity | None]:
        if self._alone:
            return self._leave_metadata()
        return prepare_metadata(self.path.parent, information(self._complete, self._types), self._listed)

    def _leave_metadata(self) -> Callable[[], Identity | None]:
        """For a file that they will name later, if ever."""
        return lambda: self._listed

    def _settle(self, wait: bool) -> None:
        """Learn of the full files that have been completed, of all of them if it may take time.

        Raises:
            OSError: one could not be.
        """
        while self._completing and (wait or self._completing[0][1].done()):
            self._completing.pop(0)[1].result()

    def _end_thread(self) -> None:
        if self._behind:
            self._behind.shutdown()

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
