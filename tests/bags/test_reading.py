"""Bags from other recorders' hands: the same messages whatever the storage, and one line for what cannot be read."""

import itertools
from collections.abc import Callable
from pathlib import Path

import pytest
import zstandard
from mcap.writer import CompressionType
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from knee_contact_ros.bags.bag import INPUT_TYPES, Bag, RawMessage
from knee_contact_ros.bags.names import names_in_bag
from knee_contact_ros.system.errors import UsageError
from tests.helpers.bags import Mcap, raw_messages, write_rosbag2, write_split

ANGLE, FORCE = INPUT_TYPES
SQLITE, MCAP = StoragePlugin.SQLITE3, StoragePlugin.MCAP
Kind = Callable[[Path, list[RawMessage]], Path]


@pytest.fixture(scope="module")
def gait(request):
    return raw_messages(request.getfixturevalue("right_bag"))


def lz4_file(folder, messages):
    mcap = Mcap(folder.with_suffix(".mcap"), CompressionType.LZ4)
    channels = mcap.channels()
    for message in messages:
        mcap.write(channels[message.topic], message)
    return mcap.close()


def kind(storage, mode="NONE", split=False, alone=False):
    """A bag in a folder, in one file or several, or its only file alone."""

    def make(folder, messages):
        bag = (write_split if split else write_rosbag2)(
            folder, messages, storage, CompressionMode[mode]
        )
        return (
            next(path for path in bag.iterdir() if path.name != "metadata.yaml") if alone else bag
        )

    return make


KINDS: dict[str, Kind] = {
    f"{storage.name}, {mode}{', split' * split}{', the file' * alone}": kind(
        storage, mode, split, alone
    )
    for storage, mode, split, alone in [
        *itertools.product((SQLITE, MCAP), ("NONE", "FILE", "MESSAGE"), (False, True), (False,)),
        *itertools.product((SQLITE, MCAP), ("NONE",), (False,), (True,)),
        (MCAP, "STORAGE", False, False),
    ]
} | {
    "sqlite3, metadata version 8": lambda f, m: write_rosbag2(f, m, SQLITE, version=8),
    "mcap, lz4": lz4_file,
}


@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
def test_every_kind_of_bag_gives_the_same_messages(kind, gait, tmp_path):
    path = kind(tmp_path / "bag", gait)
    with Bag(path) as bag:
        reader = bag.select()
        assert reader.message_count == len(gait)
        assert list(reader.raw_messages()) == gait
        assert list(reader.raw_messages()) == gait  # once more, as for a loop
        middle, late = gait[200].log_time, gait[600].log_time
        part = [message for message in gait if middle <= message.log_time < late]
        assert list(reader.raw_messages(start=middle, stop=late)) == part
        assert bag.end > gait[-1].log_time


def test_a_topic_on_two_channels_is_one_stream(gait, tmp_path):
    """As of two publishers, or of two files that were merged."""
    mcap = Mcap(tmp_path / "bag.mcap")
    first, second = mcap.channels(), mcap.channels()
    assert first != second
    for number, message in enumerate(gait):
        mcap.write((first if number % 3 else second)[message.topic], message)
    assert raw_messages(mcap.close()) == gait


@pytest.mark.parametrize("profile", ["ros2", "", "x-lab"])
def test_messages_of_other_kinds_and_profiles_do_not_matter(profile, gait, tmp_path):
    mcap = Mcap(tmp_path / "bag.mcap", profile=profile)
    mcap.channel(ANGLE, WRENCH)  # a second type, without messages
    channels = mcap.channels()
    log = mcap.channel("/log", "Log", schema_encoding="jsonschema", encoding="json")
    for message in gait:
        mcap.write(channels[message.topic], message)
        mcap.write(log, message._replace(data=b"{}"))
    path = mcap.close()
    assert raw_messages(path) == gait
    with Bag(path) as bag:
        part = bag.select().raw_messages(start=gait[300].log_time, stop=gait[302].log_time)
        assert list(part) == gait[300:302]


