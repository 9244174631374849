"""Schemas and channels of an MCAP file, also those whose record is damaged where another one repeats it."""

from __future__ import annotations

from typing import Generic, NamedTuple, TypeVar

from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from knee_contact_ros.bags.recovery.records import Record, parsed

Declared = TypeVar("Declared", Schema, Channel)


class Stream(NamedTuple):
    """A channel with its schema."""

    channel: Channel
    schema: Schema | None


class _Numbered(Generic[Declared]):
    """What numbers mean: the first declaration counts, and a doubtful one if there is no other."""

    def __init__(self) -> None:
        self.sure: dict[int, Declared] = {}
        self.doubtful: dict[int, Declared] = {}
        self.contradictions = 0

    def add(self, declared: Declared, doubtful: bool) -> None:
        """Take a declaration."""
        if doubtful:
            self.doubtful.setdefault(declared.id, declared)
        elif self.sure.setdefault(declared.id, declared) != declared:
            self.contradictions += 1

    def all(self) -> dict[int, Declared]:
        """All that count."""
        return self.doubtful | self.sure


class Catalogue:
    """What the channel numbers of a file mean."""

    def __init__(self) -> None:
        self._schemas = _Numbered[Schema]()
        self._channels = _Numbered[Channel]()
        self._topics: set[str] = set()  # of the channels that are sure
        self._renumbered: list[str] = []
        self._unreadable = 0

    def add(self, record: Record, *, doubtful: bool = False, in_summary: bool = False) -> None:
        """Take the record of a schema or a channel; others are ignored. A damaged chunk's are doubtful."""
        found = parsed(record)
        if isinstance(found, Schema):
            self._schemas.add(found, doubtful)
        elif isinstance(found, Channel):
            if in_summary and found.id not in self._channels.sure and found.topic in self._topics:
                self._renumbered.append(found.topic)
            self._channels.add(found, doubtful)
            if not doubtful:
                self._topics.add(found.topic)
        elif record.opcode in {Opcode.SCHEMA, Opcode.CHANNEL} and not doubtful:
            self._unreadable += 1

    def streams(self) -> dict[int, Stream]:
        """All channels that have no schema, or one that is known."""
        schemas = self._schemas.all()
        return {
            number: Stream(channel, schemas.get(channel.schema_id))
            for number, channel in self._channels.all().items()
            if channel.schema_id == 0 or channel.schema_id in schemas
        }

    def faults(self) -> list[str]:
        """What is wrong with the declarations."""
        texts = []
        if self._schemas.contradictions + self._channels.contradictions:
            texts.append("topics are declared in contradictory ways; the first one counts")
        if self._unreadable:
            texts.append(f"{self._unreadable} declarations of topics cannot be read")
        if self._renumbered:
            texts.append(f"the summary numbers {', '.join(sorted(self._renumbered))} differently")
        doubtful = [c.topic for number, c in self._channels.doubtful.items() if number not in self._channels.sure]
        if doubtful:
            texts.append(f"only a damaged chunk declares {', '.join(sorted(doubtful))}")
        return texts
