"""The live pictures of a cell: their names, where each is served, and the message that carries one.

The service of a camera listens on a Unix socket in the user's runtime folder, which no other user can enter. A reader
sends a byte, and gets one message: the next picture, or why there is none. So nothing ever waits in line. Little
endian:

    u32 bytes of what follows
    u8 version = 1   u8 kind (0: a JPEG follows, 1: words)   u16 reserved   u32 number, counted up with each picture
    f64 captured_s   when the picture was taken, on the monotonic clock [s]; the console puts its own clock's time here
    f32 unchanged_s  for how long all pictures have been equal to this one [s]
"""

from __future__ import annotations

import socket
import struct
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

from deltaq_cell.description import CellDescription
from deltaq_services.runtime_folder import runtime_folder

VERSION = 1
PICTURE, WORDS = 0, 1
ASK = b"n"
LENGTH = struct.Struct("<I")
_HEAD = struct.Struct("<BBHIdf")
_CAPTURED_AT = 8
MOST_BYTES = 4 * 1024 * 1024
"""Of a message; a reader takes a longer one for an error."""


@dataclass(frozen=True)
class VideoStream:
    """One eye of a camera.

    Attributes:
        robot: that carries the camera.
        name: of the stream: the robot's, with `.right` for the right eye.
        source: as the cell's file has it.
    """

    robot: str
    name: str
    source: str


def video_streams(cell: CellDescription) -> tuple[VideoStream, ...]:
    """The eyes of a cell's cameras that name a source."""
    return tuple(
        VideoStream(name, f"{name}{end}", source)
        for name, robot in cell.robots.items()
        if robot.camera is not None
        for end, source in robot.camera.eyes.items()
    )


def video_socket(cell: CellDescription, stream: str) -> Path:
    """Where a stream is served.

    Raises:
        RuntimeFolderError: the runtime folder is not this user's alone.
    """
    place = f"{cell.cell} {cell.console_address} {cell.console_port} {stream}"
    return runtime_folder() / f"video-{blake2b(place.encode(), digest_size=8).hexdigest()}"


def pictures_of(recording: Path) -> Path:
    """The folder beside a recording with the live pictures that it refers to."""
    return recording.with_suffix(".video")


@dataclass(frozen=True)
class VideoMessage:
    """A picture or, where `words` are not empty, why there is none; the fields are those of the wire."""

    number: int = 0
    captured_s: float = 0.0
    unchanged_s: float = 0.0
    jpeg: bytes = b""
    words: str = ""

    def packed(self) -> bytes:
        """The message, with its length ahead of it."""
        kind = WORDS if self.words else PICTURE
        head = _HEAD.pack(VERSION, kind, 0, self.number % 2**32, self.captured_s, self.unchanged_s)
        body = self.words.encode() or self.jpeg
        return LENGTH.pack(len(head) + len(body)) + head + body

    @classmethod
    def unpacked(cls, message: bytes) -> VideoMessage:
        """Read a message without its length.

        Raises:
            ValueError: it is none.
        """
        if len(message) < _HEAD.size or message[0] != VERSION:
            raise ValueError(f"no message of version {VERSION} of a live picture")
        _, kind, _, number, captured_s, unchanged_s = _HEAD.unpack_from(message)
        body = message[_HEAD.size :]
        if kind == WORDS:
            return cls(number, captured_s, unchanged_s, words=body.decode())
        return cls(number, captured_s, unchanged_s, jpeg=body)


def newest_picture(path: Path, within_s: float) -> VideoMessage:
    """Ask the service at a socket for its next picture.

    Raises:
        OSError: it does not run, or does not answer within that time.
        ValueError: what answers is no such service.
    """
    with socket.socket(socket.AF_UNIX) as asking:
        asking.settimeout(within_s)
        asking.connect(str(path))
        asking.sendall(ASK)
        with asking.makefile("rb") as answer:
            length = int.from_bytes(answer.read(LENGTH.size), "little")
            return VideoMessage.unpacked(answer.read(min(length, MOST_BYTES)))


def on_clock(message: bytes, epoch_s: float) -> bytes:
    """The message with its time on a clock that is `epoch_s` ahead of the monotonic one [s]."""
    told = bytearray(message)
    (captured_s,) = struct.unpack_from("<d", told, _CAPTURED_AT)
    struct.pack_into("<d", told, _CAPTURED_AT, captured_s + epoch_s)
    return bytes(told)
