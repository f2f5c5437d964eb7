"""`python -m deltaq_services.video --cell lab --stream fr`."""

import argparse
import asyncio
import os

from deltaq_cell.find import find_cell
from deltaq_cell.load import load_cell
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.given_token import given_token
from deltaq_services.process import run
from deltaq_services.video_stream import video_socket, video_streams

LOGIN = "DELTAQ_VIDEO_LOGIN"
"""Environment variable: `USER:PASSWORD` of the cell's RTSP cameras."""
_NICENESS = 5
"""Of its process: a picture waits for whatever moves a robot."""


class NoStreamError(DeltaqError):
    """The cell has no such live picture, or its library is not installed."""


def main() -> None:
    """Serve a live picture until a signal ends the process."""
    parser = argparse.ArgumentParser(description="Live picture of a camera, for the console")
    parser.add_argument("--cell", default="lab", help="name or YAML file of the cell (default: lab)")
    parser.add_argument(
        "--stream", required=True, help="robot with the camera; .right behind it for a right eye"
    )
    given = parser.parse_args()
    cell = load_cell(given.cell)
    streams = {stream.name: stream for stream in video_streams(cell)}
    if given.stream not in streams:
        has = ", ".join(streams) or "none: name one with robots.NAME.camera.source"
        raise NoStreamError(f"no live picture {given.stream!r} in cell {cell.cell}; it has {has}")
    try:
        from deltaq_services.video.shell import Capture, VideoServer
    except ModuleNotFoundError as error:
        raise NoStreamError(f"{error.name} is not installed: pip install 'deltaq[video]'") from error
    os.nice(_NICENESS)
    stream = streams[given.stream]
    camera = cell.robots[stream.robot].camera
    assert camera is not None  # it names the source
    path, folder = video_socket(cell, stream.name), find_cell(given.cell).parent
    login = given_token(LOGIN) or ""

    async def serve() -> None:
        capture = Capture(stream.source, folder, camera.aspect, login)
        await VideoServer(path, capture).run(stream.name)

    asyncio.run(serve())


if __name__ == "__main__":
    run(main, "video")
