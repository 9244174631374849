"""Recordings in several files: each is whole, together they are one bag, and nothing is lost in between."""

import threading
from resource import RLIMIT_NOFILE, getrlimit, setrlimit

import pytest
from mcap.reader import make_reader
from ruamel.yaml import YAML

from knee_contact_ros.bags.bag import Bag
from knee_contact_ros.bags.mcap_writer import McapWriter
from knee_contact_ros.bags.recorder import AnswerWriter, BagWriter, FileLimits
from knee_contact_ros.streams.topics import Ending
from knee_contact_ros.system.errors import UsageError
from tests.helpers.sinks import answer, recorded_ticks

MS = 1_000_000
"""[ns] between two answers"""
TICK = 4
"""Messages of an answer"""


def record(path, numbers, limits, compressed=True):
    """Record some answers."""
    with BagWriter(path, limits=limits, compressed=compressed) as bag:
        writer = AnswerWriter(bag, {})
        for number in numbers:
            writer.write_answer(answer(number).records)
        writer.write_ending(Ending((), {"not_finite": 3}))


def information(folder):
    """What `metadata.yaml` says."""
    return YAML(typ="safe").load((folder / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]


def stamps_of(path):
    """The stamps [ms] of all messages of a file."""
    with path.open("rb") as file:
        return [
            message.log_time // MS
            for _, _, message in make_reader(file, validate_crcs=True).iter_messages()
        ]


def sequences(paths):
    """The sequence numbers of the messages of several files, by topic."""
    found: dict[str, list[int]] = {}
    for path in paths:
        with path.open("rb") as file:
            for _, channel, message in make_reader(file).iter_messages():
                found.setdefault(channel.topic, []).append(message.sequence)
    return found


def names(folder):
    """Of all files."""
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.parametrize("first", ["knee.mcap", "knee_0.mcap"])
def test_files_have_their_order_where_the_clock_was_set_back(tmp_path, first):
    record(tmp_path / first, [*range(300, 450), *range(150)], FileLimits(duration=100 * MS))
    with Bag(tmp_path) as bag:
        found = [file.path.name for file in bag.files]
    assert found == [first, *(f"knee_{number}.mcap" for number in range(1, len(found)))]
    assert len(found) == 4


@pytest.mark.parametrize("first", ["knee.mcap", "knee_0.mcap"])
def test_a_recording_is_split_by_duration(tmp_path, first):
    record(tmp_path / first, range(250), FileLimits(duration=100 * MS))
    files = [first, "knee_1.mcap", "knee_2.mcap"]
    assert names(tmp_path) == sorted([*files, "metadata.yaml"])
    spans = [range(100), range(100, 200), range(200, 250)]
    assert [stamps_of(tmp_path / name) for name in files] == [
        [n for n in span for _ in range(TICK)] for span in spans
    ]
    numbers = sequences([tmp_path / name for name in files])
    assert len(numbers) == TICK
    assert all(each == list(range(250)) for each in numbers.values())
    found = information(tmp_path)
    assert found["version"] == 9
    assert found["relative_file_paths"] == files
    assert found["message_count"] == 250 * TICK
    assert found["duration"]["nanoseconds"] == 249 * MS
    assert found["files"] == [
        {
            "path": name,
            "starting_time": {"nanoseconds_since_epoch": span[0] * MS},
            "duration": {"nanoseconds": (len(span) - 1) * MS},
            "message_count": len(span) * TICK,
        }
        for name, span in zip(files, spans, strict=True)
    ]
    assert {topic["message_count"] for topic in found["topics_with_message_count"]} == {
        0,
        250,
    }  # no leg


def test_a_recording_is_split_by_size(tmp_path):
    record(tmp_path / "knee_0.mcap", range(3000), FileLimits(size=200_000), compressed=False)
    files = information(tmp_path)["relative_file_paths"]
    assert len(files) > 3
    assert [n for name in files for n in stamps_of(tmp_path / name)[::TICK]] == list(range(3000))
    for name in files[:-1]:
        assert (
            200_000 <= (tmp_path / name).stat().st_size < 350_000
        )  # a chunk and what ends a file come on top
        assert len(stamps_of(tmp_path / name)) % TICK == 0


def test_more_files_than_a_shell_lets_be_open_are_read(tmp_path):
    record(tmp_path / "knee.mcap", range(20), FileLimits(duration=MS))
    before = getrlimit(RLIMIT_NOFILE)
    with (tmp_path / "knee.mcap").open() as file:  # it has the next number
        setrlimit(RLIMIT_NOFILE, (file.fileno() + 15, before[1]))
    try:
        assert recorded_ticks(tmp_path) == list(range(20))
    finally:
        setrlimit(RLIMIT_NOFILE, before)


def test_a_slow_disk_does_not_hold_up_what_comes_after_a_split(tmp_path, monkeypatch):
    goes_on, complete = threading.Event(), McapWriter.complete

    def slow(file):
        assert goes_on.wait(30.0)
        complete(file)

    monkeypatch.setattr(McapWriter, "complete", slow)
    bag = BagWriter(tmp_path / "knee.mcap", limits=FileLimits(duration=100 * MS))
    writer = AnswerWriter(bag, {})
    for number in range(250):
        writer.write_answer(answer(number).records)
    bag.flush()
    assert names(tmp_path) == ["knee.mcap.partial", "knee_1.mcap.partial", "knee_2.mcap.partial"]
    goes_on.set()
    bag.close()
    assert names(tmp_path) == ["knee.mcap", "knee_1.mcap", "knee_2.mcap", "metadata.yaml"]


def test_a_next_file_that_cannot_be_opened_leaves_what_was_written(tmp_path):
    folder = tmp_path / "bag"
    bag = BagWriter(folder / "knee.mcap", limits=FileLimits(duration=100 * MS))
    writer = AnswerWriter(bag, {})
    for number in range(100):
        writer.write_answer(answer(number).records)
    moved = folder.rename(tmp_path / "moved")
    folder.write_text("a file where the folder was")
    with pytest.raises(UsageError, match=r"cannot write .*knee_1\.mcap"):
        writer.write_answer(answer(100).records)
    assert (moved / "knee.mcap.partial").stat().st_size > 5000


def test_another_bags_metadata_is_left_alone(tmp_path):
    record(tmp_path / "first.mcap", range(250), FileLimits(duration=100 * MS))
    before = information(tmp_path)
    record(tmp_path / "second.mcap", range(250), FileLimits(duration=100 * MS))
    assert information(tmp_path) == before
    assert (tmp_path / "second_2.mcap").exists()
