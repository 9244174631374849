"""Bags as people's recorders leave them: clocks that are set back, files that overlap, messages written late."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin

import knee_contact_ros
from knee_contact_ros.bags.provenance import provenance_record
from knee_contact_ros.bags.reader import BagReader, RawMessage, read_answers
from knee_contact_ros.bags.recorder import AnswerWriter, BagWriter
from knee_contact_ros.commands.main import main
from knee_contact_ros.model.types import Status
from knee_contact_ros.offline.solve import solve
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.contact_stream import ContactStream
from knee_contact_ros.streams.topics import JOINT_STATES, KNEE_CONTACT, MESSAGE_TYPES
from tests.helpers.bags import Mcap, write_rosbag2
from tests.helpers.messages import raw_inputs

STEP = 5_000_000
MOMENT = 600
"""Index of the message before which something happens: in stance"""


@pytest.fixture(scope="module")
def gait(right_bag: Path) -> list[RawMessage]:
    return raw_inputs(right_bag)


def moved(message: RawMessage, by: int, log_by: int | None = None) -> RawMessage:
    """A message with another stamp, and another log time if that is not moved likewise."""
    seconds, nanoseconds = divmod(
        int.from_bytes(message.data[4:8], "little") * 10**9 + int.from_bytes(message.data[8:12], "little") + by, 10**9
    )
    stamp = seconds.to_bytes(4, "little", signed=True) + nanoseconds.to_bytes(4, "little")
    data = message.data[:4] + stamp + message.data[12:]
    return RawMessage(message.topic, message.log_time + (by if log_by is None else log_by), data)


def mcap(path: Path, messages: Sequence[RawMessage]) -> Path:
    """A file of small chunks, with the messages in this order."""
    file = Mcap(path)
    channels = file.channels()
    for message in messages:
        file.write(channels[message.topic], message)
    return file.close()


def live(messages: Sequence[RawMessage], path: Path | None = None) -> list[bytes]:
    """The answers to messages in the order of their arrival; with a `path`, the recording of them is there."""
    parameters = load_parameters({})
    pipeline, answers = ContactStream(parameters, compiled=False), []
    for message in messages:
        answers += (pipeline.joint_state if message.topic == f"/{JOINT_STATES}" else pipeline.force)(message.data)
    answers += pipeline.finish()
    if path:
        with BagWriter(path) as bag:
            writer = AnswerWriter(bag, provenance_record(parameters, {}))
            for answer in answers:
                writer.write(answer.records)
            writer.finish(pipeline.ending())
    return [data for answer in answers for topic, _, data in answer.records if topic == KNEE_CONTACT]


def split(folder: Path, parts: Sequence[Sequence[RawMessage]]) -> Path:
    """A folder of numbered files, as when `metadata.yaml` was lost."""
    folder.mkdir()
    for number, part in enumerate(parts):
        mcap(folder / f"bag_{number}.mcap", part)
    return folder


def solved(bag: Path, tmp_path: Path) -> list[bytes]:
    solve(bag, load_parameters({}), tmp_path / "out.mcap", lambda _done, _total: None, overwrite=True, compiled=False)
    topic = f"/{KNEE_CONTACT}"
    with BagReader(tmp_path / "out.mcap", {topic: MESSAGE_TYPES[KNEE_CONTACT]}) as reader:
        return [message.data for message in reader.raw_messages()]


FORMS = {
    "file": lambda folder, messages: mcap(folder / "in.mcap", messages),
    "sqlite3": lambda folder, messages: write_rosbag2(folder / "in", messages, StoragePlugin.SQLITE3),
    "split": lambda folder, messages: split(folder / "in", [messages[:MOMENT], messages[MOMENT:]]),
}
"""Ways of writing messages in their order"""


@pytest.mark.parametrize("form", [*FORMS, "recording"])
@pytest.mark.parametrize(
    ("of", "back", "resets"),
    [("", 7_000_000, 0), ("", 602_500_000, 1), ("", 10**12, 1), ("states", 700_000_000, 0), ("force", 700_000_000, 1)],
)
def test_time_that_goes_back_makes_runs_of_their_own_as_live(
    gait: list[RawMessage], tmp_path: Path, form: str, of: str, back: int, resets: int
) -> None:
    """The clock of all topics, or of one, is set back: by a sample, within and beyond what was recorded."""
    later = [moved(message, 2 * 10**12) for message in gait]
    messages = [moved(each, -back) if i >= MOMENT and of in each.topic else each for i, each in enumerate(later)]
    recording = tmp_path / "recording.mcap"
    expected = live(messages, recording)
    bag = recording if form == "recording" else FORMS[form](tmp_path, messages)
    assert solved(bag, tmp_path) == expected or (form, resets) == ("recording", 0)  # it has no refused samples
    status = read_answers(tmp_path / "out.mcap")["status"]
    assert (len(status), np.count_nonzero(status & Status.TIME_RESET)) == (len(expected), resets)


def test_a_loop_is_as_many_runs_in_table_and_results(
    gait: list[RawMessage], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recording = tmp_path / "loop.mcap"
    once = len(live([*gait, *gait, *gait], recording)) // 3
    assert main(["solve", str(recording), "--output", str(tmp_path / "out.mcap")]) == 0
    out, err = capsys.readouterr()
    assert "the answers are of 3 runs: each begins at rest (TIME_RESET), where stamps went back" in err
    assert f"{3 * once} over {3 * 1.93:.2f} s in 3 runs" in out
    rows = [line.split() for line in out.splitlines() if line.startswith(" peak")]
    assert [row[-1] for row in rows] == ["1"] * 4 + ["2"] * 4 + ["3"] * 4
    assert len({tuple(row[2:-1]) for row in rows}) == 4


def test_the_runs_have_a_column(gait: list[RawMessage], tmp_path: Path) -> None:
    pytest.importorskip("pandas")
    with pytest.warns(UserWarning, match="the answers are of 2 runs"):
        results = knee_contact_ros.solve(mcap(tmp_path / "twice.mcap", [*gait, *gait]))
    assert results.run.tolist() == results.to_pandas()["run"].tolist() == [0] * 387 + [1] * 387
    assert "774 ticks over 3.860 s in 2 runs" in repr(results)


LATE = slice(MOMENT, MOMENT + 30)


def without(messages: list[RawMessage], part: slice) -> list[RawMessage]:
    return messages[: part.start] + messages[part.stop :]


def by_topic(messages: list[RawMessage]) -> list[list[RawMessage]]:
    topics = sorted({message.topic for message in messages})
    return [[message for message in messages if message.topic == topic] for topic in topics]


UNORDERED = {
    "30 messages in the next file": lambda g: [without(g[:650], LATE), [*g[LATE], *g[650:]]],
    "30 messages in the file before": lambda g: [[*g[: LATE.start], *g[700:730]], [*g[LATE.start : 700], *g[730:]]],
    "30 messages late in a file": lambda g: [[*without(g[:650], LATE), *g[LATE], *g[650:]]],
    "one message late in a file": lambda g: [[*g[:MOMENT], *g[MOMENT + 1 : MOMENT + 9], g[MOMENT], *g[MOMENT + 9 :]]],
    "a file per topic": by_topic,
    "a topic behind the other": lambda g: [[*by_topic(g)[0], *by_topic(g)[1]]],
    "backwards": lambda g: [g[::-1]],
}


@pytest.mark.parametrize("case", UNORDERED)
def test_what_was_written_late_or_elsewhere_comes_in_its_place(
    gait: list[RawMessage], tmp_path: Path, case: str
) -> None:
    bag = split(tmp_path / "in", UNORDERED[case](gait))
    assert solved(bag, tmp_path) == live(gait)
