"""The live benchmark's reference in bare Python: the same messages over zenoh, and nothing else.

Each process blocks on the messages of a topic, unpacks each and packs what follows from it. There is no gate, no law
and no check. So the chain shows what zenoh and Python cost, and what a cell adds to it.
`python -m deltaq_experiments.bench.bare_chain PROCESS FOLDER CYCLE_S` is one process of it.
"""

import json
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from subprocess import PIPE
from typing import Any

import msgpack
import zenoh
from pydantic import BaseModel

from deltaq_experiments.bench.hop_reference import processor_seconds, wakeups
from deltaq_experiments.bench.live_figures import LiveRow, Quantiles, RobotFigures
from deltaq_protocol.errors import DeltaqError

PASSES: dict[str, dict[str, tuple[str, ...]]] = {
    "robot-server": {"guarded/admission": (), "guarded/supervision": ()},
    "sim": {
        "guarded/state": ("guarded/supervision",),
        "guarded/request": ("guarded/admission", "guarded/verdict"),
    },
    "hli": {
        "guarded/state": ("open/state",),
        "guarded/verdict": ("open/verdict",),
        "open/increment": ("guarded/request",),
    },
    "client": {"open/state": ("open/increment",), "open/verdict": ()},
}
"""By kind of process: the topics that it takes, and those on which it passes each message on."""
_MESSAGE = {"q": [0.1] * 9, "q_cmd": [0.2] * 9, "dq": [0.0] * 9, "phase": "engaged", "time_s": 0.1}
_RING = 16
_ENDS_WITHIN_S = 10.0


class BareChain(BaseModel, frozen=True):
    """Cost of the reference chain.

    Attributes:
        processor_us: processor time of each process in a cycle [µs].
        wakeups: of the threads of each process, in a cycle.
        age_p50_ms, age_p99_ms: from a state to its admission, of all robots [ms].
        in_time: share of states whose admission came at all, once the first had come.
    """

    processor_us: dict[str, float]
    wakeups: dict[str, float]
    age_p50_ms: float
    age_p99_ms: float
    in_time: float


def measured(
    robots: Sequence[str], cycle_s: float, duration_s: float, folder: Path, wait: Callable[[float], None]
) -> BareChain:
    """Run the chain for some robots, each with a client.

    Args:
        robots: names.
        cycle_s: each robot tells its state once in this time [s].
        duration_s: of the measurement [s].
        folder: empty, for its Unix sockets.
        wait: waits for a time [s]; an exception ends the chain.

    Raises:
        DeltaqError: if a process ends, or does not serve in time.
    """
    names = [
        *(f"robot-server-{robot}" for robot in robots),
        "sim",
        "hli",
        *(f"client-{robot}" for robot in robots),
    ]
    with ExitStack() as stack:
        processes = {name: _start(name, folder, cycle_s, stack) for name in names}
        wait(1.0)  # connections are made
        spent = {name: processor_seconds(process.pid) for name, process in processes.items()}
        woken = {name: wakeups(process.pid) for name, process in processes.items()}
        begin_s = time.monotonic()
        wait(duration_s)
        cycles = (time.monotonic() - begin_s) / cycle_s
        ended = [name for name, process in processes.items() if process.poll() is not None]
        if ended:
            raise DeltaqError(f"{ended[0]} of the bare chain ended before its time")
        spent = {name: processor_seconds(processes[name].pid) - before for name, before in spent.items()}
        woken = {name: wakeups(processes[name].pid) - before for name, before in woken.items()}
        servers = (processes[f"robot-server-{robot}"] for robot in robots)
        told = [json.loads(server.communicate(timeout=_ENDS_WITHIN_S)[0]) for server in servers]
    ages = Quantiles.of([1e3 * age_s for one in told for age_s in one["ages_s"]])
    if ages.p50 is None or ages.p99 is None:
        raise DeltaqError("no message came through the bare chain")
    return BareChain(
        processor_us={name: 1e6 * spent_s / cycles for name, spent_s in spent.items()},
        wakeups={name: count / cycles for name, count in woken.items()},
        age_p50_ms=ages.p50,
        age_p99_ms=ages.p99,
        in_time=ages.count / sum(one["cycles"] for one in told),
    )


def bare_rows(
    robots: Mapping[str, RobotFigures],
    processor_us: Mapping[str, float],
    woken: Mapping[str, float],
    bare: BareChain,
) -> Iterator[LiveRow]:
    """A cell's cost and its ages beside those of the chain; the cell's emulators have no counterpart in it."""
    spent_us, bare_us = sum(processor_us.values()), sum(bare.processor_us.values())
    yield LiveRow.of("processor time of a cycle, beside bare Python", spent_us, "µs", bare_us)
    counted, bare_counted = sum(woken.values()), sum(bare.wakeups.values())
    yield LiveRow.of("wake-ups of a cycle, beside bare Python", counted, "", bare_counted)
    for name, robot in robots.items():
        age_ms = robot.stations[-1].age_ms
        yield LiveRow.of(
            f"{name}: telegram to admission, beside bare Python", age_ms.p50, "ms", bare.age_p50_ms
        )
        yield LiveRow.of(f"{name}: its p99, beside bare Python", age_ms.p99, "ms", bare.age_p99_ms)


