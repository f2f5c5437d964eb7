"""The list of attacks, and the process of one attacker: `python -m deltaq_proofs.floods.attacks CELL NAME`."""

from __future__ import annotations

import contextlib
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass

from deltaq_cell.description import CellDescription
from deltaq_cell.load import load_cell
from deltaq_proofs.floods import line_attacks, zenoh_attacks
from deltaq_proofs.floods.line_attacks import Step
from deltaq_protocol import topics

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
    "increments": Attack(zenoh_attacks.increments(16)),
    "oversized increments": Attack(zenoh_attacks.increments(OVERSIZED_BYTES)),
    "leases": Attack(zenoh_attacks.questions(topics.LEASE)),
    "challenges": Attack(zenoh_attacks.questions(topics.CHALLENGE)),
    "descriptions": Attack(zenoh_attacks.questions(topics.DESCRIPTION)),
    "statuses": Attack(zenoh_attacks.questions(topics.STATUS)),
    "resets": Attack(zenoh_attacks.questions(topics.RESET)),
    "proven questions": Attack(zenoh_attacks.proven_questions),
    "replayed questions": Attack(zenoh_attacks.replayed_questions),
    "subscribers that do not read": Attack(zenoh_attacks.subscribers_that_do_not_read),
    "stops": Attack(zenoh_attacks.questions(topics.STOP), stops=True),
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
