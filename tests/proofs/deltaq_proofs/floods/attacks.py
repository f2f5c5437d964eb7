"""The list of attacks, and the process of one attacker: `python -m deltaq_proofs.floods.attacks CELL NAME`."""

from __future__ import annotations

import contextlib
import signal
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Never

import zenoh

from deltaq_cell.description import CellDescription
from deltaq_cell.load import load_cell
from deltaq_proofs.floods import line_attacks
from deltaq_proofs.floods.line_attacks import Step
from deltaq_protocol import topics
from deltaq_protocol.codec import pack, unpack
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.messages import (
    DescribeRequest,
    Increment,
    LeaseAction,
    LeaseReply,
    LeaseRequest,
    Message,
    ResetRequest,
    StopRequest,
)
from deltaq_protocol.proof import Prover
from deltaq_protocol.session import open_session
from deltaq_protocol.topic import Topic

_NO_PROOF = bytes(80)
_ASKED_AT_ONCE = 32
_TIMEOUT_S = 0.5


def increments(size: int) -> Callable[[CellDescription], Step]:
    """Increments that no lease proves, with `size` bytes beside what they need."""

    def attack(cell: CellDescription) -> Step:
        robot = next(iter(cell.robots))
        session, key = _session(cell), topics.INCREMENT.key(cell.cell, robot=robot)
        forged = pack(Increment(robot=robot, seq=1, cycle=1, dq=(0.0,) * 6, lease="x" * size))
        return lambda: _put(session, key, forged, bytes(40))

    return attack


def questions(topic: Topic) -> Callable[[CellDescription], Step]:
    """Questions of a topic without a proof that is right."""

    def attack(cell: CellDescription) -> Step:
        robot = next(iter(cell.robots))
        asked: dict[str, Message] = {
            topics.LEASE.name: LeaseRequest(robot=robot, action=LeaseAction.RENEW),
            topics.RESET.name: ResetRequest(robot=robot),
            topics.STOP.name: StopRequest(client="flood"),
        }
        message = pack(asked.get(topic.name, DescribeRequest()))
        session, key = _session(cell), topic.key(cell.cell, robot=robot)
        return lambda: _ask(session, key, message, lambda: _NO_PROOF)

    return attack


def proven_questions(cell: CellDescription) -> Step:
    """Renewals of the lease of the cell's last robot, each with a new proof."""
    session, key, message, prover = _leased(cell)
    return lambda: _ask(session, key, message, lambda: prover.prove_next(key, message))


def replayed_questions(cell: CellDescription) -> Step:
    """The same renewal with the same proof, as whoever overheard it sends it."""
    session, key, message, prover = _leased(cell)
    proof = prover.prove_next(key, message)
    return lambda: _ask(session, key, message, lambda: proof)


def subscribers_that_do_not_read(cell: CellDescription) -> Step:
    """One more session that hears everything and returns from nothing; up to eight."""
    sessions: list[Any] = []

    def never_return(_: zenoh.Sample) -> Never:
        while True:
            threading.Event().wait()

    def step() -> None:
        if len(sessions) < 8:
            sessions.append(_session(cell))
            sessions[-1].declare_subscriber(
                "deltaq/**", zenoh.handlers.Callback(never_return, indirect=False)
            )
        threading.Event().wait(0.1)

    return step


def _session(cell: CellDescription) -> Any:
    return open_session(connect=[cell.hli], must_connect=True)


def _put(session: Any, key: str, message: bytes, proof: bytes) -> None:
    block = zenoh.CongestionControl.BLOCK
    session.put(key, message, attachment=proof, congestion_control=block)


def _ask(session: Any, key: str, message: bytes, prove: Callable[[], bytes]) -> None:
    """Ask some at once, and wait for what is answered."""
    asked = [
        session.get(key, payload=message, attachment=prove(), timeout=_TIMEOUT_S)
        for _ in range(_ASKED_AT_ONCE)
    ]
    for answers in asked:
        for _ in answers:
            pass


def _leased(cell: CellDescription) -> tuple[Any, str, bytes, Prover]:
    """A session, and what renews the lease that it was granted."""
    robot = list(cell.robots)[-1]
    session, key = _session(cell), topics.LEASE.key(cell.cell, robot=robot)
    acquire = LeaseRequest(robot=robot, action=LeaseAction.TAKE, client="flood")
    for reply in session.get(key, payload=pack(acquire), timeout=_TIMEOUT_S):
        if reply.ok is not None:
            lease = unpack(LeaseReply, reply.ok.payload.to_bytes()).lease
            message = pack(LeaseRequest(robot=robot, action=LeaseAction.RENEW, client="flood"))
            return session, key, message, Prover(lease or "")
    raise ServiceUnreachableError(f"no lease of {robot} was granted to the flood")


OVERSIZED_BYTES = 200_000


@dataclass(frozen=True)
class Attack:
    """One of the list.

    Attributes:
        begin: makes what is repeated.
        stops: it stops the robots, which everybody may.
        encrypted: the lines have to be encrypted for it.
    """

    begin: Callable[[CellDescription], Step]
    stops: bool = False
    encrypted: bool = False


ATTACKS = {
    "lines": Attack(line_attacks.lines),
    "increments over lines": Attack(line_attacks.increments_over_lines),
    "oversized lines": Attack(line_attacks.oversized_lines),
    "lines without an end": Attack(line_attacks.unterminated_lines),
    "connections": Attack(line_attacks.connections),
    "slow readers of lines": Attack(line_attacks.slow_readers),
    "increments": Attack(increments(16)),
    "oversized increments": Attack(increments(OVERSIZED_BYTES)),
    "leases": Attack(questions(topics.LEASE)),
    "challenges": Attack(questions(topics.CHALLENGE)),
    "descriptions": Attack(questions(topics.DESCRIPTION)),
    "statuses": Attack(questions(topics.STATUS)),
    "resets": Attack(questions(topics.RESET)),
    "proven questions": Attack(proven_questions),
    "replayed questions": Attack(replayed_questions),
    "subscribers that do not read": Attack(subscribers_that_do_not_read),
    "stops": Attack(questions(topics.STOP), stops=True),
    "stops over lines": Attack(line_attacks.stops_over_lines, stops=True),
    "handshakes": Attack(line_attacks.handshakes, encrypted=True),
}


def main() -> None:
    """Flood until a signal ends it; what is refused or breaks is tried again."""
    cell, attack = load_cell(sys.argv[1]), ATTACKS[sys.argv[2]]
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    step = attack.begin(cell)
    print("ready: it floods", flush=True)
    said = 0
    try:
        while True:
            with contextlib.suppress(OSError):
                step()
            said += 1
    finally:
        print(said, flush=True)


if __name__ == "__main__":
    main()
