"""The process that brakes a robot if its Robot Server dies, started with `python -m`.

Its arguments are two descriptors and the robot's name. It shares the Robot Server's socket and the memory with its
records, loads neither numpy nor zenoh, and sleeps until the mutex is passed on to it. It holds nothing else, ignores
signals that ask it to end, and ends by itself.
"""

import contextlib
import ctypes
import gc
import json
import mmap
import os
import select
import signal
import socket
import sys
import time

from deltaq_services.robot_server.crash_brake.core import CrashBrake, CrashPlan, PlainTelegrams
from deltaq_services.robot_server.crash_brake.memory import CrashMemory
from deltaq_services.robot_server.crash_brake.record import CrashRecords, PeerAddress

_MOST_WAITING = 1024
"""Datagrams drained before one is answered."""
_LOCK_ALL = 1 | 2
"""Flags of `mlockall`: present and future pages."""


def main() -> int:
    """Wait for the end of the Robot Server; brake unless it ended in order."""
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    # not where the Robot Server is kept: one that never waits would hold that processor
    os.sched_setaffinity(0, range(os.cpu_count() or 1))
    shared, listening = map(int, sys.argv[1:3])
    plan = CrashPlan.from_json(sys.stdin.read())
    records, telegrams = CrashRecords(len(plan.most), plan.outputs), plan.telegrams()
    with mmap.mmap(shared, 0) as file, socket.socket(fileno=listening) as sock:
        memory = CrashMemory(file, records)
        gc.disable()
        gc.freeze()
        ctypes.CDLL(None).mlockall(_LOCK_ALL)  # where the system allows it
        memory.armed = True
        memory.mutex.wait()
        replies = 0 if memory.released else _brake(plan, memory, sock, telegrams)
        memory.close()
    if replies:
        with contextlib.suppress(OSError):  # its reader may have ended, too
            print(_said(f"the Robot Server has died: its robot was braked, in {replies} replies"), flush=True)
    return 0


def _said(message: str) -> str:
    """A line as `deltaq_protocol.log` writes it, which would load numpy and zenoh here."""
    if os.environ.get("DELTAQ_LOG_FORMAT") != "json":
        return message
    time_utc = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    told = {"time": time_utc, "level": "error", "service": "crash-brake", "robot": sys.argv[3]}
    return json.dumps(told | {"message": message, "fields": {}})


def _brake(plan: CrashPlan, memory: CrashMemory, sock: socket.socket, telegrams: PlainTelegrams) -> int:
    """Answer the KRC until no answer is needed; returns the number of replies."""
    found = memory.newest()
    if found is None:
        return 0
    brake = CrashBrake(plan, found, telegrams)
    brake.time_passed(time.monotonic())
    while not brake.over:
        left_s = max(0.0, brake.silent_s - time.monotonic())
        if select.select([sock], [], [], left_s)[0]:
            reply = brake.answer(_waiting(sock, plan.most_bytes), time.monotonic())
            if reply is not None:
                with contextlib.suppress(OSError):  # to the KRC it is a lost reply
                    sock.sendto(reply, found.peer)
        else:
            brake.time_passed(time.monotonic())
    return brake.replies


def _waiting(sock: socket.socket, most_bytes: int) -> list[tuple[bytes, PeerAddress]]:
    waiting: list[tuple[bytes, PeerAddress]] = []
    for _ in range(_MOST_WAITING):
        try:
            waiting.append(sock.recvfrom(most_bytes + 1, socket.MSG_DONTWAIT))
        except BlockingIOError:
            break
        except OSError:  # an earlier reply was not received
            continue
    return waiting


if __name__ == "__main__":
    raise SystemExit(main())
