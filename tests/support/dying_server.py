"""A process that holds a socket, leaves the record of a reply in motion, and dies as it is told to.

It stands for a Robot Server: its arguments are a body of a record, in hexadecimal, the KRC's port, and after which time
without a telegram that KRC counts as silent [s]. It prints its own port, and the identifier of the process beside it.
Told `fail` it raises; told `mend` it says what it knows of that process, and which one is beside it then.
"""

import signal
import socket
import sys
import time
from dataclasses import replace

from crash_bench import PLAN

from deltaq_services.robot_server.crash_brake.watch import CrashWatch


def main() -> None:
    """Leave the record, and wait for the end."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        try:
            with CrashWatch(replace(PLAN, silence_s=float(sys.argv[3])), sock) as watch:
                while watch.detail:
                    time.sleep(0.01)
                watch.write(bytes.fromhex(sys.argv[1]), ("127.0.0.1", int(sys.argv[2])), time.monotonic())
                watch.sent()
                try:
                    print(sock.getsockname()[1], watch.pid, flush=True)
                    for line in sys.stdin:
                        if line == "fail\n":
                            raise RuntimeError("a fault of the Robot Server")
                        while watch.ready:  # a signal takes a moment to arrive
                            time.sleep(0.01)
                        print(watch.detail, flush=True)
                        while not watch.ready:
                            watch.mend(time.monotonic())
                            time.sleep(0.01)
                        print(watch.pid, flush=True)
                except SystemExit:
                    return
        finally:
            print("ended", flush=True)


if __name__ == "__main__":
    main()
