"""Power that fails between two calls of the disk: what a recording is then worth."""

from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

from knee_contact_ros.bags.recorder import FileLimits, RecorderSettings
from knee_contact_ros.bags.recover import recover
from knee_contact_ros.system.errors import UsageError
from tests.helpers.patience import wait_until
from tests.helpers.sinks import close, put, recorded_ticks

SETTINGS = RecorderSettings(0.02, FileLimits(duration=50_000_000), sync_period=0.05)
FOLDER = "bag"
RECORDING = "out.mcap"


class Call(NamedTuple):
    """What a program had its disk do."""

    what: str
    path: Path
    other: Path
    offset: int
    data: bytes


def calls(log):
    """What was called so far."""
    lines = [
        line.split("\t") for line in log.read_text().split("\n")[:-1]
    ]  # the last one may not be there as a whole
    return [
        Call(what, Path(path), Path(other), int(offset), bytes.fromhex(data))
        for what, path, other, offset, data in lines
    ]


@pytest.fixture
def log(watching, tmp_path, monkeypatch):
    """Log of the calls in a folder, for recorders that are started in this test."""
    monkeypatch.setenv("LD_PRELOAD", str(watching))
    monkeypatch.setenv("WATCHED_FOLDER", str(tmp_path / FOLDER))
    monkeypatch.setenv("WATCHED_LOG", str(tmp_path / "log"))
    return tmp_path / "log"


class Disk:
    """What a log of calls leaves on a disk when the power fails."""

    def __init__(self):
        self.names: dict[Path, list[Call]] = {}
        """What was written into the file of a name; two names may have one file"""
        self.former: dict[Path, list[Call]] = {}
        """Likewise by the names before: a file may get its name while a thread has it synced"""
        self.kept_names: dict[Path, list[Call]] = {}
        self.kept: dict[int, int] = {}
        """How many of a file's writes are on the disk for certain, by its list"""

    def take(self, call):
        """Do what was called."""
        if call.what == "create":
            self.names[call.path] = []
        elif call.what == "write":
            self.names[call.path].append(call)
        elif call.what == "linkat":
            self.names[call.other] = self.names[call.path]
        elif call.what == "rename":
            self.names[call.other] = self.former[call.path] = self.names.pop(call.path)
        elif call.what == "unlink":
            self.former[call.path] = self.names.pop(call.path)
        elif call.what in ("fsync", "fdatasync") and call.path.name != FOLDER:
            writes = self.names[call.path] if call.path in self.names else self.former[call.path]
            self.kept[id(writes)] = len(writes)
        elif call.what == "fsync":
            self.kept_names = dict(self.names)

    def left(self, how):
        """The files: their names and bytes."""
        names = self.names if how == "all" else self.kept_names
        for path, writes in names.items():
            kept = self.kept.get(id(writes), 0)
            certain, rest = writes[:kept], writes[kept:]
            if how == "torn" and rest:
                rest = [
                    *rest[:-1],
                    rest[-1]._replace(data=rest[-1].data[: len(rest[-1].data) // 2]),
                ]
            elif how == "zeros":
                rest = [write._replace(data=bytes(len(write.data))) for write in rest]
            elif how == "backwards":
                rest = [write._replace(data=bytes(len(write.data))) for write in rest[:-1]] + rest[
                    -1:
                ]
            elif how == "nothing":
                rest = []
            yield path, content(certain + rest)


def content(writes):
    """Of a file."""
    data = bytearray()
    for write in writes:
        data[write.offset : write.offset + len(write.data)] = write.data
    return bytes(data)


HOW = ("nothing", "torn", "zeros", "backwards", "all")
"""What becomes of that which was not asked for to be on the disk"""


def test_synced_answers_survive_a_power_failure(log, started, tmp_path):
    path, numbers = tmp_path / FOLDER / RECORDING, 0
    sink = started.recorder(path, settings=SETTINGS)
    for number in (30, 45, 80):  # the recording goes on in a new file meanwhile
        put(sink, range(numbers, number))
        numbers = number
        wait_until(
            lambda number=number: synced(calls(log), tmp_path) == number
        )  # while it is written
    close(sink)
    assert (sink.failure, started.told) == ("", [])

    disk, most = Disk(), 0
    for number, call in enumerate(calls(log)):
        disk.take(call)
        for how in HOW:
            certain = found_on(disk, how, tmp_path / "left")
            most = max(most, certain) if how == "nothing" else most
            assert certain >= most, f"after call {number}, {call[:3]}, {how}"
    assert most == numbers


def synced(made, place):
    """How many answers are on the disk for certain."""
    disk = Disk()
    for call in made:
        disk.take(call)
    return found_on(disk, "nothing", place / "so_far")


def found_on(disk, how, folder):
    """How many answers, without holes, `recover` finds on a disk on which the power has failed."""
    found: set[int] = set()
    for path, data in disk.left(how):
        if ".mcap" in path.name:
            found |= found_in(data, folder)
    return next(number for number in range(len(found) + 1) if number not in found)


@cache
def found_in(data, folder):
    """The numbers of the answers that `recover` finds in a file; it works in `folder`."""
    folder.mkdir(exist_ok=True)
    (folder / RECORDING).write_bytes(data)
    try:
        recover(folder / RECORDING, folder / "new" / RECORDING, overwrite=True)
    except UsageError:  # it holds no message
        return frozenset()
    return frozenset(recorded_ticks(folder / "new" / RECORDING))
