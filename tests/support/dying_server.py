"""A process that holds a socket, leaves the record of a reply in motion, and dies as it is told to.

It stands for a Robot Server: its argument is a body of a record, in hexadecimal, and the KRC's port. It prints its own
port, and the identifier of the process beside it.
"""

import signal
import socket
import sys
import time

from crash_bench import PLAN

from deltaq_services.robot_server.crash_brake.watch import CrashWatch


def main() -> None:
    """Leave the record, and wait for the end."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        try:
            with CrashWatch(PLAN, sock) as watch:
                while watch.detail:
                    time.sleep(0.01)
                watch.write(bytes.fromhex(sys.argv[1]), ("127.0.0.1", int(sys.argv[2])), time.monotonic())
                watch.sent()
                print(sock.getsockname()[1], watch.pid, flush=True)
                try:
                    if sys.stdin.readline() == "fail\n":
                        raise RuntimeError("a fault of the Robot Server")
                except SystemExit:
                    return
        finally:
            print("ended", flush=True)


if __name__ == "__main__":
    main()
