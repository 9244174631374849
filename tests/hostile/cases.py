"""Files and folders of somebody who means no good, by name; each function makes one in a folder and gives its path."""

import json
import os
import shutil
import struct
from collections.abc import Callable
from pathlib import Path

from mcap.opcode import Opcode
from mcap.records import Metadata

from knee_contact_ros.bags.provenance import provenance_record
from knee_contact_ros.parameters.files import load_parameters
from knee_contact_ros.system.files import share_folder
from tests.helpers.recordings_of import recording_with
from tests.hostile.bags import (
    MAGIC,
    channel,
    chunk,
    lz4_of_zeros,
    message,
    record,
    schema,
    whole,
    written,
    zstd_of_zeros,
)

GAIT = share_folder() / "bags" / "gait2354_right"
JOINTS, FORCE = "/joint_states", "/joint_reaction_force"
EVIL = "\x1b]0;mine\x07\x1b[2J"
BOMB = "- &a {b: 1}\n" + "".join(
    f"- &{chr(98 + i)} [*{chr(97 + i)}, *{chr(97 + i)}]\n" for i in range(24)
)
"""Quality of service that is twice as much with every line"""
Make = Callable[[Path], Path]


def saved(content):
    """A file with this content."""

    def make(folder):
        path = folder / "theirs.mcap"
        path.write_bytes(content)
        return path

    return make


def recorded(values, *more):
    """Gait, recorded with these parameters (or other entries of the record), and further metadata records."""

    def make(folder):
        changed = {"parameters": values} if isinstance(values, str) else values
        ours = provenance_record(load_parameters({}), {}) | changed
        return recording_with(folder / "theirs.mcap", GAIT, [("knee_contact", ours), *more])

    return make


def named(rename):
    """Gait with other names of topics."""
    return lambda folder: recording_with(folder / "theirs.mcap", GAIT, name=rename)


def inputs(*, qos="", definition=b"", data=(b"",)):
    """Both input topics with some messages."""
    return whole(
        schema(1, "sensor_msgs/msg/JointState", definition),
        schema(2, "geometry_msgs/msg/WrenchStamped", definition),
        channel(1, JOINTS, qos),
        channel(2, FORCE, qos, 2),
        *(message(number, content, 1) for content in data for number in (1, 2)),
    )


def folder_with(metadata):
    """Gait in a folder whose `metadata.yaml` is what `metadata` makes of the good one."""

    def make(folder):
        shutil.copytree(GAIT, folder / "theirs")
        metadata(folder / "theirs" / "metadata.yaml")
        return folder / "theirs"

    return make


def piped(path):
    path.unlink()
    os.mkfifo(path)


def linked(path):
    path.unlink()
    path.symlink_to("/dev/zero")


def says(path, mode):
    """Say in `metadata.yaml` that its file or its messages are compressed."""
    text = path.read_text().replace("compression_format: ''", "compression_format: zstd")
    path.write_text(text.replace("compression_mode: ''", f"compression_mode: {mode}"))


def compressed(path):
    """A compressed file, which holds a thousand times as much."""
    (file,) = path.parent.glob("*.mcap")
    file.unlink()
    file.with_name(f"{file.name}.zstd").write_bytes(zstd_of_zeros(4096))
    path.write_text(path.read_text().replace(file.name, f"{file.name}.zstd"))
    says(path, "FILE")


def squeezed(path):
    """Compressed messages, of which each holds a gigabyte."""
    (file,) = path.parent.glob("*.mcap")
    file.write_bytes(inputs(data=[zstd_of_zeros(1024)]))
    says(path, "MESSAGE")


def replaced(old, new):
    """Gait in a folder in whose `metadata.yaml` a text is another."""
    return folder_with(lambda path: path.write_text(path.read_text().replace(old, new)))


PROFILE = json.dumps({"femur.geometry": "profile", "femur.profile": "/dev/zero"})
NESTED = b"".join(
    struct.pack("<BQ", Opcode.METADATA, 9 * left - 9) for left in range(60_000, 0, -1)
)
BAGS: dict[str, Make] = {
    "a profile that is named": recorded(PROFILE),
    "parameters that are a name": recorded('"/dev/zero"'),
    "parameters within parameters": recorded("[" * 100_000),
    "a change that is damaged": recorded(
        {}, ("parameters_changed", {"tick": "5", "contact.damping": "{"})
    ),
    "a change long ago": recorded({}, ("reset", {"tick": "9" * 4300})),
    "a curve of many points": recorded(
        {"parameters": PROFILE, "file of femur.profile": "0,0\n" * 100_000}
    ),
    "escape codes in topics": named(lambda topic: f"{topic}{EVIL}"),
    "escape codes in a record": recorded({"package": f"knee_contact_ros {EVIL}"}),
    "a chunk of ten gigabytes": saved(whole(chunk(zstd_of_zeros(10_240), 10_240 * 2**20))),
    "a chunk that hides ten gigabytes": saved(whole(chunk(zstd_of_zeros(10_240), 1000))),
    "chunks of much": saved(whole(*[chunk(zstd_of_zeros(64), 64 * 2**20)] * 300)),
    "chunks of much for lz4": saved(whole(*[chunk(lz4_of_zeros(16), 2**24, "lz4")] * 6)),
    "a chunk of a million records": saved(
        whole(chunk(record(0x80, b"") * 1_500_000, 13_500_000, ""))
    ),
    "records within each other": saved(MAGIC + b"\xff" + NESTED),
    "channels without end": saved(
        whole(
            schema(1, "a/msg/B", b"a" * 10**6),
            *(channel(number, f"/t{number}") for number in range(6000)),
        )
    ),
    "messages and notes by turns": saved(
        whole(
            *(channel(n, f"/t{n}", "", 0) for n in range(5000)),
            *(message(n, b"", n) + record(0x80, b"") for n in range(5000)),
        )
    ),
    "quality of service without end": saved(inputs(qos=BOMB)),
    "messages that are none": saved(inputs(data=[os.urandom(3), b"\0\1\0\0" + b"\xff" * 40])),
    "definitions without end": saved(inputs(definition=b"a/B c\n" * 40_000)),
    "metadata records without end": saved(whole(*[written(Metadata("reset", {}))] * 20_000)),
    "metadata that is a pipe": folder_with(piped),
    "metadata that is a device": folder_with(linked),
    "metadata in brackets": folder_with(lambda path: path.write_text("[" * 100_000)),
    "metadata in another encoding": folder_with(lambda path: path.write_bytes(b"\xff\xfe\xe9")),
    "metadata that names half a character": replaced(
        "file_paths:\n", 'file_paths:\n  - "\\ud800"\n'
    ),
    "metadata that names what is too long": replaced(
        "file_paths:\n", f"file_paths:\n  - {'x' * 300}\n"
    ),
    "metadata with a date that is none": folder_with(
        lambda path: path.write_text("a: 2001-99-99")
    ),
    "metadata that names files elsewhere": replaced("gait2354_right", "../../../../dev/zero"),
    "a file compressed a thousand times": folder_with(compressed),
    "messages compressed a thousand times": folder_with(squeezed),
}
"""What `solve`, `report` and `view` read, and `recover` if it is an MCAP file"""
