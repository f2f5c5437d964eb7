"""Explore the composed system and say what was found: `python -m deltaq_proofs.model_checker`.

Exit status: 0 every property holds within the bounds, 1 a counterexample was found.
"""

import argparse
import json
import sys

from deltaq_deploy.launch.program import run_program
from deltaq_proofs.model_checker.attacked import AttackedSystem
from deltaq_proofs.model_checker.explore import Exploration, explore
from deltaq_proofs.model_checker.safety_monitor import Property
from deltaq_proofs.model_checker.seeded_bugs import BROKEN
from deltaq_proofs.model_checker.system import System


def main(arguments: list[str] | None = None) -> int:
    """Explore; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python -m deltaq_proofs.model_checker",
        description="Explore SIM and Robot Server, their own code, over faulty links and crashes.",
    )
    parser.add_argument(
        "--faults",
        type=int,
        help="largest number of faults on one path; default: 0, or what it takes to see what is broken",
    )
    parser.add_argument(
        "--cycles", type=int, default=40, help="largest number of the robot's cycles on one path"
    )
    parser.add_argument(
        "--attacks",
        type=int,
        help="largest number of attacks on RSI's wire on one path; includes RSI's own code",
    )
    parser.add_argument(
        "--lookahead-cycles", type=int, default=1, help="how many cycles ahead SIM decides; default: 1"
    )
    broken = {one.system.__name__: one for one in BROKEN}
    parser.add_argument("--broken", choices=sorted(broken), help="explore a system that is broken on purpose")
    parser.add_argument("--json", action="store_true", help="one JSON object instead of text")
    given = parser.parse_args(arguments)
    seeded = None if given.broken is None else broken[given.broken]
    system = _system(given.attacks, given.lookahead_cycles) if seeded is None else seeded.system()
    faults: int = given.faults if given.faults is not None else 0 if seeded is None else seeded.faults
    found = explore(system, faults, given.cycles, None if given.json else _tell)
    print(
        json.dumps(_fields(found, faults, given.attacks, given.lookahead_cycles))
        if given.json
        else _text(found, faults)
    )
    return 0 if found.counterexample is None else 1


def _system(attacks: int | None, lookahead_cycles: int) -> System:
    return System(lookahead_cycles) if attacks is None else AttackedSystem(attacks)


def _tell(cycle: int, states: int) -> None:
    print(f"cycle {cycle:3d}: {states} states", file=sys.stderr, flush=True)


def _fields(found: Exploration, faults: int, attacks: int | None, lookahead_cycles: int) -> dict[str, object]:
    example = found.counterexample
    return {
        "states": found.states,
        "moves": found.moves,
        "cycles": found.cycles,
        "faults": faults,
        "attacks": attacks,
        "lookahead_cycles": lookahead_cycles,
        "complete": found.complete,
        "holds": example is None,
        "properties": {one.name.lower(): one.value for one in Property},
        "counterexample": None
        if example is None
        else {
            "property": example.violation.broken.name.lower(),
            "what": str(example.violation),
            "moves": list(example.moves),
        },
    }


def _text(found: Exploration, faults: int) -> str:
    bound = "however many cycles" if found.complete else f"{found.cycles} cycles"
    head = f"{found.states} states by {found.moves} moves; {bound}, at most {faults} faults"
    if found.counterexample is None:
        return "\n".join([head, *(f"holds: {one}" for one in Property)])
    moves = [f"{number:3d}  {move}" for number, move in enumerate(found.counterexample.moves, 1)]
    return "\n".join([head, f"broken: {found.counterexample.violation}", *moves])


if __name__ == "__main__":
    run_program(main, "deltaq_proofs.model_checker")
