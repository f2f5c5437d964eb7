# /// script
# requires-python = ">=3.11"
# dependencies = []
# ///
"""Turn A1 of the floor robot by 10 degrees at 30 degrees/s, with a socket and json and nothing else."""

import json
import math
import socket
import sys

host, port = sys.argv[1:3] if len(sys.argv) > 2 else ("127.0.0.1", "5210")
with (
    socket.create_connection((host, int(port)), timeout=5) as sock,
    sock.makefile("r", encoding="utf-8") as lines,  # to read only: one file for both would lose lines
):
    sock.sendall(b'{"type":"hello","protocol":3,"client":"example"}\n')
    sock.sendall(b'{"type":"lease","robot":"fr","action":"acquire"}\n')
    target, seq, left = None, 0, math.inf
    while abs(left) > math.radians(0.05):
        message = json.loads(lines.readline())
        if message["type"] == "welcome":
            step = math.radians(30) * message["cycle_s"]  # [rad] in one cycle
        elif message["type"] == "error" or message.get("granted") is False:
            sys.exit(f"refused: {message}")
        elif message["type"] == "verdict" and message["outcome"] != "admitted":
            print(message["outcome"], *[reason["code"] for reason in message["reasons"]])
        elif message["type"] == "state" and message["robot"] == "fr":
            if message["phase"] == "held":
                sys.exit(f"fr is held: {message['reason']}; when it is safe, `deltaq reset --robot fr`")
            q, cycle, seq = message["q_cmd"], message["cycle"], seq + 1
            target = q[0] + math.radians(10) if target is None else target
            left = target - q[0]
            dq = [max(-step, min(step, 0.2 * left))] + [0.0] * (len(q) - 1)
            increment = {"type": "increment", "robot": "fr", "seq": seq, "cycle": cycle, "dq": dq}
            sock.sendall(json.dumps(increment).encode() + b"\n")
    sock.sendall(b'{"type":"lease","robot":"fr","action":"release"}\n')
    while json.loads(lines.readline())["type"] != "lease":
        continue  # closing before it is read would look like a controller that was lost
    print(f"A1 is at {math.degrees(q[0]):.2f} deg after {seq} increments")
