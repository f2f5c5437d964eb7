"""Reads a recording in the order of writing, up to its end or damage.

A recorder that is killed leaves a file without its end, and a disk may damage any part of it. As much as possible is
read: a damaged chunk is left out, and the file ends where the next record is invalid; both are reported.
"""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field, replace
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import Any

import lz4.frame
import zstandard
from google.protobuf.message import DecodeError
from mcap.exceptions import EndOfFile, McapError
from mcap.reader import SeekingReader
from mcap.records import Attachment, Channel, Chunk, Footer, McapRecord, Metadata, Schema
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap_protobuf.decoder import DecoderFactory
from pydantic import TypeAdapter, ValidationError

from deltaq_cell.cell_model import CellModel, robots_told
from deltaq_cell.hull import Corners
from deltaq_cell.load import parse_cell
from deltaq_protocol.codec import InvalidMessageError
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.messages import Message
from deltaq_protocol.topic import Topic
from deltaq_protocol.topics import TOPICS
from deltaq_services.recorder.protobuf import to_message
from deltaq_services.recorder.writer import CELL_FILE, HULLS_FILE, METADATA

_HULLS: TypeAdapter[dict[str, dict[str, Corners]]] = TypeAdapter(dict[str, dict[str, Corners]])
_LONGEST_RECORD = 64 * 1024 * 1024
_LONGEST_CHUNK = 16 * 1024 * 1024
"""Greatest size of an unpacked chunk [bytes]: some sixty times that of the recorder."""
_UNPACK: dict[str, Callable[..., Any]] = {"zstd": zstandard.open, "lz4": lz4.frame.open}
_UNREADABLE = (
    McapError,
    zstandard.ZstdError,
    RuntimeError,
    EOFError,
    OSError,
    struct.error,
    ValueError,
    OverflowError,
    MemoryError,
)
"""Errors that the MCAP reader, the decompressors and a damaged disk raise."""
_ABOUT = ("cell", "robots")
"""Entries of the metadata without which nothing can be read."""


class UnreadableRecordingError(DeltaqError):
    """The file is not a recording of deltaq."""


@dataclass(frozen=True)
class Recorded:
    """One message of a recording.

    Attributes:
        topic: its row of the table.
        message: the message.
        time_ns: when it was seen [ns].
        number: of the gate's message that it belongs to, modulo 2**32; 0 for messages that do not pass the gate.
        position: offset in the file [bytes].
    """

    topic: Topic
    message: Message
    time_ns: int
    number: int
    position: int