def _start(name: str, folder: Path, cycle_s: float, stack: ExitStack) -> subprocess.Popen[str]:
    """A process that has its session and waits; it ends with its input, and is killed with the stack."""
    command = [sys.executable, "-m", "deltaq_experiments.bench.bare_chain", name, str(folder), str(cycle_s)]
    process = stack.enter_context(subprocess.Popen(command, stdin=PIPE, stdout=PIPE, stderr=PIPE, text=True))
    stack.callback(process.kill)
    assert process.stdout is not None
    if process.stdout.readline() != "ready\n":
        last = process.communicate()[1].strip().rpartition("\n")[2]
        raise DeltaqError(f"{name} of the bare chain did not serve: {last}")
    return process


# --- one process ----------------------------------------------------------------------------------


class _Process:
    """Passes messages on as `PASSES` has it, from threads that block."""

    def __init__(self, name: str, folder: Path) -> None:
        kind = next(kind for kind in PASSES if name.startswith(kind))
        robot = name.removeprefix(kind).removeprefix("-") or "*"
        servers = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
        servers = [server for server in servers if server.startswith("robot-server-")]
        self.robot = robot
        self._folder = folder
        self._publishers: dict[str, zenoh.Publisher] = {}
        self.took: Callable[[str, dict[str, Any]], None] = lambda *_: None
        listens = {"hli": ["hli"], "sim": ["sim"], "robot-server": [name], "client": []}[kind]
        connects = {"hli": ["sim", *servers], "sim": servers, "robot-server": [], "client": []}[kind]
        self._sessions: dict[str, zenoh.Session] = {}
        if kind != "client":
            self._sessions["guarded"] = self._session("peer", listens, connects)
        if kind == "hli":
            self._sessions["open"] = self._session("peer", ["open"], [])
        if kind == "client":
            self._sessions["open"] = self._session("client", [], ["open"])
        for topic, next_topics in PASSES[kind].items():
            ring: Any = zenoh.handlers.RingChannel(_RING)
            subscriber = self._sessions[topic.partition("/")[0]].declare_subscriber(f"{topic}/{robot}", ring)
            threading.Thread(target=self._pass_on, args=(subscriber, topic, next_topics), daemon=True).start()

    def _session(self, mode: str, listens: list[str], connects: list[str]) -> zenoh.Session:
        config = zenoh.Config()
        for key, value in {
            "mode": mode,
            "scouting/multicast/enabled": False,
            "scouting/gossip/enabled": False,
            "listen/endpoints": [f"unixsock-stream/{self._folder}/{name}" for name in listens],
            "connect/endpoints": [f"unixsock-stream/{self._folder}/{name}" for name in connects],
        }.items():
            config.insert_json5(key, json.dumps(value))
        return zenoh.open(config)

    def _pass_on(self, subscriber: Any, topic: str, next_topics: tuple[str, ...]) -> None:
        while True:
            sample = subscriber.recv()
            message = msgpack.unpackb(sample.payload.to_bytes())
            robot = str(sample.key_expr).rpartition("/")[2]
            for next_topic in next_topics:
                self.put(f"{next_topic}/{robot}", message)
            self.took(topic, message)

    def put(self, key: str, message: dict[str, Any]) -> None:
        """Pack and publish a message as the loop's are: at real-time priority, dropped when the link is full."""
        publisher = self._publishers.get(key)
        if publisher is None:
            publisher = self._sessions[key.partition("/")[0]].declare_publisher(
                key,
                priority=zenoh.Priority.REAL_TIME,
                congestion_control=zenoh.CongestionControl.DROP,
                express=True,
            )
            self._publishers[key] = publisher
        publisher.put(msgpack.packb(message))


def _serve(name: str, folder: Path, cycle_s: float) -> None:
    process = _Process(name, folder)
    print("ready", flush=True)
    ended = threading.Event()

    def watch() -> None:
        sys.stdin.read()
        ended.set()

    threading.Thread(target=watch, daemon=True).start()
    if not name.startswith("robot-server-"):
        ended.wait()
        return
    admitted: dict[int, float] = {}

    def took(topic: str, message: dict[str, Any]) -> None:
        if topic == "guarded/admission":
            admitted[message["cycle"]] = time.monotonic()

    process.took = took
    sent: list[float] = []
    next_s = time.monotonic()
    while not ended.wait(next_s - time.monotonic()):
        next_s += cycle_s
        sent.append(time.monotonic())
        process.put(f"guarded/state/{process.robot}", _MESSAGE | {"cycle": len(sent)})
    ages_s = [came_s - sent[cycle - 1] for cycle, came_s in admitted.items()]
    print(json.dumps({"cycles": len(sent) - min(admitted, default=1), "ages_s": ages_s[1:]}))


if __name__ == "__main__":
    _serve(sys.argv[1], Path(sys.argv[2]), float(sys.argv[3]))
