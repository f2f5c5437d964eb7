"""The recorder's session: writes received messages of HLI and SIM to a file, and keeps live pictures beside it.

It is a separate process that only listens. It cannot disturb the cell: senders drop the messages that it
is too slow to take.
"""

from __future__ import annotations

import contextlib
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from deltaq_cell.description import CellDescription
from deltaq_cell.identity import content_identity
from deltaq_protocol import topics
from deltaq_protocol.blocking import connect
from deltaq_protocol.codec import InvalidMessageError, pack, unpack
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.guarded import GateEntry, GateMemory
from deltaq_protocol.identity import CellIdentity, mismatch
from deltaq_protocol.sayings import SIM
from deltaq_protocol.topic import Kind, Party, Realm, Topic
from deltaq_services.guarded_realm import open_watching_session
from deltaq_services.process import HeldInterrupts
from deltaq_services.recorder.protobuf import PICTURE, PICTURES_PER_S, PictureReference
from deltaq_services.recorder.writer import RecordingWriter
from deltaq_services.video_stream import (
    VideoStream,
    newest_picture,
    pictures_of,
    video_socket,
    video_streams,
)

_MOST_WAITING = 20_000
"""Messages that may wait to be written: some ten seconds of a cell."""

MOST_PICTURES = 36_000
"""Of one live stream, two hours; older ones are deleted."""
_PICTURE_WITHIN_S = 2.0

_BY_NAME = {topic.name: topic for topic in topics.TOPICS}


class OtherCellRunsError(DeltaqError):
    """Another cell than the expected one answers at the address."""


class Recorder:
    """Records a running cell; a context manager that completes the file.

    Args:
        cell: description with the addresses of HLI and SIM.
        path: file to write; it must not exist.

    Attributes:
        writer: of the file.
        lost: messages that came faster than they could be written.
        invalid: messages that could not be understood.

    Raises:
        ServiceUnreachableError: HLI or SIM is not there.
        RecordingError: the file exists or cannot be written.
    """

    def __init__(self, cell: CellDescription, path: Path) -> None:
        with connect(cell.hli, "recorder") as running:
            description = running.description
        if description.cell != cell.cell:
            raise OtherCellRunsError(f"{cell.hli} serves cell {description.cell}, not {cell.cell}")
        running_identity = CellIdentity.parse(description.identity)
        if not content_identity(cell).is_same(running_identity):
            raise OtherCellRunsError(
                mismatch(f"the HLI at {cell.hli}", running_identity, content_identity(cell))
            )
        self.lost = 0
        self.invalid = 0
        self._came: queue.SimpleQueue[tuple[Topic, bytes, int]] = queue.SimpleQueue()
        self._session: Any = open_watching_session(cell, SIM, [cell.hli])
        try:
            self.writer = RecordingWriter(path, description, "live")
        except DeltaqError:
            self._session.close()
            raise
        for topic in topics.TOPICS:
            open_stream = topic.realm is Realm.OPEN and topic.kind is Kind.STREAM
            if open_stream and Party.CLIENT in topic.readers and topic.recorded:
                self._session.declare_subscriber(topic.key(cell.cell), lambda s, t=topic: self._put(t, s))
        audit = topics.AUDIT
        self._session.declare_subscriber(audit.key(cell.cell), lambda sample: self._put(audit, sample))
        # one subscriber for both, so that a snapshot keeps its place among the entries
        self._session.declare_subscriber(topics.GATE_KEYS.format(cell=cell.cell), self._put_gate)
        self._keepers = contextlib.ExitStack()
        for stream in video_streams(cell):
            self._keepers.enter_context(
                PictureKeeper(stream, video_socket(cell, stream.name), path, self._put_picture)
            )

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, *_: object) -> None:
        self._keepers.close()
        self._session.close()
        self.writer.close()

    def run(self, duration_s: float | None = None, on_progress: Callable[[], None] | None = None) -> None:
        """Write messages, for ever or for `duration_s`; at the end also those that still wait.

        Raises:
            RecordingError: the file can no longer be written.
        """
        end_s = None if duration_s is None else time.monotonic() + duration_s
        # an input of the gate is written with all of its outputs, or a replay would find some missing
        with HeldInterrupts() as held:
            try:
                while end_s is None or time.monotonic() < end_s:
                    held.let_go()
                    self._write_next(within_s=0.1)
                    if on_progress is not None:
                        on_progress()
            except KeyboardInterrupt:
                self._write_what_waits()
                raise
            self._write_what_waits()

    def _write_what_waits(self) -> None:
        """Write the messages that wait now, and no later ones: the cell sends on and on."""
        for _ in range(self._came.qsize()):
            self._write_next(within_s=0.0)

    def _write_next(self, within_s: float) -> None:
        try:
            topic, payload, time_ns = self._came.get(timeout=within_s)
        except queue.Empty:
            return
        try:
            self._write(topic, payload, time_ns)
        except InvalidMessageError:
            self.invalid += 1

    def _put(self, topic: Topic, sample: Any) -> None:
        if self._came.qsize() < _MOST_WAITING:
            self._came.put((topic, sample.payload.to_bytes(), time.time_ns()))
        else:
            self.lost += 1

    def _put_picture(self, kept: PictureReference) -> None:
        self._came.put((PICTURE, pack(kept), time.time_ns()))

    def _put_gate(self, sample: Any) -> None:
        is_memory = str(sample.key_expr).endswith("/memory")
        self._put(topics.GATE_MEMORY if is_memory else topics.GATE_LOG, sample)

    def _write(self, topic: Topic, payload: bytes, time_ns: int) -> None:
        message = unpack(topic.message, payload)
        if isinstance(message, GateMemory):
            self.writer.gate_remembers(message, time_ns)
        elif isinstance(message, GateEntry):
            taken = _BY_NAME[message.topic]
            outputs = [
                (_BY_NAME[name], unpack(_BY_NAME[name].message, data)) for name, data in message.outputs
            ]
            self.writer.gate_took(
                taken, unpack(taken.message, message.payload), outputs, message.number, time_ns
            )
        else:
            self.writer.publish(topic, message, time_ns)


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
        while not self._ended.wait(1.0 / PICTURES_PER_S):
            with contextlib.suppress(OSError, ValueError):  # without a picture the recording goes on
                message = newest_picture(self._socket, _PICTURE_WITHIN_S)
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
