"""Live pictures: their times, sources of every kind and fault, and who gets them. Real files, streams and processes."""

import asyncio
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import contextmanager
from types import MappingProxyType
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import av
import numpy as np
import pytest
import websockets
from served_console import served
from video_sources import RtspServer, write_video

from deltaq_cell.cell_model import CellModel
from deltaq_cell.load import load_cell
from deltaq_deploy.launch.probes import probe
from deltaq_deploy.launch.services import video_services
from deltaq_protocol import topics
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.messages import Phase, RobotState
from deltaq_services.recorder.protobuf import PICTURE
from deltaq_services.recorder.replayed import replayed
from deltaq_services.recorder.shell import PictureKeeper
from deltaq_services.recorder.writer import RecordingWriter
from deltaq_services.video.core import CaptureClock, MovingPattern, PictureLimit, shown_size, stamp_of
from deltaq_services.video.shell import Encoder
from deltaq_services.video_stream import ASK, LENGTH, MOST_BYTES, VideoMessage, video_socket, video_streams
from deltaq_testing.private_cell import write_private_cell

TOKEN = "0123456789abcdef-desk"
PATIENCE_S = 30.0


def luma(jpeg):
    decoder = av.CodecContext.create("mjpeg", "r")
    (frame,) = decoder.decode(av.Packet(jpeg))
    return frame.to_ndarray(format="gray")


@pytest.mark.parametrize("time_s", [1795958956.165, 0.0, 2.0**31 + 0.999])
def test_the_time_in_a_picture_of_the_test_pattern_survives_jpeg(time_s):
    pattern = MovingPattern(aspect=4 / 3)
    picture = luma(Encoder().jpeg(av.VideoFrame.from_ndarray(pattern.picture(time_s), format="yuv420p")))
    assert picture.shape == (480, 640)
    assert stamp_of(picture) == int(time_s * 1000)
    assert stamp_of(np.zeros_like(picture)) is None
    assert stamp_of(np.full_like(picture, 255)) is None


def test_a_picture_that_waited_in_a_buffer_is_told_as_older():
    clock = CaptureClock()
    for number in range(100):
        late_s = 0.8 if number == 60 else 0.01 * (number % 3)
        read_s = 1000.0 + number / 30 + late_s
        taken_s = clock.taken_s(number / 30, read_s)
        assert read_s - taken_s == pytest.approx(late_s, abs=1e-3)
    begun_anew_s = clock.taken_s(0.0, 1200.0)
    assert begun_anew_s == pytest.approx(1200.0)


@pytest.mark.parametrize(("per_s", "shown_per_s"), [(60, 30), (50, 30), (30, 30), (25, 25), (5, 5)])
def test_a_source_is_shown_at_no_more_than_thirty_pictures_a_second(per_s, shown_per_s):
    limit, jitter = PictureLimit(), np.random.default_rng(1).uniform(-0.002, 0.002, 10 * per_s)
    shown = sum(limit.takes(number / per_s + off_s) for number, off_s in enumerate(jitter))
    assert shown == pytest.approx(10 * shown_per_s, rel=0.03)


@pytest.mark.parametrize(
    ("size", "shown"),
    [((3840, 2160), (1280, 720)), ((640, 480), (640, 480)), ((321, 7), (320, 6)), ((1080, 1920), (404, 720))],
)
def test_a_large_picture_is_made_smaller_in_its_own_shape(size, shown):
    assert shown_size(*size) == shown


def cell_with(folder, source):
    """A cell whose camera has this source."""
    folder.joinpath("base.yaml").write_text(
        f"extends: lab\nrobots: {{fr: {{camera: {{aspect: 1.3333, source: '{source}'}}}}}}\n",
        encoding="utf-8",
    )
    return write_private_cell(folder, folder / "base.yaml")


@contextmanager
def process(file, log, environment=MappingProxyType({})):
    """The service of the picture of fr, ready; its log goes to a file."""
    words = [sys.executable, "-m", "deltaq_services.video", "--cell", str(file), "--stream", "fr"]
    with log.open("a", encoding="utf-8") as output:
        running = subprocess.Popen(words, stderr=output, stdout=output, env={**os.environ, **environment})
    try:
        wait_for(lambda: "ready:" in log.read_text(encoding="utf-8"))
        yield running
    finally:
        running.terminate()
        assert running.wait(PATIENCE_S) in (0, -signal.SIGKILL)


