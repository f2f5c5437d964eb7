"""A recording written anew with some of its messages changed or left out."""

from collections.abc import Callable, Collection
from pathlib import Path

from mcap.records import Attachment, Channel, DataEnd, Message, Metadata, Schema
from mcap.stream_reader import StreamReader
from mcap.writer import Writer


def rewrite(
    source: Path,
    target: Path,
    change: Callable[[str, int, bytes], bytes | None] = lambda _topic, _number, data: data,
    chunk_size: int = 2**20,
    without: Collection[str] = (),
    about: Callable[[dict[str, str]], dict[str, str]] = dict,
) -> Path:
    """Copy a recording; `change` takes topic, sequence number and payload and gives the payload, or None for none.

    `about` takes the entries of its metadata and gives those of the copy.

    Attachments named in `without` are left out. Returns the copy.
    """
    schemas: dict[int, int] = {}
    channels: dict[int, tuple[int, str]] = {}
    with source.open("rb") as file, target.open("wb") as out:
        writer = Writer(out, chunk_size=chunk_size)
        writer.start()
        for record in StreamReader(file).records:
            if isinstance(record, Metadata):
                writer.add_metadata(record.name, about(record.metadata))
            elif isinstance(record, Attachment):
                if record.name in without:
                    continue
                writer.add_attachment(0, 0, record.name, record.media_type, record.data)
            elif isinstance(record, Schema):
                schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            elif isinstance(record, Channel):
                written = writer.register_channel(
                    record.topic, record.message_encoding, schemas[record.schema_id]
                )
                channels[record.id] = (written, record.topic)
            elif isinstance(record, Message):
                channel, topic = channels[record.channel_id]
                data = change(topic, record.sequence, record.data)
                if data is not None:
                    writer.add_message(channel, record.log_time, data, record.publish_time, record.sequence)
            elif isinstance(record, DataEnd):
                break
        writer.finish()
    return target
