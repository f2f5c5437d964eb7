"""The process of one live picture: a thread that reads the source, and a Unix socket that serves the newest picture."""

import asyncio
import contextlib
import logging
import signal
import threading
import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any
from urllib.parse import quote

import av
from av.error import FFmpegError, InvalidDataError

from deltaq_protocol.errors import DeltaqError, ServiceUnreachableError
from deltaq_services.video.core import (
    MOST_PER_S,
    CaptureClock,
    MovingPattern,
    PictureLimit,
    Unchanged,
    retry_s,
    shown_size,
)
from deltaq_services.video_stream import ASK, VideoMessage

_log = logging.getLogger(__name__)

_OPENS_WITHIN_S, _READS_WITHIN_S = 5.0, 3.0
_WAIT_S = 1.0
"""After which a reader that asks is told why no picture comes."""
_LATE_S, _TOO_LATE_S = 0.15, 1.0
"""A decoder that is so late leaves out what no other picture needs, and all until the next whole picture. Where each
picture is whole, it leaves out all as soon as it is late."""
_NO_PICTURE_S = 10.0
_LASTS_S = 10.0
"""A source that lasted so long is tried again soon."""
_QUALITY = 5
"""Of JPEG: 2 is the best, 31 the worst."""
_ASPECT_SHARE = 0.02
_TICK = Fraction(1, 1000)


class SourceError(DeltaqError):
    """A source gives no pictures."""


class Encoder:
    """Makes JPEGs of pictures."""

    def __init__(self) -> None:
        self._codec: Any = None
        self._count = 0

    def jpeg(self, frame: av.VideoFrame) -> bytes:
        """The picture as JPEG, made smaller if it is too large."""
        width, height = shown_size(frame.width, frame.height)
        shown = frame.reformat(width, height, "yuvj420p", dst_color_range="JPEG")
        if self._codec is None or (self._codec.width, self._codec.height) != (width, height):
            self._codec = av.CodecContext.create("mjpeg", "w")
            self._codec.width, self._codec.height, self._codec.pix_fmt = width, height, "yuvj420p"
            self._codec.time_base, self._codec.thread_count = _TICK, 1
            self._codec.qmin = self._codec.qmax = _QUALITY
        self._count += 1
        # the encoder takes none that does not come after the last
        shown.pts, shown.time_base = self._count, _TICK
        return b"".join(bytes(packet) for packet in self._codec.encode(shown))


