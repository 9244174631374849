"""Reading the answers of a recording as columns."""

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from knee_contact_ros.bags.answers import answer_blocks, answer_topics, read_answers, read_bag
from knee_contact_ros.model.types import FLAT, MESSAGE_FIELDS, blank_answers
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.columns import ADDED
from knee_contact_ros.streams.messages import encode_answer
from knee_contact_ros.streams.topics import MESSAGE_TYPES, definition, stamp_to_ns
from knee_contact_ros.system.errors import UsageError
from tests.helpers.answers import FIELDS
from tests.helpers.offline import solve

CONTACT = MESSAGE_TYPES["knee_contact"]


@pytest.fixture(scope="module")
def recording(right_bag, tmp_path_factory):
    path = tmp_path_factory.mktemp("answers") / "osteoarthritic.mcap"
    solve(right_bag, load_parameters(["osteoarthritis"]), path)
    return path


def test_columns_hold_the_numbers_of_the_messages(recording):
    answers = read_answers(recording)
    messages = [entry.message for entry in read_bag(recording, {"/knee_contact": CONTACT})]
    assert answers["stamp"].tolist() == [stamp_to_ns(message.header.stamp) for message in messages]
    for name in ("x", "y"):
        assert answers["contact_point"][name].tolist() == [
            getattr(message.contact_point, name) for message in messages
        ]
    for name in set(FIELDS) - {"contact_point"}:
        column = np.array(
            [getattr(message, name) for message in messages], dtype=answers[name].dtype
        )
        assert answers[name].tobytes() == column.tobytes(), name
    assert (
        len(set(answers["contact_state"].tolist())) == 2
    )  # cartilage and bone: the columns are not all alike
    assert answer_topics(recording) == ["/knee_contact"]


def message(stamp, frame):
    rows = blank_answers(1)
    for number, name in enumerate(MESSAGE_FIELDS):
        rows.view(FLAT)[name] = number
    return encode_answer(stamp, frame, rows.tobytes())


def test_recordings_from_before_a_field_stay_readable(old_recording, right_bag, tmp_path):
    solve(right_bag, load_parameters(["healthy"]), tmp_path / "now.mcap")
    old, now = read_answers(old_recording), read_answers(tmp_path / "now.mcap")
    assert old["stamp"].tolist() == now["stamp"].tolist()
    for name in MESSAGE_FIELDS:
        column = old.view(FLAT)[name]
        if name in ADDED:
            assert np.isnan(column).all(), name
        else:
            assert np.isfinite(column).all(), name
    assert (
        np.abs(old["penetration_depth"] - now["penetration_depth"]).max() < 2e-6
    )  # both within 1e-6 m of the exact one


def test_a_file_of_two_definitions_is_refused(old_recording, tmp_path):
    """As `mcap merge` makes it of an old and a new recording."""
    with old_recording.open("rb") as file:
        schema, _, entry = next(iter(make_reader(file).iter_messages("/knee_contact")))
    assert schema is not None
    with (tmp_path / "both.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        for number, (text, data) in enumerate(
            [(schema.data, entry.data), (definition(CONTACT), message(1, "tibia"))]
        ):
            schema_id = writer.register_schema(CONTACT, "ros2msg", text)
            channel = writer.register_channel("/knee_contact", "cdr", schema_id)
            for repeat in range(2):
                writer.add_message(channel, 2 * number + repeat, data, 0)
        writer.finish()
    with pytest.raises(
        UsageError, match="has several definitions of its messages: give its recordings one by one"
    ):
        read_answers(tmp_path / "both.mcap")


def test_unusable_recordings_are_one_line(tmp_path, right_bag, recording):
    with pytest.raises(UsageError, match="no bag at"):
        answer_topics(tmp_path / "nothing.mcap")
    with pytest.raises(UsageError, match="has no topic /knee_contact"):
        list(answer_blocks(right_bag))
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[:-5000])
    with pytest.raises(UsageError, match="knee-contact recover"):
        list(answer_blocks(cut))
