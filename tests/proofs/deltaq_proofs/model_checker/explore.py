"""Breadth-first search of everything that can happen, so that a violation is found by a shortest path."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

from deltaq_proofs.model_checker.safety_monitor import Violation
from deltaq_proofs.model_checker.system import System
from deltaq_proofs.model_checker.system_state import SystemState, Turn


@dataclass(frozen=True, slots=True)
class Counterexample:
    """The shortest path to a violation: one line a move, and the property that then does not hold."""

    moves: tuple[str, ...]
    violation: Violation


@dataclass(frozen=True, slots=True)
class Exploration:
    """What was explored.

    Attributes:
        states: different moments seen.
        moves: moves made from them.
        cycles: length of the longest way followed, in cycles of the robot.
        complete: nothing was left to follow, so that the bound on cycles cut nothing off.
        counterexample: the first violation, by a shortest way; None if every property held.
    """

    states: int
    moves: int
    cycles: int
    complete: bool
    counterexample: Counterexample | None


_Way = tuple[str, ...]


def explore(
    system: System, faults: int, cycles: int, on_cycle: Callable[[int, int], None] | None = None
) -> Exploration:
    """Follow every path within these numbers of faults and cycles.

    Args:
        system: what can happen.
        faults: largest number of faults on one path.
        cycles: largest number of the robot's cycles on one path.
        on_cycle: called with the cycle reached and the number of states so far.
    """
    start = system.start(faults)
    most_left = {_digest(start): faults}
    frontier: list[tuple[SystemState, _Way]] = [(start, ())]
    moves = depth = 0
    while frontier and depth < cycles * len(Turn):
        later: list[tuple[SystemState, _Way]] = []
        for system_state, way in frontier:
            for move in system.moves(system_state):
                moves += 1
                if move.violation is not None:
                    found = Counterexample((*way, move.what), move.violation)
                    return Exploration(len(most_left), moves, depth // len(Turn) + 1, False, found)
                assert move.system_state is not None  # a move without violation leads somewhere
                digest = _digest(move.system_state)
                if most_left.get(digest, -1) < move.system_state.faults_left:
                    most_left[digest] = move.system_state.faults_left
                    later.append((move.system_state, (*way, move.what)))
        frontier = later
        depth += 1
        if on_cycle is not None and depth % len(Turn) == 0:
            on_cycle(depth // len(Turn), len(most_left))
    return Exploration(len(most_left), moves, depth // len(Turn), not frontier, None)


def _digest(system_state: SystemState) -> bytes:
    """128 bits in place of a key: a search holds many."""
    return hashlib.blake2b(repr(system_state.key()).encode(), digest_size=16).digest()