@pytest.mark.parametrize(
    ("remaps", "namespace", "words"),
    [
        (["joint_states"], "", "it must be NAME:=VALUE"),
        (["joint_states:="], "", "it must be NAME:=VALUE"),
        (
            ["/imu:=joint_states"],
            "",
            "FROM must be joint_states or joint_reaction_force, the input",
        ),
        (["joint_states:=a", "joint_states:=b"], "", "remapped twice"),
        (
            ["joint_states:=joint_reaction_force"],
            "",
            "two inputs cannot both be /joint_reaction_force",
        ),
        ([], "/", "it must be a name"),
    ],
)
def test_a_wrong_rule_is_refused_with_advice(remaps, namespace, words):
    with pytest.raises(UsageError) as caught:
        names_in_bag(remaps, namespace)
    assert words in str(caught.value)


def empty(path, channels, encoding="cdr"):
    """A file whose channels have one message each."""
    mcap = Mcap(path)
    for number, (topic, kind) in enumerate(channels):
        mcap.write(mcap.channel(topic, kind, encoding=encoding), RawMessage(topic, number, b""))
    return mcap.close()


STATE, WRENCH = INPUT_TYPES.values()


@pytest.mark.parametrize(
    ("channels", "words"),
    [
        (
            [("/left/joint_states", STATE), (FORCE, WRENCH)],
            "has no topic /joint_states (sensor_msgs/msg/JointState); its topics: /joint_reaction_force, "
            "/left/joint_states; --remap joint_states:=TOPIC or --namespace NAME reads another one; -p knee.source:=",
        ),
        (
            [(ANGLE, STATE), ("/ground_reaction_force", WRENCH)],
            "no topic /joint_reaction_force (geometry_msgs/msg/WrenchStamped); its topics: /ground_reaction_force, "
            "/joint_states; --remap joint_reaction_force:=TOPIC or --namespace NAME reads another one; "
            "knee-contact estimate-load computes it from ground_reaction_force",
        ),
        ([(f"/imu{number}", WRENCH) for number in range(10, 40)], "/imu29 and 10 more"),
        ([], "its topics: none"),
        (
            [(ANGLE, STATE), (ANGLE, WRENCH), (FORCE, WRENCH)],
            f"/joint_states has 2 types, {WRENCH} and {STATE}; it must be a {STATE}",
        ),
        (
            [(ANGLE, WRENCH), (FORCE, WRENCH)],
            f"topic /joint_states is a {WRENCH}; it must be a {STATE}",
        ),
    ],
)
def test_a_missing_topic_is_refused_with_those_there_are(channels, words, tmp_path):
    with pytest.raises(UsageError) as caught:
        raw_messages(empty(tmp_path / "bag.mcap", channels))
    assert words in str(caught.value)


def test_a_topic_that_is_no_cdr_is_refused(tmp_path):
    with pytest.raises(UsageError, match="topic /joint_states is encoded as json; it must be cdr"):
        raw_messages(empty(tmp_path / "json.mcap", list(INPUT_TYPES.items()), encoding="json"))


def test_a_compressed_file_that_somebody_unpacked_is_read(gait, tmp_path):
    folder = write_rosbag2(tmp_path / "bag", gait, MCAP, CompressionMode.FILE)
    (packed,) = folder.glob("*.zstd")
    with packed.open("rb") as source, packed.with_suffix("").open("wb") as target:
        zstandard.ZstdDecompressor().copy_stream(source, target)
    packed.unlink()
    assert raw_messages(folder) == gait


@pytest.mark.parametrize("storage", [SQLITE, MCAP])
def test_a_file_of_compressed_messages_asks_for_its_folder(storage, gait, tmp_path):
    folder = write_rosbag2(tmp_path / "bag", gait, storage, CompressionMode.MESSAGE)
    (file,) = (path for path in folder.iterdir() if path.name != "metadata.yaml")
    with pytest.raises(UsageError, match=r"has compressed messages: give its folder"):
        raw_messages(file)
