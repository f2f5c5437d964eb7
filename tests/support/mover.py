"""A controller that swings A1 of the floor robot for ever, over a socket, until it is killed."""

import json
import math
import socket
import sys

PEAK_RAD_S = math.radians(40)
PERIOD_S = 4.0


def main() -> None:
    with (
        socket.create_connection(("127.0.0.1", int(sys.argv[1])), timeout=300) as sock,
        sock.makefile("r", encoding="utf-8") as lines,
    ):
        sock.sendall(b'{"type":"hello","protocol":1,"client":"mover"}\n')
        sock.sendall(b'{"type":"lease","robot":"fr","action":"acquire"}\n')
        cycle_s, seq = 0.0, 0
        for line in lines:
            message = json.loads(line)
            if message["type"] == "welcome":
                cycle_s = message["cycle_s"]
            elif message["type"] == "lease":
                print("ready: mover" if message["granted"] else f"refused: {message}", flush=True)
            elif message["type"] == "state" and message["robot"] == "fr":
                seq += 1
                dq = [PEAK_RAD_S * cycle_s * math.sin(2 * math.pi * seq * cycle_s / PERIOD_S), 0, 0, 0, 0, 0]
                increment = {
                    "type": "increment",
                    "robot": "fr",
                    "seq": seq,
                    "cycle": message["cycle"],
                    "dq": dq,
                }
                sock.sendall(json.dumps(increment).encode() + b"\n")


if __name__ == "__main__":
    main()
