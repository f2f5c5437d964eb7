"""Finds the situations near obstacles in which the gate has most to do: `python -m studies.cornered`.

Adversaries drive both robots of the lab cell into each other and into the structure, over several seeds, and each
decision is timed. Of each run only some of the slowest are kept, so that the set does not show one corner alone. Others
read what is stored here (`deltaq_experiments.bench.decisions`).
"""

import gzip
import heapq
import time
from collections.abc import Iterable
from itertools import count
from pathlib import Path

import msgpack
import numpy as np

from deltaq_deploy.launch.program import run_program
from deltaq_experiments.bench.decisions import CELL, FILE, CorneredSituation
from deltaq_protocol.codec import pack
from deltaq_protocol.guarded import Request
from deltaq_protocol.messages import Message, Outcome, Phase, Verdict
from deltaq_services.outputs import ToTopic
from deltaq_testing.attack import Adversary
from deltaq_testing.virtual_cell.cell import VirtualCell

SEEDS = range(10)
KEPT_OF_A_SEED = 5
CYCLES = 600
"""Cycles of one seed."""


def store(situations: Iterable[CorneredSituation], file: Path = FILE) -> None:
    """Write situations; the same ones are the same bytes."""
    pairs = [(pack(one.memory), pack(one.request)) for one in situations]
    file.write_bytes(gzip.compress(msgpack.packb(pairs), mtime=0))


class _WatchedCell(VirtualCell):
    """A virtual cell that keeps the slowest decisions of its gate, each as long as it took the second time."""

    def __init__(self, kept: int) -> None:
        super().__init__(CELL)
        self._kept = kept
        self._order = count()
        self.slowest: list[tuple[float, int, CorneredSituation]] = []

    def gate_takes(self, message: Message) -> list[ToTopic]:
        if not isinstance(message, Request) or message.dq is None:
            return super().gate_takes(message)
        memory = self.sim.snapshot()
        super().gate_takes(message)  # with warm caches counts what the gate has to do
        self.sim.restore(memory)
        begin = time.thread_time()
        outputs = super().gate_takes(message)
        took = time.thread_time() - begin
        verdicts = [one.message for one in outputs if isinstance(one.message, Verdict)]
        if any(verdict.outcome is not Outcome.REFUSED for verdict in verdicts):
            entry = (took, next(self._order), CorneredSituation(memory, message))
            if len(self.slowest) < self._kept:
                heapq.heappush(self.slowest, entry)
            else:
                heapq.heappushpop(self.slowest, entry)
        return outputs


def find(
    seed: int, cycles: int = CYCLES, kept: int = KEPT_OF_A_SEED
) -> list[tuple[float, CorneredSituation]]:
    """The slowest decisions of one run of adversaries, the slowest first, each with its time [s]."""
    random = np.random.default_rng(seed)
    stack = _WatchedCell(kept)
    cycle_s = stack.cell.description.cycle_s
    adversaries = {name: Adversary(robot, cycle_s, random) for name, robot in stack.cell.robots.items()}
    stack.run_until_ready()
    for name in adversaries:
        stack.acquire(name, f"adversary-{name}")
    for _ in range(cycles):
        stack.cycle()
        q_cmd = {name: np.array(state.q_cmd) for name, state in stack.states.items()}
        tools = {name: robot.forward(q_cmd[name])[:3, 3] for name, robot in stack.cell.robots.items()}
        leases = stack.status().robots
        for name, adversary in adversaries.items():
            if stack.states[name].phase is Phase.HELD:
                stack.reset(name)
            if leases[name].lease.holder is None:
                stack.acquire(name, f"adversary-{name}")
            target = next(tool for other, tool in tools.items() if other != name)
            stack.ask(name, adversary.increment(q_cmd[name], target))
    return [(took, situation) for took, _, situation in sorted(stack.slowest, reverse=True)]


def main() -> None:
    """Find the situations of all seeds, and store them."""
    situations = []
    for seed in SEEDS:
        found = find(seed)
        print(f"seed {seed}: " + ", ".join(f"{took * 1e3:.1f} ms" for took, _ in found), flush=True)
        situations += [situation for _, situation in found]
    store(situations)
    print(f"{len(situations)} situations, {FILE.stat().st_size} bytes in {FILE}")


if __name__ == "__main__":
    run_program(main, "studies.cornered")