def wait_for(reached):
    until_s = time.monotonic() + PATIENCE_S
    while not reached():
        assert time.monotonic() < until_s
        time.sleep(0.02)


class Reader:
    """Asks a service for pictures."""

    def __init__(self, file):
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(PATIENCE_S)
        self._socket.connect(str(video_socket(load_cell(file), "fr")))
        self._lines = self._socket.makefile("rb")

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._lines.close()
        self._socket.close()

    def ask(self):
        self._socket.sendall(ASK)
        (length,) = LENGTH.unpack(self._lines.read(LENGTH.size))
        return VideoMessage.unpacked(self._lines.read(length))

    def until(self, wanted):
        """The first message that is wanted."""
        until_s = time.monotonic() + PATIENCE_S
        while not wanted(message := self.ask()):
            assert time.monotonic() < until_s, message.words
        return message


def picture(message):
    return bool(message.jpeg)


@pytest.fixture
def log(tmp_path):
    return tmp_path / "log"


def faults(log):
    return [line for line in log.read_text(encoding="utf-8").splitlines() if "no picture from" in line]


@pytest.mark.service
@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("text.mp4", "Invalid data"),
        ("cut.mp4", "Invalid data"),
        ("gone.mp4", "No such file"),
        ("rtsp://127.0.0.1:9/eye", "Connection refused"),
        ("v4l2:/dev/none-such", "No such file"),
    ],
)
def test_a_source_without_pictures_is_told_once_and_tried_again_until_it_comes(tmp_path, log, source, words):
    write_video(tmp_path / "whole.mp4", "libx264")
    (tmp_path / "text.mp4").write_text("no video\n" * 100)
    (tmp_path / "cut.mp4").write_bytes((tmp_path / "whole.mp4").read_bytes()[:2000])
    file = cell_with(tmp_path, source)
    with process(file, log), Reader(file) as reader:
        until_s = time.monotonic() + 2.5  # several attempts
        while time.monotonic() < until_s:
            assert words in reader.ask().words
        assert len(faults(log)) == 1
        assert source in faults(log)[0]
        (service,) = video_services(load_cell(file), str(file))
        assert not probe(service, load_cell(file)).healthy
        if source.endswith(".mp4"):
            (tmp_path / "whole.mp4").replace(tmp_path / source)
            reader.until(picture)
    with pytest.raises(ServiceUnreachableError):
        probe(service, load_cell(file))


@pytest.mark.service
def test_a_stream_that_is_dropped_comes_back_and_two_readers_see_the_same_pictures(tmp_path, log):
    with RtspServer(login="eye:p@ss/word") as server:
        file = cell_with(tmp_path, server.url)
        login = {"DELTAQ_VIDEO_LOGIN": server.login}
        with process(file, log, login), Reader(file) as one, Reader(file) as other:
            first = one.until(picture)
            assert luma(first.jpeg).shape == (480, 640)
            server.drop()
            assert one.until(lambda message: message.words).words
            again = one.until(picture)
            assert again.number > first.number
            seen = {message.number: message.jpeg for message in (one.ask() for _ in range(20))}
            assert other.until(picture).number > first.number
            wait_for(lambda: (message := other.ask()).number in seen or message.number > max(seen))
            assert time.monotonic() - again.captured_s < PATIENCE_S
        assert len(faults(log)) == 1
        assert "p@ss" not in log.read_text(encoding="utf-8")


@pytest.mark.long
@pytest.mark.service
@pytest.mark.parametrize("codec", ["libx264", "mjpeg"])
def test_4k_at_60_is_made_smaller_and_slower_and_stays_fresh(tmp_path, log, codec):
    write_video(tmp_path / "large.mkv", codec, 3840, 2160, count=60, per_s=60)
    file = cell_with(tmp_path, "large.mkv")
    with process(file, log), Reader(file) as reader:
        reader.until(picture)
        begun_s, ages_s = time.monotonic(), []
        while time.monotonic() < begun_s + 3.0:
            message = reader.until(picture)
            ages_s.append(time.monotonic() - message.captured_s)
        assert luma(message.jpeg).shape == (720, 1280)
        assert len(ages_s) <= 100
        assert np.median(ages_s) < 1.0  # a busy machine leaves out more
    assert not faults(log)


