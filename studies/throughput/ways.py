"""The ways that are measured: `solve`, and the two libraries for bags with its messages but without computations.

Each gives the number of messages that it has read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from itertools import islice
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer

from benchmarks.latency.driver import samples
from knee_contact_ros.bags.columns import Batch
from knee_contact_ros.bags.reader import INPUT_TYPES
from knee_contact_ros.bags.recorder import CHUNK_SIZE, BagWriter
from knee_contact_ros.model.types import blank
from knee_contact_ros.offline.solve import Run, solve
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.streams.messages import encode_answer, encode_answer_wrench
from knee_contact_ros.streams.topics import (
    JOINT_REACTION_FORCE,
    JOINT_STATES,
    KNEE_CONTACT,
    KNEE_CONTACT_WRENCH,
    MESSAGE_TYPES,
    NANOSECONDS,
    RECORDED,
    definition,
    typestore,
)
from knee_contact_ros.system.files import share_folder

RATE = 1000
"""Rate of angle and force [Hz]"""
PARAMETERS = share_folder() / "config" / "healthy.yaml"
FORCES = f"/{JOINT_REACTION_FORCE}"
"""Topic of the forces, each of which is answered by a tick"""
Way = Callable[[Path, Path], int]
Message = tuple[str, int, bytes]
"""Topic, log time [ns] and bytes"""


def make_bag(path: Path, ticks: int) -> None:
    """Write a bag of the right leg's gait, over and over, with a number of ticks."""
    with BagWriter(path) as bag:
        for topic, name in INPUT_TYPES.items():
            bag.add_topic(topic, name)
        for sample in islice(samples(RATE, NANOSECONDS), ticks):
            bag.write(f"/{JOINT_STATES}", sample.stamp, sample.angle)
            bag.write(FORCES, sample.stamp, sample.force)


def solve_blocks(bag: Path, output: Path) -> int:
    """Run `solve` as it is."""
    told = [0]

    def advance(done: int, _total: int) -> None:
        told[0] = done

    solve(bag, load_parameters(PARAMETERS), output / "out.mcap", advance)
    return told[0]


def solve_one_by_one(bag: Path, output: Path) -> int:
    """Run `solve` without taking any block at once."""

    def refuse(_run: Run, _block: Batch) -> bool:
        return False

    Run._take_at_once = refuse  # type: ignore[assignment,method-assign]
    return solve_blocks(bag, output)


def read_by_mcap(bag: Path, _output: Path) -> int:
    """Read a bag by mcap, without decoding."""
    return sum(1 for _ in messages_by_mcap(bag))


def copy_by_mcap(bag: Path, output: Path) -> int:
    """Read and write by mcap what `solve` does, in chunks of the same size; the answers' bytes are prepared."""
    output.mkdir()
    with (output / "out.mcap").open("wb") as file:
        writer = McapWriter(file, chunk_size=CHUNK_SIZE, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(profile="ros2")
        channels = {}
        for topic in RECORDED:
            name = MESSAGE_TYPES[topic]
            kind = writer.register_schema(name, "ros2msg", definition(name))
            channels[f"/{topic}"] = writer.register_channel(f"/{topic}", "cdr", kind)
        read = 0
        for message in messages_by_mcap(bag):
            read += 1
            for topic, time, data in with_answers(message):
                writer.add_message(channels[topic], time, data, time)
        writer.finish()  # type: ignore[no-untyped-call]
    return read


def read_by_rosbags(bag: Path, _output: Path) -> int:
    """Read a bag by rosbags, and decode it."""
    with AnyReader([bag], default_typestore=typestore()) as reader:
        read = 0
        for connection, _, data in reader.messages():
            reader.deserialize(data, connection.msgtype)
            read += 1
        return read


def copy_by_rosbags(bag: Path, output: Path) -> int:
    """Read and write by rosbags what `solve` does; inputs are decoded, and the answers' bytes are prepared."""
    writer = Rosbag2Writer(output, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with AnyReader([bag], default_typestore=typestore()) as reader, writer:
        connections = {
            f"/{topic}": writer.add_connection(f"/{topic}", MESSAGE_TYPES[topic], typestore=typestore())
            for topic in RECORDED
        }
        read = 0
        for connection, log_time, content in reader.messages():
            reader.deserialize(content, connection.msgtype)
            read += 1
            for topic, time, data in with_answers((connection.topic, log_time, bytes(content))):
                writer.write(connections[topic], time, data)
        return read


def messages_by_mcap(bag: Path) -> Iterable[Message]:
    """Messages of a bag in the order of time, read by mcap."""
    with bag.open("rb") as file:
        for _, channel, message in make_reader(file).iter_messages():
            yield channel.topic, message.log_time, message.data


def with_answers(message: Message) -> list[Message]:
    """A message, followed by the answers that are written behind it."""
    topic, time, _ = message
    if topic != FORCES:
        return [message]
    return [message, *((answer, time, data) for answer, data in ANSWERS)]


def prepared() -> list[tuple[str, bytes]]:
    """An answer and its wrench, serialised, with their topics."""
    row, frame = blank(1).tobytes(), "tibia_r"
    wrench = encode_answer_wrench(0, frame, row)
    return [(f"/{KNEE_CONTACT}", encode_answer(0, frame, row)), (f"/{KNEE_CONTACT_WRENCH}", wrench)]


ANSWERS = prepared()
SOLVE, ONE_BY_ONE = "solve", "solve, one by one"
WAYS: dict[str, Way] = {
    SOLVE: solve_blocks,
    "mcap: reading": read_by_mcap,
    "mcap: reading and writing": copy_by_mcap,
    "rosbags: reading, decoding": read_by_rosbags,
    "rosbags: reading, decoding and writing": copy_by_rosbags,
    ONE_BY_ONE: solve_one_by_one,
}
