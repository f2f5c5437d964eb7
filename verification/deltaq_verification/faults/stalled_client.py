"""Clients that ask for everything and read nothing: `python -m deltaq_verification.faults.stalled_client CELL`.

Several hang on the TCP port with full buffers, and a zenoh session stays alive while its reading stands still.
"""

from __future__ import annotations

import json
import socket
import sys
import threading
from typing import Never

import zenoh

from deltaq_cell.load import load_cell
from deltaq_protocol import topics
from deltaq_protocol.messages import PROTOCOL_VERSION
from deltaq_protocol.session import open_session

_TCP_CLIENTS = 8


def main() -> None:
    """Hang there until killed."""
    cell = load_cell(sys.argv[1])
    hello = {"type": "hello", "protocol": PROTOCOL_VERSION, "client": "who reads nothing"}
    hanging = []
    for _ in range(_TCP_CLIENTS):
        client = socket.socket()
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1)  # before it connects: full at once
        client.connect((cell.tcp_address, cell.tcp_port))
        client.sendall(json.dumps(hello).encode() + b"\n")
        hanging.append(client)
    session = open_session(connect=[cell.hli], must_connect=True)
    stands_still = threading.Event()

    def never_return(_: zenoh.Sample) -> Never:
        stands_still.set()
        while True:
            threading.Event().wait()

    callback = zenoh.handlers.Callback(never_return, indirect=False)  # in the thread that reads the socket
    session.declare_subscriber(topics.STATE.key(cell.cell), callback)
    stands_still.wait()
    print("ready: reads nothing", flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    main()