@pytest.mark.service
def test_equal_pictures_are_told_as_unchanged(tmp_path, log):
    write_video(tmp_path / "still.mkv", "mpeg4", moves=False)
    file = cell_with(tmp_path, "still.mkv")
    with process(file, log), Reader(file) as reader:
        assert reader.until(picture).unchanged_s < 1.0
        assert reader.until(lambda message: message.unchanged_s > 1.5).jpeg


@pytest.mark.service
async def test_a_recording_refers_to_the_pictures_that_were_shown(tmp_path, log):
    file, run = cell_with(tmp_path, "test"), tmp_path / "run.mcap"
    cell = CellModel.load(file)
    (stream,) = video_streams(cell.description)
    kept = []
    with process(file, log), PictureKeeper(stream, video_socket(cell.description, "fr"), run, kept.append):
        wait_for(lambda: len(kept) >= 3)
    with RecordingWriter(run, cell.description_message(), "live") as writer:
        home = cell.robots["fr"].home.tolist()
        pose = cell.robots["fr"].tool_pose(cell.robots["fr"].home)
        state = RobotState(
            robot="fr", cycle=1, ipoc=1, time_s=0.0, q=home, q_cmd=home, tool=pose, phase=Phase.READY
        )
        begin_ns = round(1e9 * kept[0].captured_s) - 10**9
        writer.publish(topics.STATE, state, begin_ns)
        for reference in kept:
            writer.publish(PICTURE, reference, round(1e9 * reference.captured_s) + 10**7)
    pictures = replayed(run, str(cell.identity))["pictures"]["fr"]
    assert [name for _, name in pictures] == [reference.file for reference in kept]
    assert pictures[0][0] == pytest.approx(1.0, abs=1e-3)
    token = {"Authorization": f"Bearer {TOKEN}"}
    async with served(tmp_path, TOKEN, cell, recordings=tmp_path) as (_, host):

        async def fetched(name, **headers):
            request = Request(f"http://{host}/recordings/run.mcap/{name}", headers=headers)
            with await asyncio.to_thread(urlopen, request, timeout=PATIENCE_S) as answer:
                return answer.read()

        for time_s, name in pictures:
            stamp_ms = stamp_of(luma(await fetched(name, **token)))
            assert stamp_ms == pytest.approx(begin_ns / 1e6 + 1e3 * time_s, abs=100)
        (tmp_path / "run.video" / "fr-9999999.jpg").symlink_to(file)
        for name, headers in ((pictures[0][1], {}), ("fr-9999999.jpg", token), ("..%2Fprivate.yaml", token)):
            with pytest.raises(HTTPError) as refused:
                await fetched(name, **headers)
            assert refused.value.code in (403, 404)
            refused.value.close()


@pytest.mark.service
async def test_only_operators_get_a_picture_and_its_service_may_die(tmp_path, log):
    file = cell_with(tmp_path, "test")
    with process(file, log) as service:
        async with served(tmp_path, TOKEN, CellModel.load(file)) as (console, host):
            url = f"ws://{host}/video/fr"
            strangers = [
                (url, None),
                (f"{url}?token=guessed", None),
                (f"{url}?token={TOKEN}", "https://evil.example"),
                (f"ws://{host}/video/gr?token={TOKEN}", None),
            ]
            for address, origin in strangers:
                with pytest.raises(websockets.InvalidStatus):
                    await websockets.connect(address, origin=origin)
            async with websockets.connect(f"{url}?token={TOKEN}", max_size=MOST_BYTES) as browser:
                await browser.send("next")
                message = VideoMessage.unpacked(await browser.recv())
                # each process has its own clock of the day, from its start
                assert stamp_of(luma(message.jpeg)) == pytest.approx(message.captured_s * 1000, abs=100)
                assert 0 < console.now_s() - message.captured_s < PATIENCE_S
                service.kill()
                with pytest.raises(websockets.ConnectionClosed):
                    await asyncio.wait_for(browser.recv(), PATIENCE_S)
            async with websockets.connect(f"{url}?token={TOKEN}") as browser:
                with pytest.raises(websockets.ConnectionClosed) as closed:
                    await browser.recv()
                assert closed.value.rcvd.reason == "the service of its picture does not run"
            with process(file, tmp_path / "again"):
                async with websockets.connect(f"{url}?token={TOKEN}", max_size=MOST_BYTES) as browser:
                    await browser.send("next")
                    assert VideoMessage.unpacked(await browser.recv()).jpeg
