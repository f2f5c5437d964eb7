"""The controller that moves while faults are injected: one joint at a constant speed, to and fro.

It only ever asks for its cruising speed; how fast that may be reached is the gate's to say. As a process it speaks
JSON lines: `python -m deltaq_testing.faults.mover PORT ROBOT HOME_RAD`.
"""

import contextlib
import json
import socket
import sys
import time
from collections.abc import Sequence
from typing import Any

import numpy as np

from deltaq_protocol.arrays import Array
from deltaq_protocol.messages import PROTOCOL_VERSION

CRUISE_RAD_S = np.deg2rad(30.0)
SWING_RAD = np.deg2rad(85.0)
"""How far it goes before it turns: longer than a run, so that no turn is taken for a brake."""

_RETRY_S = 0.1


class Mover:
    """Swings the first joint about its home position.

    Args:
        joints: number of joints of the robot, n.
        cycle_s: its sample time.
        home: position of the first joint at home [rad].
    """

    def __init__(self, joints: int, cycle_s: float, home: float) -> None:
        self._joints = joints
        self._step = CRUISE_RAD_S * cycle_s
        self._home = home
        self._direction = 1.0

    def increment(self, q_cmd: Sequence[float]) -> Array:
        """(n,) increment [rad] in answer to the setpoint `q_cmd` (n,) [rad or m]."""
        way = q_cmd[0] - self._home
        if way > SWING_RAD:
            self._direction = -1.0
        elif way < 0.0:
            self._direction = 1.0
        dq = np.zeros(self._joints)
        dq[0] = self._direction * self._step
        return dq


def main() -> None:
    """Move for ever, and connect again whenever the HLI is lost."""
    port, robot, home = int(sys.argv[1]), sys.argv[2], float(sys.argv[3])
    print("ready: mover", flush=True)
    while True:
        # the HLI is not there, or left in the middle of a line
        with contextlib.suppress(OSError, ValueError):
            _move(port, robot, home)
        time.sleep(_RETRY_S)


def _move(port: int, robot: str, home: float) -> None:
    with (
        socket.create_connection(("127.0.0.1", port), timeout=10) as sock,
        sock.makefile("r", encoding="utf-8") as lines,  # to read only: one file for both would lose lines
    ):
        acquire = {"type": "lease", "robot": robot, "action": "acquire"}
        _say(sock, {"type": "hello", "protocol": PROTOCOL_VERSION, "client": "mover"})
        _say(sock, acquire)
        mover: Mover | None = None
        cycle_s, seq, leased, asked_cycle = 0.0, 0, False, 0
        for line in lines:
            message = json.loads(line)
            if message["type"] == "welcome":
                cycle_s = message["cycle_s"]
            elif message["type"] == "lease":
                leased = message["granted"]
            elif message["type"] == "verdict":
                leased = leased and all(reason["code"] != "lease_not_held" for reason in message["reasons"])
            elif message["type"] == "state" and message["robot"] == robot:
                # a Robot Server that restarts counts its cycles from one
                if not leased and abs(message["cycle"] - asked_cycle) > _RETRY_S / cycle_s:
                    asked_cycle = message["cycle"]
                    _say(sock, acquire)
                mover = mover or Mover(len(message["q"]), cycle_s, home)
                if leased:
                    seq += 1
                    dq = mover.increment(message["q_cmd"]).tolist()
                    increment = {"type": "increment", "robot": robot, "seq": seq, "cycle": message["cycle"]}
                    _say(sock, increment | {"dq": dq})


def _say(sock: socket.socket, message: dict[str, Any]) -> None:
    sock.sendall(json.dumps(message).encode() + b"\n")


if __name__ == "__main__":
    main()
