"""Sources of live pictures: files of every kind, and an RTSP server that can drop its reader."""

from __future__ import annotations

import base64
import contextlib
import socket
import threading
import time
from fractions import Fraction
from pathlib import Path
from typing import BinaryIO

import av
import numpy as np

SDP = """v=0\r
o=- 0 0 IN IP4 127.0.0.1\r
s=plant\r
c=IN IP4 0.0.0.0\r
t=0 0\r
m=video 0 RTP/AVP 96\r
a=rtpmap:96 H264/90000\r
a=fmtp:96 packetization-mode=1\r
a=control:eye\r
"""
_PER_S = 30


def frames(width, height, count, moves=True):
    """Pictures whose upper half changes its brightness, or all equal."""
    picture = np.full((height * 3 // 2, width), 128, np.uint8)
    for number in range(count):
        if moves:
            picture[: height // 2] = number * 5 % 256
        frame = av.VideoFrame.from_ndarray(picture, format="yuv420p")
        frame.pts, frame.time_base = number, Fraction(1, _PER_S)
        yield frame


def write_video(file: Path, codec: str, width=640, height=480, count=60, per_s=_PER_S, moves=True) -> None:
    with av.open(str(file), "w") as container:
        stream = container.add_stream(codec, rate=per_s, options={"preset": "ultrafast"})
        stream.width, stream.height = width, height
        stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
        for frame in frames(width, height, count, moves):
            frame.time_base = Fraction(1, per_s)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


class RtspServer:
    """Serves H.264 in the RTSP connection itself, to one reader at a time; a context manager.

    Attributes:
        url: where.
        login: `USER:PASSWORD` that a reader has to give; empty for none.
    """

    def __init__(self, login: str = "") -> None:
        self.login = login
        self._listening = socket.create_server(("127.0.0.1", 0))
        self.url = f"rtsp://127.0.0.1:{self._listening.getsockname()[1]}/eye"
        self._reader: socket.socket | None = None
        self._thread = threading.Thread(target=self._serve, daemon=True)

    def __enter__(self) -> RtspServer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._listening:
            self._listening.shutdown(socket.SHUT_RDWR)
            self.drop()
            self._thread.join()

    def drop(self) -> None:
        """Cut the reader off in the middle of the stream."""
        if self._reader is not None:
            with contextlib.suppress(OSError):  # it has gone already
                self._reader.shutdown(socket.SHUT_RDWR)

    def _serve(self) -> None:
        with contextlib.suppress(OSError):  # it listens no more
            while True:
                self._reader, _ = self._listening.accept()
                with self._reader, self._reader.makefile("rb") as lines, contextlib.suppress(OSError):
                    self._answer(self._reader, lines)

    def _answer(self, reader: socket.socket, lines: BinaryIO) -> None:
        while True:
            head = list(iter(lambda: lines.readline().decode().strip(), ""))
            if not head:
                return
            number = next(line for line in head if line.lower().startswith("cseq"))
            more, body = "", ""
            proof = f"Authorization: Basic {base64.b64encode(self.login.encode()).decode()}"
            if self.login and proof not in head:
                needs = 'WWW-Authenticate: Basic realm="plant"'
                reader.sendall(f"RTSP/1.0 401 Unauthorized\r\n{number}\r\n{needs}\r\n\r\n".encode())
                continue
            match head[0].split()[0]:
                case "DESCRIBE":
                    more, body = f"Content-Type: application/sdp\r\nContent-Length: {len(SDP)}\r\n", SDP
                case "SETUP":
                    more = "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\nSession: 1\r\n"
                case "PLAY":
                    more = "Session: 1\r\n"
            reader.sendall(f"RTSP/1.0 200 OK\r\n{number}\r\n{more}\r\n{body}".encode())
            if head[0].startswith("PLAY"):
                self._play(reader)
                return

    def _play(self, reader: socket.socket) -> None:
        packets = _Interleaved(reader)
        with av.open(packets, "w", format="rtp", options={"packetsize": "1400"}) as container:
            stream = container.add_stream(
                "libx264", rate=_PER_S, options={"preset": "ultrafast", "tune": "zerolatency", "g": "15"}
            )
            stream.width, stream.height, stream.pix_fmt = 640, 480, "yuv420p"
            for frame in frames(640, 480, 10_000):
                container.mux(stream.encode(frame))
                if packets.is_cut:
                    return
                time.sleep(1 / _PER_S)


class _Interleaved:
    """A file of RTP packets that puts each into the connection, framed as RTSP has it."""

    def __init__(self, reader: socket.socket) -> None:
        self._reader = reader
        self.is_cut = False

    def write(self, packet: bytes) -> int:
        channel = 1 if 200 <= packet[1] <= 204 else 0
        try:
            self._reader.sendall(b"$" + bytes([channel]) + len(packet).to_bytes(2, "big") + bytes(packet))
        except OSError:
            self.is_cut = True
        return len(packet)
