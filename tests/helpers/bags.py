"""Bags as other recorders write them: by the writers of rosbags and of the MCAP project, not by our own."""

import shutil

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from ruamel.yaml import YAML

from knee_contact_ros.bags.bag import INPUT_TYPES, Bag
from knee_contact_ros.streams.topics import typestore


def raw_messages(path, types=INPUT_TYPES):
    """The messages of a bag on topics of these types, as their bytes."""
    with Bag(path) as bag:
        return list(bag.select(types).raw_messages())


OTHER = {"/other/force": "geometry_msgs/msg/WrenchStamped", "/imu": "sensor_msgs/msg/Imu"}
"""Topics that no bag of a robot lacks, and that we do not read"""


def write_rosbag2(
    folder,
    messages,
    storage=StoragePlugin.MCAP,
    compression=CompressionMode.NONE,
    version=9,
    name=str,
    types=INPUT_TYPES,
):
    """A rosbag2 folder with other topics among ours, which are of these types."""
    writer = Writer(folder, version=version, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        known = {
            topic: writer.add_connection(name(topic), kind, typestore=typestore())
            for topic, kind in types.items()
        }
        other = [
            writer.add_connection(topic, kind, typestore=typestore())
            for topic, kind in OTHER.items()
        ]
        for message in messages:
            writer.write(known[message.topic], message.log_time, message.data)
            for connection in other:
                writer.write(connection, message.log_time + 1, message.data)
    return folder


def write_split(folder, messages, storage, compression):
    """A rosbag2 folder of twelve files, in the order in which their names are sorted: the tenth before the second."""
    write_rosbag2(folder, messages, storage, compression)
    yaml, description = YAML(typ="safe"), folder / "metadata.yaml"
    whole = yaml.load(description.read_text())
    (file,) = whole["rosbag2_bagfile_information"]["relative_file_paths"]
    (folder / file).unlink()
    size = -(-len(messages) // 12)
    for number in range(12):
        part = write_rosbag2(
            folder / f"bag_{number}", messages[number * size :][:size], storage, compression
        )
        for path in part.glob("bag_*"):
            path.rename(folder / path.name)
        shutil.rmtree(part)
    whole["rosbag2_bagfile_information"]["relative_file_paths"] = sorted(
        path.name for path in folder.glob("bag_*")
    )
    with description.open("w") as stream:
        yaml.dump(whole, stream)
    return folder


class Mcap:
    """An MCAP file, channel by channel."""

    def __init__(
        self,
        path,
        compression=CompressionType.ZSTD,
        profile="ros2",
    ):
        self.path = path
        self._file = path.open("wb")
        self.writer = McapWriter(self._file, chunk_size=4096, compression=compression)
        self.writer.start(profile=profile)

    def channel(self, topic, type_name, schema_encoding="ros2msg", encoding="cdr"):
        """Declare a topic."""
        text = (
            typestore().generate_msgdef(type_name, ros_version=2)[0].encode()
            if "/" in type_name
            else b"{}"
        )
        schema = self.writer.register_schema(name=type_name, encoding=schema_encoding, data=text)
        return self.writer.register_channel(
            topic=topic, message_encoding=encoding, schema_id=schema
        )

    def channels(self):
        """Declare our inputs."""
        return {topic: self.channel(topic, kind) for topic, kind in INPUT_TYPES.items()}

    def write(self, channel, message):
        """Write a message."""
        self.writer.add_message(channel, message.log_time, message.data, message.log_time)

    def close(self):
        """Complete the file."""
        self.writer.finish()
        self._file.close()
        return self.path
