"""A stranger in the guarded realm: it joins the endpoints, hears everything, and lacks the key.

As a process it obeys lines on its standard input and may be of another user:
`python stranger.py CELL.yaml [UID]`, then `try FILE`, `record`, `forge`, `repeat`.
"""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from pathlib import Path

import zenoh

from deltaq_cell.load import load_cell
from deltaq_protocol import topics
from deltaq_protocol.brake import brake_cycles
from deltaq_protocol.codec import pack, unpack
from deltaq_protocol.guarded import Admission, Command, Greeting, Request, ServerState, Supervision
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.seal import Seal
from deltaq_protocol.seal_keys import KEY_BYTES, RealmKey
from deltaq_protocol.session import open_session

_RECORDED = 4096
_EVERYTHING = 2**60
"""Greater than any id, lease epoch or number of resets."""


class Stranger:
    """Speaks unsealed, under a seal that it has guessed, and in others' words.

    Attributes:
        states: the newest of each robot that it heard: a seal hides nothing.
        recording: what it heard, key and bytes.
        said: how much under each key.
    """

    macs_of_a_state = 1
    """One key for all; under identities SIM and HLI have one each."""

    def __init__(self, cell):
        self.cell = cell
        endpoints = [cell.sim, *(robot.server for robot in cell.robots.values())]
        self._session = open_session(connect=endpoints, must_connect=True)
        self._heard = self._session.declare_subscriber(
            f"deltaq-guarded/{cell.cell}/**",
            zenoh.handlers.RingChannel(_RECORDED),
            allowed_origin=zenoh.Locality.REMOTE,
        )
        self._guessed = Seal(RealmKey(bytes(KEY_BYTES)))
        self._publishers = {}
        self.said = Counter()
        self.states = {}
        self.recording = []

    def hear(self):
        """Take in what has come."""
        while (sample := self._heard.try_recv()) is not None:
            key, sealed = str(sample.key_expr), sample.payload.to_bytes()
            self.recording = [*self.recording[-_RECORDED:], (key, sealed)]
            if key.endswith("/state"):
                behind = sealed[32 * self.macs_of_a_state :]
                state = unpack(ServerState, behind[17 + 8 * behind[16] :])
                self.states[state.robot] = state

    def say(self, topic, message, **fields):
        key, packed = topic.key(self.cell.cell, **fields), pack(message)
        for payload in (packed, self._guessed.close(key, packed)):
            self._publisher(key).put(payload)
            self.said[key] += 1

    def _publisher(self, key):
        """A publisher whose messages all arrive."""
        if key not in self._publishers:
            block = zenoh.CongestionControl.BLOCK
            self._publishers[key] = self._session.declare_publisher(key, congestion_control=block)
            while not self._publishers[key].matching_status.matching:
                pass  # until it is known who listens
        return self._publishers[key]

    def repeat(self, recording):
        """Say again what services have said; nothing of it is dropped on the way."""
        for key, sealed in recording:
            self._session.put(key, sealed, congestion_control=zenoh.CongestionControl.BLOCK)

    def forge(self):
        """Everything that would move, free or move again what stands, once for each robot."""
        cycles = {name: state.cycle for name, state in self.states.items()}
        for name, state in self.states.items():
            self.say(topics.ADMISSION, self.admission(state), robot=name)
            for order in orders(state):
                self.say(topics.SUPERVISION, order, robot=name)
            self.say(topics.SERVER_STATE, ghost(state), robot=name)
            self.say(topics.REQUEST, request(state), robot=name)
            self.say(topics.GREETING, Greeting(service="hli"), service="hli")
            bound = {"id": _EVERYTHING, "epoch": state.epoch, "cycles": cycles}
            for contact in self.cell.contacts:
                self.say(topics.COMMAND, Command(kind="contact", contact=contact, allowed=True, **bound))
            outputs = dict.fromkeys(state.outputs, True)
            self.say(topics.COMMAND, Command(kind="io", robot=name, outputs=outputs, **bound))
            self.say(topics.COMMAND, Command(kind="reset", robot=name, **bound))

    def admission(self, state):
        """An admission that follows the robot's present plan and keeps every bound of its Robot Server."""
        max_dv = self.cell.robots[state.robot].max_acceleration * self.cell.cycle_s**2
        return Admission(
            robot=state.robot,
            epoch=state.epoch,
            sequence=state.sequence + 1,
            cycle=state.cycle,
            follows_sequence=state.sequence,
            follows_q_cmd=state.q_cmd,
            follows_dq=state.dq,
            follows_resets=state.resets,
            dq=tuple((0.5 * max_dv).tolist()),
            brake_cycles=brake_cycles(0.5 * max_dv, max_dv),
        )

    def close(self):
        self._session.close()


def orders(state):
    """Orders of the gate: a stop, resets, outputs."""
    fields = {"robot": state.robot, "cycle": state.cycle, "cell": state.cell}
    yield Supervision(epoch=state.epoch, stop=ReasonCode.OPERATOR_STOP, **fields)
    for epoch in (0, state.epoch):
        for resets in (state.resets + 1, _EVERYTHING):
            yield Supervision(epoch=epoch, resets=resets, **fields)
    outputs = dict.fromkeys(state.outputs, True)
    yield Supervision(epoch=state.epoch, resets=state.resets, outputs=outputs, **fields)


def ghost(state):
    """The robot is said to be elsewhere, by its own server in the next cycles."""
    q = tuple(value + 0.3 for value in state.q)
    return state.model_copy(update={"cycle": state.cycle + 5, "q": q, "q_cmd": q})


def request(state):
    """An increment under a greater lease than anybody has."""
    dq = (1e-3,) * len(state.q)
    return Request(robot=state.robot, cycle=state.cycle, lease_epoch=_EVERYTHING, seq=1, dq=dq)


def main():
    cell = load_cell(sys.argv[1])
    if len(sys.argv) > 2:
        user = int(sys.argv[2])
        os.setgroups([])
        os.setgid(user)
        os.setuid(user)
    stranger = Stranger(cell)
    print(json.dumps({"uid": os.geteuid()}), flush=True)
    recorded = []  # what is heard after `record` would drive it out, the slower a machine the sooner
    for line in sys.stdin:
        verb, _, file = line.strip().partition(" ")
        stranger.hear()
        answer = "done"
        match verb:
            case "try":
                try:
                    answer = Path(file).read_text()
                except OSError as error:
                    answer = type(error).__name__
            case "record":
                recorded = stranger.recording
                answer = len(recorded)
            case "forge":
                stranger.forge()
            case "repeat":
                stranger.repeat(recorded)
        print(json.dumps(answer), flush=True)
    stranger.close()


if __name__ == "__main__":
    main()
