"""The bags that are damaged: one short recording, in every form that a recorder gives it."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from ruamel.yaml import YAML

from knee_contact_ros.bags.reader import INPUT_TYPES
from knee_contact_ros.bags.writer import BagWriter
from knee_contact_ros.streams.messages import JointState, WrenchStamped, encode_joint_state, encode_wrench_stamped
from knee_contact_ros.streams.topics import typestore

TICKS = 100
PERIOD = 5_000_000
"""Time between two ticks [ns]"""
CHUNK = 4096
"""Size of a chunk [B], small so that there are several"""
FILES = 3
"""Number of files of the split recording"""
Message = tuple[str, int, bytes]
"""Topic, time [ns] and bytes"""


def messages() -> Iterator[Message]:
    """Serialised angle and load of every tick."""
    for tick in range(TICKS):
        stamp = (tick + 1) * PERIOD
        state = JointState(stamp, "tibia_r", ("knee",), (0.1 + 0.01 * tick,), (), ())
        wrench = WrenchStamped(stamp, "tibia_r", (0.0, -600.0 - 10.0 * tick, 0.0), (0.0, 0.0, 0.0))
        yield "/joint_states", stamp, encode_joint_state(state)
        yield "/joint_reaction_force", stamp, encode_wrench_stamped(wrench)


def mcap(path: Path, compression: CompressionType, *, checksums: bool = True, chunks: bool = True) -> None:
    """Write an MCAP file with several chunks, or without chunks."""
    with path.open("wb") as file:
        writer = Writer(
            file,
            chunk_size=CHUNK,
            compression=compression,
            use_chunking=chunks,
            enable_crcs=checksums,
            enable_data_crcs=checksums,
        )
        writer.start(profile="ros2", library="fuzz_bags")
        channels = {}
        for topic, type_name in INPUT_TYPES.items():
            text = typestore().generate_msgdef(type_name, ros_version=2)[0].encode()
            schema = writer.register_schema(type_name, "ros2msg", text)
            channels[topic] = writer.register_channel(topic, "cdr", schema, {"offered_qos_profiles": ""})
        for number, (topic, stamp, data) in enumerate(messages()):
            writer.add_message(channels[topic], stamp, data, stamp, number)
        writer.add_metadata("note", {"a": "b"})
        writer.add_attachment(1, 1, "page.txt", "text/plain", b"some text")
        writer.finish()  # type: ignore[no-untyped-call]


def sqlite(path: Path) -> None:
    """Write a rosbag2 folder with a sqlite3 file."""
    with FolderWriter(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {
            topic: writer.add_connection(topic, type_name, typestore=typestore())
            for topic, type_name in INPUT_TYPES.items()
        }
        for topic, stamp, data in messages():
            writer.write(connections[topic], stamp, data)


def split(path: Path) -> None:
    """Write a rosbag2 folder with several MCAP files."""
    path.mkdir()
    names = [f"{path.name}_{number}.mcap" for number in range(FILES)]
    every, ends = list(messages()), [number * 2 * TICKS // FILES for number in range(FILES + 1)]
    for name, (begin, end) in zip(names, itertools.pairwise(ends), strict=True):
        with BagWriter(path / name) as bag:
            for topic, type_name in INPUT_TYPES.items():
                bag.add_topic(topic, type_name)
            for topic, stamp, data in every[begin:end]:
                bag.write(topic, stamp, data)
    yaml, metadata = YAML(), path / "metadata.yaml"
    content = yaml.load(metadata)
    information = content["rosbag2_bagfile_information"]
    information |= {"relative_file_paths": names, "files": [], "message_count": len(every)}
    information["duration"]["nanoseconds"] = (TICKS - 1) * PERIOD
    for topic in information["topics_with_message_count"]:
        topic["message_count"] = TICKS
    yaml.dump(content, metadata)


MAKERS: Mapping[str, Callable[[Path], None]] = {
    "MCAP, uncompressed": lambda path: mcap(path, CompressionType.NONE),
    "MCAP, zstd": lambda path: mcap(path, CompressionType.ZSTD),
    "MCAP, lz4": lambda path: mcap(path, CompressionType.LZ4),
    "MCAP, uncompressed, no checksums": lambda path: mcap(path, CompressionType.NONE, checksums=False),
    "MCAP, no chunks": lambda path: mcap(path, CompressionType.NONE, chunks=False),
    "folder, sqlite3": sqlite,
    "folder, MCAP in three files": split,
}
UNPROTECTED = ("MCAP, uncompressed, no checksums", "folder, sqlite3")
"""Kinds of bags whose messages no checksum covers"""
IN_A_FOLDER = ("folder, sqlite3", "folder, MCAP in three files")


def make(folder: Path) -> dict[str, Path]:
    """Write all bags into a folder; return their paths by kind."""
    paths = {}
    for number, (kind, maker) in enumerate(MAKERS.items()):
        path = folder / (f"bag{number}" if kind in IN_A_FOLDER else f"bag{number}.mcap")
        maker(path)
        paths[kind] = path
    return paths


def copy(path: Path, folder: Path) -> Path:
    """Copy a bag into a new folder, and return its path."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    if path.is_dir():
        return Path(shutil.copytree(path, folder / path.name))
    return Path(shutil.copy(path, folder / path.name))
