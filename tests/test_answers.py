"""Reading the answers of a recording as columns."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from knee_contact_ros.cdr_blocks import decode_contacts
from knee_contact_ros.cdr_out import encode_numbers
from knee_contact_ros.core.ticks import ANSWER
from knee_contact_ros.errors import UsageError
from knee_contact_ros.messages import NANOSECONDS, stamp_to_ns
from knee_contact_ros.parameters import load_parameters
from knee_contact_ros.record import BagWriter
from knee_contact_ros.solve import solve
from knee_contact_ros.stream_in.answers import Answers, answer_blocks, answer_topics, read_answers
from knee_contact_ros.stream_in.bag import read_bag
from knee_contact_ros.topics import MESSAGE_TYPES

CONTACT = MESSAGE_TYPES["knee_contact"]


@pytest.fixture(scope="module")
def recording(config: Path, right_bag: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("answers") / "osteoarthritic.mcap"
    solve(right_bag, load_parameters([config / "osteoarthritis.yaml"]), path, lambda *_: None)
    return path


def test_columns_hold_what_the_messages_say(recording: Path) -> None:
    answers = read_answers(recording)
    messages = [entry.message for entry in read_bag(recording, {"/knee_contact": CONTACT})]
    assert answers.stamps.tolist() == [stamp_to_ns(message.header.stamp) for message in messages]
    assert answers.contact_point_x.tolist() == [message.contact_point.x for message in messages]
    assert answers.contact_point_y.tolist() == [message.contact_point.y for message in messages]
    for name in set(Answers._fields) - {"stamps", "contact_point_x", "contact_point_y"}:
        assert getattr(answers, name).tolist() == [getattr(message, name) for message in messages], name
    assert len(set(answers.contact_state.tolist())) == 2  # cartilage and bone: the columns are not all alike
    assert answer_topics(recording) == ["/knee_contact"]


def message(stamp: int, frame: str) -> bytes:
    return encode_numbers(stamp, frame, [float(number) for number in range(ANSWER)], 0)


def test_frames_of_different_length_and_trailing_bytes(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "x.mcap") as bag:
        bag.add_topic("/left/knee_contact", CONTACT)
        for number, data in enumerate([message(1, "tibia"), message(2, "a long frame"), message(3, "") + b"\x00" * 3]):
            bag.write("/left/knee_contact", number, data)
    answers = read_answers(tmp_path / "x.mcap", "/left/knee_contact")
    assert answers.stamps.tolist() == [1, 2, 3]
    for number, name in enumerate(Answers._fields[1:]):
        assert getattr(answers, name).tolist() == [float(number)] * 3, name
    assert answer_topics(tmp_path / "x.mcap") == ["/left/knee_contact"]


def test_blocks_of_one_layout_are_decoded_at_once() -> None:
    stamps = [3 * NANOSECONDS + 5, 4 * NANOSECONDS, 2**31 * NANOSECONDS - 1]
    found = decode_contacts(
        [message(stamp, "tibia") + trailing for stamp, trailing in zip(stamps, (b"", b"\1", b""), strict=True)]
    )
    assert found is not None
    assert found[0].tolist() == stamps
    assert np.array_equal(found[1], [list(range(16))] * 3)
    assert decode_contacts([message(1, "tibia"), message(1, "femur2")]) is None
    assert decode_contacts([b"\x00\x00" + message(1, "tibia")[2:]]) is None  # big-endian
    assert decode_contacts([b"short"]) is None


def test_unusable_recordings_are_one_line(tmp_path: Path, right_bag: Path, recording: Path) -> None:
    with pytest.raises(UsageError, match="no recording at"):
        answer_topics(tmp_path / "nothing.mcap")
    with pytest.raises(UsageError, match="has no topic /knee_contact"):
        list(answer_blocks(right_bag))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[:-5000])
    with pytest.raises(UsageError, match="knee-contact recover"):
        list(answer_blocks(cut))


def test_progress_reaches_the_end(recording: Path) -> None:
    told: list[tuple[int, int]] = []
    list(answer_blocks(recording, advance=lambda done, count: told.append((done, count))))
    assert told[-1] == (387, 387)