class Capture:
    """Reads a source for ever, in a thread of its own.

    Args:
        source: as the cell's file has it.
        folder: of the cell's file, in which relative files are.
        aspect: width of a picture by its height, as the cell's file has it.
        login: `USER:PASSWORD` of an RTSP server; empty for none.

    Attributes:
        wanted: whether anybody waits for a picture; without it none is encoded.
        fault: why no pictures come; empty if they do.
    """

    def __init__(self, source: str, folder: Path, aspect: float, login: str) -> None:
        self.wanted = threading.Event()
        self.fault = "its source is being opened"
        self._source, self._folder, self._aspect, self._login = source, folder, aspect, login
        self._encoder, self._unchanged = Encoder(), Unchanged()
        self._number = 0
        self._newest_s = 0.0

    def run(self, on_message: Callable[[VideoMessage], None]) -> None:
        """Read the source, and again after each fault.

        Args:
            on_message: called with each picture that is wanted, and with each fault of the source.
        """
        attempt = 0
        while True:
            begun_s = time.monotonic()
            try:
                self._read(on_message)
                fault = ""
            except (SourceError, FFmpegError) as error:
                # without the address, which has the login
                fault = getattr(error, "strerror", None) or str(error)
            except Exception as error:
                # of a hostile source, or of the library: the next attempt may succeed
                fault = repr(error)
            if not fault:
                time.sleep(1.0 / MOST_PER_S)
                continue
            attempt = 0 if time.monotonic() - begun_s > _LASTS_S else attempt
            if fault != self.fault:
                self.fault = fault
                _log.warning("no picture from %s: %s; it is tried again until one comes", self._source, fault)
                on_message(VideoMessage(words=fault))
            time.sleep(retry_s(attempt))
            attempt += 1

    def _read(self, on_message: Callable[[VideoMessage], None]) -> None:
        """Read the source until it ends; a file plays over and over.

        Raises:
            SourceError: it gives no pictures.
            FFmpegError: it cannot be opened, or read further.
        """
        limit, first = PictureLimit(), True
        for frame, captured_s in self._generated() if self._source == "test" else self._decoded(limit):
            if first:
                self._begins(frame)
            first = False
            self._newest_s = time.monotonic()
            if self.wanted.is_set():
                jpeg = self._encoder.jpeg(frame)
                self._number += 1
                same_s = self._unchanged.for_s(jpeg, captured_s)
                on_message(VideoMessage(self._number, captured_s, same_s, jpeg))
        if first or self._is_live:
            raise SourceError("it has no picture" if first else "it has ended")

    @property
    def _is_live(self) -> bool:
        return self._source.startswith(("rtsp", "v4l2:"))

    def _begins(self, frame: av.VideoFrame) -> None:
        """Say that pictures come, unless they did."""
        aspect = frame.width / frame.height
        is_other = abs(aspect / self._aspect - 1.0) > _ASPECT_SHARE
        other = f"; the cell's file gives the camera aspect {self._aspect:g}, and this is {aspect:.3g}"
        if self.fault:
            size = f"{frame.width}x{frame.height}"
            _log.info("pictures come from %s, %s%s", self._source, size, other if is_other else "")
        self.fault = ""

    def _generated(self) -> Iterator[tuple[av.VideoFrame, float]]:
        pattern, due_s = MovingPattern(self._aspect), time.monotonic()
        epoch_s = time.time() - due_s
        while True:
            due_s = max(due_s + 1.0 / MOST_PER_S, time.monotonic())
            time.sleep(max(0.0, due_s - time.monotonic()))
            captured_s = time.monotonic()
            picture = pattern.picture(epoch_s + captured_s)
            yield av.VideoFrame.from_ndarray(picture, format="yuv420p"), captured_s

    def _decoded(self, limit: PictureLimit) -> Iterator[tuple[av.VideoFrame, float]]:
        """The pictures that are shown, and when they were taken [s]."""
        clock, self._newest_s = CaptureClock(), time.monotonic()
        with self._opened() as container:
            if not container.streams.video:
                raise SourceError("it has no video")
            stream = container.streams.video[0]
            decoder = stream.codec_context
            skips = False
            for packet in container.demux(stream):
                now_s, stamp = time.monotonic(), packet.pts if packet.dts is None else packet.dts
                if now_s - self._newest_s > _NO_PICTURE_S:
                    raise SourceError(f"nothing in it could be shown for {_NO_PICTURE_S:g} s")
                late_s = 0.0
                if stamp is not None and packet.time_base is not None:
                    late_s = now_s - clock.due_s(float(stamp * packet.time_base), now_s)
                bound_s = _LATE_S if decoder.codec.intra_only else _TOO_LATE_S
                skips = (skips and not packet.is_keyframe) or late_s > bound_s
                if skips:
                    continue
                decoder.skip_frame = "NONREF" if late_s > _LATE_S else "DEFAULT"
                if decoder.codec.intra_only and not limit.takes(now_s - late_s):
                    continue  # cheaper than to decode it first
                with contextlib.suppress(InvalidDataError):  # a damaged packet; the next may be whole
                    for frame in packet.decode():
                        captured_s = self._captured_s(clock, frame)
                        if decoder.codec.intra_only or limit.takes(captured_s):
                            yield frame, captured_s

    def _captured_s(self, clock: CaptureClock, frame: av.VideoFrame) -> float:
        """When a picture was taken [s]; one of a file is waited for."""
        if frame.time is None:
            return time.monotonic()
        if not self._is_live:
            wait_s = clock.due_s(frame.time, time.monotonic()) - time.monotonic()
            time.sleep(min(max(wait_s, 0.0), _WAIT_S))
        return clock.taken_s(frame.time, time.monotonic())

    def _opened(self) -> Any:
        source, limits = self._source, (_OPENS_WITHIN_S, _READS_WITHIN_S)
        if source.startswith("v4l2:"):
            rate = {"framerate": f"{MOST_PER_S:g}"}
            return av.open(source.removeprefix("v4l2:"), format="v4l2", options=rate, timeout=limits)
        if source.startswith("rtsp"):
            scheme, _, place = source.partition("://")
            user = ":".join(quote(part, "") for part in self._login.split(":", 1))
            login = f"{user}@" if user else ""
            options = {"rtsp_transport": "tcp", "fflags": "nobuffer"}
            return av.open(f"{scheme}://{login}{place}", options=options, timeout=limits)
        return av.open(
            f"file:{self._folder / source}", options={"protocol_whitelist": "file"}, timeout=limits
        )


class VideoServer:
    """Serves the newest picture on a Unix socket, to any number of readers.

    Args:
        path: of the socket.
        capture: reads the source.
    """

    def __init__(self, path: Path, capture: Capture) -> None:
        self._path, self._capture = path, capture
        self._loop = asyncio.get_running_loop()
        self._coming: asyncio.Future[bytes] = self._loop.create_future()

    async def run(self, name: str) -> None:
        """Serve until a signal comes.

        Raises:
            ServiceUnreachableError: another process serves this picture.
        """
        with contextlib.suppress(OSError):
            _, writer = await asyncio.open_unix_connection(self._path)
            writer.close()
            raise ServiceUnreachableError(f"another process serves the picture of {name}; end that one first")
        server = await asyncio.start_unix_server(self._serve, self._path)
        threading.Thread(target=self._capture.run, args=(self._take,), name="capture", daemon=True).start()
        _log.info("ready: live picture of %s", name)
        ended = asyncio.Event()
        for number in (signal.SIGTERM, signal.SIGINT):
            self._loop.add_signal_handler(number, ended.set)
        try:
            await ended.wait()
        finally:
            server.close()
            self._path.unlink(missing_ok=True)

    def _take(self, message: VideoMessage) -> None:
        """In the capture's thread: give a message to all who wait."""
        self._loop.call_soon_threadsafe(self._publish, message.packed())

    def _publish(self, packed: bytes) -> None:
        self._capture.wanted.clear()
        self._coming.set_result(packed)
        self._coming = self._loop.create_future()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        # asyncio logs a reader's task that is cancelled as the service ends as a fault
        with contextlib.suppress(OSError, asyncio.IncompleteReadError, asyncio.CancelledError):
            while True:
                await reader.readexactly(len(ASK))
                writer.write(await self._next())
                await writer.drain()
        writer.close()

    async def _next(self) -> bytes:
        """The next picture, or after a while why there is none."""
        self._capture.wanted.set()
        try:
            return await asyncio.wait_for(asyncio.shield(self._coming), _WAIT_S)
        except TimeoutError:
            return VideoMessage(words=self._capture.fault or "its source sends no pictures").packed()
