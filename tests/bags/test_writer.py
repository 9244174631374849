"""Recordings: what is written is what other people's readers read."""

import json
import sys
from collections import Counter
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from ruamel.yaml import YAML

from knee_contact_ros.bags.answers import read_bag
from knee_contact_ros.bags.mcap_writer import CHUNK_SIZE, LIBRARY, MESSAGE_HEAD
from knee_contact_ros.bags.metadata_file import offered_qos
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.streams.messages import encode_answer
from knee_contact_ros.streams.topics import (
    KNEE_CONTACT,
    KNEE_CONTACT_WRENCH,
    MESSAGE_TYPES,
    definition,
    typestore,
)
from knee_contact_ros.system.errors import UsageError
from tests.helpers.answers import contact

NAMES = {topic: f"/{topic}" for topic in (KNEE_CONTACT, KNEE_CONTACT_WRENCH)}
FULL = CHUNK_SIZE - MESSAGE_HEAD.size
"""[B] of a message's data that fill a chunk to the limit, which is not beyond it"""
Said = list[tuple[str, int, int]] | str
"""Topic, log time [ns] and length of the data [B] of some messages, or `flush` or `note`"""
said = st.lists(
    st.tuples(
        st.sampled_from(list(NAMES)),
        st.integers(0, 2**64 - 1),
        st.sampled_from([0, 1, 40, 30_000, FULL, FULL + 1]),
    ),
    max_size=12,
)


def write_by_library(path, like, parts, compressed):
    """The same by the `mcap` library's writer; the last metadata are those of our file."""
    with path.open("wb") as file, like.open("rb") as ours:
        compression = CompressionType.ZSTD if compressed else CompressionType.NONE
        writer = Writer(
            file, chunk_size=CHUNK_SIZE, compression=compression, enable_data_crcs=True
        )
        writer.start("ros2", LIBRARY)
        channels, numbers = {}, Counter[str]()
        for topic, name in NAMES.items():
            kind = MESSAGE_TYPES[topic]
            metadata = {
                "offered_qos_profiles": offered_qos(kind),
                "topic_type_hash": typestore().hash_rihs01(kind),
            }
            schema = writer.register_schema(kind, "ros2msg", definition(kind))
            channels[topic] = writer.register_channel(name, "cdr", schema, metadata)
        for part in parts:
            if part == "flush":
                writer.flush()
            elif isinstance(part, str):
                writer.add_metadata(part, {"reason": "ü", "": ""})
            else:
                for topic, stamp, length in part:
                    writer.add_message(
                        channels[topic], stamp, bytes(length), stamp, numbers[topic]
                    )
                    numbers[topic] += 1
        *_, last = make_reader(ours).iter_metadata()
        writer.add_metadata(last.name, last.metadata)
        writer.finish()


@settings(max_examples=40, deadline=None)
@given(
    parts=st.lists(said | st.sampled_from(["flush", "note"]), max_size=6), compressed=st.booleans()
)
def test_a_file_has_the_bytes_of_the_librarys_writer(tmp_path_factory, parts, compressed):
    """Over the ends of chunks, with stamps that go back; also files without messages."""
    folder = tmp_path_factory.mktemp("bags")
    with BagWriter(folder / "out.mcap", compressed=compressed) as bag:
        for topic, name in NAMES.items():
            bag.add_topic(name, MESSAGE_TYPES[topic])
        for part in parts:
            if part == "flush":
                bag.file.flush()
            elif isinstance(part, str):
                bag.add_metadata(part, {"reason": "ü", "": ""})
            else:
                bag.file.write_records(
                    [(topic, stamp, bytes(length)) for topic, stamp, length in part], NAMES
                )
    write_by_library(folder / "library.mcap", folder / "out.mcap", parts, compressed)
    assert (folder / "library.mcap").read_bytes() == (folder / "out.mcap").read_bytes()


CONTACT = contact()
MESSAGE = encode_answer(1, "", CONTACT.tobytes())


@pytest.mark.parametrize("name", sorted(set(MESSAGE_TYPES.values())))
def test_type_hashes_are_those_of_the_built_messages(name):
    package, _, message = name.split("/")
    built = Path(sys.prefix) / "share" / package / "msg" / f"{message}.json"
    if not built.exists():
        pytest.skip(f"needs the ROS package {package}")
    hashes = {
        entry["type_name"]: entry["hash_string"]
        for entry in json.loads(built.read_text())["type_hashes"]
    }
    assert typestore().hash_rihs01(name) == hashes[name]


@pytest.mark.parametrize(
    ("taken", "words"),
    [
        ("out.mcap", r"out\.mcap exists already"),
        (
            "out.mcap.partial",
            r"was cut off: `knee-contact recover \S*out.mcap.partial\S* OUT.mcap` makes it whole",
        ),
    ],
)
def test_an_existing_file_is_kept(tmp_path, taken, words):
    (tmp_path / taken).write_text("all that is left")
    with pytest.raises(UsageError, match=words):
        BagWriter(tmp_path / "out.mcap")
    assert (tmp_path / taken).read_text() == "all that is left"


def test_a_file_that_appears_meanwhile_is_kept(tmp_path):
    path = tmp_path / "rec.mcap"
    with BagWriter(path) as bag:
        bag.add_topic("/knee_contact", MESSAGE_TYPES[KNEE_CONTACT])
        bag.write_message("/knee_contact", 1, MESSAGE)
        path.write_text("another's")
    assert path.read_text() == "another's"
    assert bag.path == tmp_path / "rec_1.mcap"
    assert len(read_bag(bag.path, {"/knee_contact": MESSAGE_TYPES[KNEE_CONTACT]})) == 1
    assert bag.remarks == [
        f"something took the name {path} meanwhile: the recording is {bag.path}"
    ]
    information = YAML(typ="safe").load((tmp_path / "metadata.yaml").read_text())[
        "rosbag2_bagfile_information"
    ]
    assert information["relative_file_paths"] == ["rec_1.mcap"]
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "metadata.yaml",
        "rec.mcap",
        "rec_1.mcap",
    ]
