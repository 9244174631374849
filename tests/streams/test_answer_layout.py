"""Numbers of answers among their bytes, by whatever definition they came with."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.interfaces import MessageDefinition, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from knee_contact_ros.model.types import FLAT, MESSAGE_FIELDS, Contact, blank_answers
from knee_contact_ros.streams.columns import ADDED, TYPE, Column, decode_answers, places_of
from knee_contact_ros.streams.messages import encode_answer
from knee_contact_ros.streams.topics import NANOSECONDS, NO_DEFINITION, definition

TEXT = definition(TYPE).decode()
STAMPS = [3 * NANOSECONDS + 5, 4 * NANOSECONDS, 2**31 * NANOSECONDS - 1]


def described(text):
    return MessageDefinition(MessageDefinitionFormat.MSG, text)


def message(stamp, frame):
    rows = blank_answers(1)
    for number, name in enumerate(MESSAGE_FIELDS):
        rows.view(FLAT)[name] = number
    return encode_answer(stamp, frame, rows.tobytes())


def without(*names):
    """The present definition without some fields."""
    lines = TEXT.splitlines(keepends=True)
    return "".join(
        line for line in lines if not any(line.startswith(f"float64 {name} ") for name in names)
    )


def test_the_message_and_contact_have_the_same_fields_in_the_same_order():
    _, (_, *theirs) = get_types_from_msg(TEXT, TYPE)[TYPE]
    ours = list(Contact.__annotations__)
    assert [name for name, _ in theirs] == ours[: ours.index("contact_wrench")], (
        "msg/KneeContact.msg and Contact (knee_contact_ros/model/types.py) differ: a new field is in both"
    )


@pytest.mark.parametrize("definition_", [NO_DEFINITION, described(TEXT)])
def test_trailing_bytes_and_frames_of_other_lengths(definition_):
    frames, trailing = ("tibia", "a long frame", "tibia"), (b"", b"\1", b"\1\2\3")
    messages = [
        message(stamp, frame) + more
        for stamp, frame, more in zip(STAMPS, frames, trailing, strict=True)
    ]
    found = decode_answers(Column.of(messages), definition_)
    assert found["stamp"].tolist() == STAMPS
    assert [found.view(FLAT)[name].tolist() for name in MESSAGE_FIELDS] == [
        [number] * 3 for number in range(len(MESSAGE_FIELDS))
    ]


@settings(max_examples=15, deadline=None)
@given(
    st.sets(st.sampled_from(sorted(ADDED))),
    st.booleans(),
    st.text(max_size=9),
    st.lists(st.booleans(), max_size=2),
)
def test_every_definition_is_read_as_rosbags_does(missing, little_endian, frame, more):
    text, frame = without(*missing), frame.replace("\x00", "")
    for number, wide in enumerate(more):  # fields that this package does not know, in the middle
        text = text.replace(
            "float64 gap ", f"{'float32' if wide else 'bool'} unknown{number}\nfloat64 gap "
        )
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, TYPE))
    values = {name: float(number) for number, name in enumerate(MESSAGE_FIELDS)}
    integers = {
        name: int(values[name]) for name in ("contact_state", "fidelity", "status", "evaluations")
    }
    types = {name.rpartition("/")[2]: kind for name, kind in store.types.items()}
    point = types["Point"](*(values[f"contact_point_{axis}"] for axis in "xyz"))
    fields = (
        values
        | integers
        | {"contact_point": point}
        | {f"unknown{n}": True for n in range(len(more))}
    )
    fields["header"] = types["Header"](types["Time"](-7, 5), frame)
    names = [name for name, _ in store.fielddefs[TYPE][1]]
    data = bytes(
        store.serialize_cdr(
            store.types[TYPE](*(fields[name] for name in names)), TYPE, little_endian=little_endian
        )
    )
    rows = decode_answers(Column.of([data, data]), described(text))
    assert rows["stamp"].tolist() == [-7 * NANOSECONDS + 5] * 2
    for name, value in values.items():
        assert np.array_equal(
            rows.view(FLAT)[name], [np.nan if name in missing else value] * 2, equal_nan=True
        ), name


def test_fields_of_variable_size_end_the_known_layout():
    text = TEXT.replace("uint32 evaluations ", "uint32 evaluations\nstring words\nfloat64 later ")
    data = message(1, "tibia")
    (row,) = decode_answers(Column.of([data + b"\0" * 50]), described(text)).view(FLAT)
    assert [row[name] for name in MESSAGE_FIELDS] == list(range(len(MESSAGE_FIELDS)))
    with pytest.raises(ValueError, match="has no evaluations"):
        places_of(
            described(TEXT.replace("uint32 evaluations ", "string words\nuint32 evaluations "))
        )


@pytest.mark.parametrize(
    ("data", "text", "words"),
    [
        (b"short", TEXT, "not CDR"),
        (b"\x01" + message(1, "tibia")[1:], TEXT, "not CDR"),
        (message(1, "tibia")[:12] + struct.pack("<I", 2**31) + b"x", TEXT, "not CDR"),
        (message(1, "tibia")[:-1], TEXT, "longer or shorter"),
        (message(1, "tibia") + b"x" * 16, TEXT, "longer or shorter"),
        (message(1, "tibia"), without(*ADDED), "longer or shorter"),
        (message(1, "tibia"), without("load"), "has no load"),
        (message(1, "tibia"), "float64 load\n" + TEXT, "does not begin with a header"),
    ],
)
def test_a_message_that_does_not_fit_its_definition_is_refused(data, text, words):
    with pytest.raises(ValueError, match=words):
        decode_answers(Column.of([data]), described(text))
