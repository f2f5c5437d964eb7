"""Keeps live pictures beside a recording, some a second; the recording has a reference to each."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from pathlib import Path

from deltaq_protocol.messages import Message, Name, Real
from deltaq_protocol.topic import Hertz, Kind, Priority, Realm, Topic
from deltaq_services.video_stream import VideoStream, newest_picture, pictures_of

PERIOD_S = 0.2
MOST_PICTURES = 36_000
"""Of one stream, two hours; older ones are deleted."""
_WITHIN_S = 2.0


class PictureReference(Message):
    """A live picture that was taken at `captured_s` (since 1970), and its file in the folder beside the recording."""

    robot: Name
    stream: str
    file: str
    captured_s: Real


PICTURE = Topic(
    "picture", Realm.OPEN, Kind.STREAM, "deltaq/{cell}/{robot}/picture", PictureReference,
    publishers=(), readers=(), rate=Hertz(1.0 / PERIOD_S), priority=Priority.ORDINARY,
)  # fmt: skip
"""No service publishes it: the recorder asks the service of the picture."""


class PictureKeeper:
    """Keeps the pictures of one stream, in a thread of its own; a context manager.

    Args:
        stream: whose pictures.
        socket: of its service, which may come and go.
        recording: file beside which the pictures are kept.
        kept: called in the thread with each reference.
    """

    def __init__(
        self, stream: VideoStream, socket: Path, recording: Path, kept: Callable[[PictureReference], None]
    ) -> None:
        self._stream, self._socket, self._kept = stream, socket, kept
        self._folder = pictures_of(recording)
        self._epoch_s = time.time() - time.monotonic()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"pictures of {stream.name}", daemon=True)

    def __enter__(self) -> PictureKeeper:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _run(self) -> None:
        count = 0
        while not self._ended.wait(PERIOD_S):
            with contextlib.suppress(OSError, ValueError):  # without a picture the recording goes on
                message = newest_picture(self._socket, _WITHIN_S)
                if not message.jpeg:
                    continue
                self._folder.mkdir(exist_ok=True)
                count += 1
                file = self._file(count)
                file.write_bytes(message.jpeg)
                self._file(count - MOST_PICTURES).unlink(missing_ok=True)
                captured_s = self._epoch_s + message.captured_s
                stream = self._stream
                self._kept(
                    PictureReference(
                        robot=stream.robot, stream=stream.name, file=file.name, captured_s=captured_s
                    )
                )

    def _file(self, number: int) -> Path:
        return self._folder / f"{self._stream.name}-{number:07d}.jpg"