@dataclass
class Recording:
    """The subject of a recording, and its messages.

    Attributes:
        path: the file.
        about: cell, cycle_s, protocol, robots and source.
        yaml: the cell's description.
        urdf: URDF text by robot.
        hulls: the hulls of its meshes, by robot and body; empty in recordings of versions that kept none.
        notices: the parts that could not be read; complete once `messages` has been read to the end.
    """

    path: Path
    about: dict[str, str] = field(default_factory=dict)
    yaml: str = ""
    urdf: dict[str, str] = field(default_factory=dict)
    hulls: dict[str, dict[str, Corners]] = field(default_factory=dict)
    notices: list[str] = field(default_factory=list)

    @classmethod
    def open(cls, path: Path) -> Recording:
        """Read the beginning of a recording.

        Raises:
            UnreadableRecordingError: the file is not there, or it is no recording of deltaq.
        """
        recording = cls(path)
        for record, _ in recording._records():
            if isinstance(record, Metadata) and record.name == METADATA:
                recording.about = _about(record, path)
            elif isinstance(record, Attachment) and record.name == CELL_FILE:
                recording.yaml = _text(record, path)
            elif isinstance(record, Attachment) and record.name == HULLS_FILE:
                recording.hulls = _hulls(_text(record, path), path)
            elif isinstance(record, Attachment) and record.name.endswith(".urdf"):
                recording.urdf[record.name.removesuffix(".urdf")] = _text(record, path)
            if recording.yaml and recording.about and set(recording.robots) <= set(recording.urdf):
                return recording
        why = f": {recording.notices[0]}" if recording.notices else ""
        raise UnreadableRecordingError(
            f"{path} is no recording of deltaq{why}; `deltaq recording record` and `deltaq experiment --record` "
            "write them"
        )

    @property
    def robots(self) -> tuple[str, ...]:
        """Names of the robots."""
        return tuple(self.about["robots"].split())

    @property
    def size(self) -> int:
        """Length of the file [bytes]."""
        return self.path.stat().st_size

    def cell(self) -> CellModel:
        """The model of the recorded cell.

        Raises:
            CellError: this version cannot read its description.
            RobotModelError: a robot's meshes are not found.
            UnreadableRecordingError: it has no URDF of one of the cell's robots.
        """
        description = parse_cell(self.yaml, str(self.path))
        if missing := [name for name in description.robots if name not in self.urdf]:
            raise UnreadableRecordingError(
                f"{self.path} is damaged: it has no URDF of {', '.join(missing)}, which its {CELL_FILE} names"
            )
        robots = robots_told(description, self.urdf, self.hulls)
        return CellModel.of(description, robots, self.yaml)

    def messages(self, topics: Collection[Topic] = TOPICS) -> Iterator[Recorded]:
        """The messages of some topics, in the order of writing."""
        self.notices.clear()
        names = (*self.robots, "")
        by_key = {t.key(self.about["cell"], robot=name): t for t in topics if t.recorded for name in names}
        decoders = DecoderFactory()
        schemas: dict[int, Schema] = {}
        channels: dict[int, tuple[Topic, Callable[[bytes], Any]]] = {}
        left_out = 0
        for record, position in chain(self._repeated(), self._records()):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                topic, schema = by_key.get(record.topic), schemas.get(record.schema_id)
                if topic is None:
                    continue
                try:
                    decode = decoders.decoder_for(record.message_encoding, schema)
                except (
                    DecodeError,
                    *_UNREADABLE,
                    TypeError,
                ) as error:  # protobuf's errors on a damaged schema
                    self.notices.append(f"the schema of {record.topic} is damaged: {error}")
                    continue
                if decode is not None:
                    channels[record.id] = (topic, decode)
            elif isinstance(record, McapMessage) and record.channel_id in channels:
                topic, decode = channels[record.channel_id]
                try:
                    message = to_message(topic.message, decode(record.data))
                except (InvalidMessageError, DecodeError):
                    left_out += 1
                    continue
                yield Recorded(topic, message, record.log_time, record.sequence, position)
        if left_out:
            self.notices.append(f"messages left out because they are not of this version: {left_out}")

    def _repeated(self) -> Iterator[tuple[McapRecord, int]]:
        """Schemas and channels as a complete file repeats them at its end: the chunk that has them may be damaged."""
        with contextlib.suppress(*_UNREADABLE), self.path.open("rb") as file:
            summary = SeekingReader(file, True, record_size_limit=_LONGEST_RECORD).get_summary()
            if summary is not None:
                yield from ((record, 0) for record in (*summary.schemas.values(), *summary.channels.values()))

    def _records(self) -> Iterator[tuple[McapRecord, int]]:
        """Every record outside and inside chunks, and how far into the file it is."""
        try:
            file = self.path.open("rb")
        except OSError as error:
            raise UnreadableRecordingError(f"{self.path} cannot be read: {error.strerror}") from error
        with file:
            reader = StreamReader(file, emit_chunks=True, record_size_limit=_LONGEST_RECORD)
            ended = False
            try:
                for record in reader.records:
                    ended = ended or isinstance(record, Footer)
                    if isinstance(record, Chunk):
                        yield from ((inner, file.tell()) for inner in self._unpacked(record, file.tell()))
                    else:
                        yield record, file.tell()
            except _UNREADABLE as error:
                if not ended:
                    self.notices.append(self._ending(error, file.tell()))

    def _unpacked(self, chunk: Chunk, position: int) -> list[McapRecord]:
        try:
            return breakup_chunk(_plain(chunk), validate_crc=True)
        except _UNREADABLE as error:
            self.notices.append(
                f"the chunk that ends at byte {position} is damaged and was left out: {error}"
            )
            return []

    def _ending(self, error: Exception, position: int) -> str:
        size = self.size
        if isinstance(error, EndOfFile) or position >= size:
            return f"the file is cut off at byte {size}: it was read as far as it goes"
        return f"the file is damaged before byte {position} of {size}, and was read up to there: {error}"


def _plain(chunk: Chunk) -> Chunk:
    """The chunk without compression; never more bytes are unpacked than it claims, nor more than a chunk may have."""
    size = chunk.uncompressed_size
    if size > _LONGEST_CHUNK:
        raise ValueError(f"it claims {size} bytes unpacked, and at most {_LONGEST_CHUNK} are read")
    if chunk.compression not in _UNPACK:
        return chunk
    with _UNPACK[chunk.compression](BytesIO(chunk.data)) as stream:
        data = stream.read(size + 1)
    if len(data) != size:
        raise ValueError(
            f"it claims {size} bytes unpacked, and has {'more' if len(data) > size else len(data)}"
        )
    return replace(chunk, compression="", data=data)


def _about(record: Metadata, path: Path) -> dict[str, str]:
    for name in _ABOUT:
        if not record.metadata.get(name):
            raise UnreadableRecordingError(f"{path} is damaged: its metadata {METADATA!r} has no {name!r}")
    return dict(record.metadata)


def _hulls(text: str, path: Path) -> dict[str, dict[str, Corners]]:
    try:
        return _HULLS.validate_json(text)
    except ValidationError as error:
        raise UnreadableRecordingError(
            f"{path}: its {HULLS_FILE} is damaged: {error.errors()[0]['msg']}"
        ) from error


def _text(attachment: Attachment, path: Path) -> str:
    try:
        return attachment.data.decode()
    except UnicodeDecodeError as error:
        raise UnreadableRecordingError(f"{path}: its {attachment.name} is damaged: {error}") from error
