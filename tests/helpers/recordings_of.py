"""Recordings with metadata records of anybody's, by the writer of the MCAP project."""

from mcap.reader import make_reader
from mcap.writer import Writer


def recording_with(
    path,
    source,
    metadata=(),
    name=str,
    frame=bytes,
):
    """The messages of a bag's only file, under other names and with other bytes, and metadata records behind them."""
    (file,) = [source] if source.is_file() else source.glob("*.mcap")
    with file.open("rb") as stream, path.open("wb") as output:
        writer, schemas, channels = Writer(output), {}, {}
        writer.start(profile="ros2", library="somebody's")
        for schema, channel, message in make_reader(stream).iter_messages():
            if schema.id not in schemas:
                schemas[schema.id] = writer.register_schema(
                    schema.name, schema.encoding, schema.data
                )
            if channel.id not in channels:
                channels[channel.id] = writer.register_channel(
                    name(channel.topic),
                    channel.message_encoding,
                    schemas[schema.id],
                    channel.metadata,
                )
            writer.add_message(
                channels[channel.id], message.log_time, frame(message.data), message.publish_time
            )
        for record, values in metadata:
            writer.add_metadata(record, values)
        writer.finish()
    return path
