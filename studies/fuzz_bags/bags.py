"""Bags to be damaged, and the damages."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from random import Random

from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as FolderWriter
from ruamel.yaml import YAML

from knee_contact_ros.bags.bag import INPUT_TYPES
from knee_contact_ros.bags.recorder import BagWriter
from knee_contact_ros.streams.messages import (
    JointState,
    WrenchStamped,
    encode_joint_state,
    encode_wrench_stamped,
)
from knee_contact_ros.streams.topics import typestore

MOST_FLIPS = 8
LONGEST_RUN = 64
"""Length of the longest run of bytes [B]"""
LONGEST_RANGE = 0.3
"""Largest part of a file that a range covers"""


def bit_flips(data: bytearray, random: Random) -> None:
    """Flip a few bits anywhere."""
    for _ in range(random.randint(1, MOST_FLIPS)):
        data[random.randrange(len(data))] ^= 1 << random.randrange(8)


def truncation(data: bytearray, random: Random) -> None:
    """Cut off the end."""
    del data[random.randrange(len(data)) :]


def byte_run(data: bytearray, random: Random) -> None:
    """Overwrite some bytes with zeros, ones or noise."""
    begin, length = random.randrange(len(data)), random.randint(1, LONGEST_RUN)
    length = min(length, len(data) - begin)
    filler = random.choice((bytes(length), b"\xff" * length, random.randbytes(length)))
    data[begin : begin + length] = filler


def duplicated_range(data: bytearray, random: Random) -> None:
    """Duplicate some bytes."""
    begin, end = _range(data, random)
    data[end:end] = data[begin:end]


def deleted_range(data: bytearray, random: Random) -> None:
    """Delete some bytes."""
    begin, end = _range(data, random)
    del data[begin:end]


def zeroed_end(data: bytearray, random: Random) -> None:
    """Overwrite the end with zeros, as after a power cut."""
    begin = random.randrange(len(data))
    data[begin:] = bytes(len(data) - begin)


def _range(data: bytearray, random: Random) -> tuple[int, int]:
    begin = random.randrange(len(data))
    return begin, min(len(data), begin + random.randint(1, max(1, int(LONGEST_RANGE * len(data)))))


ON_BYTES: Mapping[str, Callable[[bytearray, Random], None]] = {
    "bit flips": bit_flips,
    "truncation": truncation,
    "byte run": byte_run,
    "duplicated range": duplicated_range,
    "deleted range": deleted_range,
    "zeroed end": zeroed_end,
}


def deleted_line(text: list[str], random: Random) -> None:
    """Delete a line of `metadata.yaml`."""
    del text[random.randrange(len(text))]


def changed_number(text: list[str], random: Random) -> None:
    """Change a digit in `metadata.yaml`."""
    digits = [
        (row, column)
        for row, line in enumerate(text)
        for column, sign in enumerate(line)
        if sign.isdigit()
    ]
    row, column = random.choice(digits)
    text[row] = text[row][:column] + str(random.randrange(10)) + text[row][column + 1 :]


def changed_word(text: list[str], random: Random) -> None:
    """Change a letter in `metadata.yaml`."""
    row = random.choice([row for row, line in enumerate(text) if line.strip()])
    column = random.randrange(len(text[row]))
    text[row] = text[row][:column] + random.choice("aeiou:- ") + text[row][column + 1 :]


def swapped_lines(text: list[str], random: Random) -> None:
    """Swap two lines of `metadata.yaml`."""
    one, other = random.randrange(len(text)), random.randrange(len(text))
    text[one], text[other] = text[other], text[one]


ON_METADATA: Mapping[str, Callable[[list[str], Random], None]] = {
    "metadata.yaml: deleted line": deleted_line,
    "metadata.yaml: changed number": changed_number,
    "metadata.yaml: changed letter": changed_word,
    "metadata.yaml: swapped lines": swapped_lines,
}


def mutate(bag: Path, random: Random) -> str:
    """Damage a bag, and return the name of the damage."""
    if not bag.is_dir():
        return _on_bytes(bag, random)
    files = sorted(path for path in bag.iterdir() if path.suffix != ".yaml")
    fate = random.random()
    if fate < 0.6:
        return _on_bytes(random.choice(files), random)
    metadata = bag / "metadata.yaml"
    if fate < 0.7:
        _on_bytes(metadata, random)
        return "metadata.yaml: bytes"
    if fate < 0.95:
        name = random.choice(list(ON_METADATA))
        text = metadata.read_text(encoding="utf-8").splitlines()
        ON_METADATA[name](text, random)
        metadata.write_text("\n".join(text) + "\n", encoding="utf-8")
        return name
    random.choice([*files, metadata]).unlink()
    return "missing file"


def _on_bytes(path: Path, random: Random) -> str:
    name = random.choice(list(ON_BYTES))
    data = bytearray(path.read_bytes())
    ON_BYTES[name](data, random)
    path.write_bytes(data)
    return name


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


def mcap(
    path: Path, compression: CompressionType, *, checksums: bool = True, chunks: bool = True
) -> None:
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
            channels[topic] = writer.register_channel(
                topic, "cdr", schema, {"offered_qos_profiles": ""}
            )
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
                bag.write_message(topic, stamp, data)
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
    "MCAP, uncompressed, no checksums": lambda path: mcap(
        path, CompressionType.NONE, checksums=False
    ),
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
