"""The measurement: a cell of real processes, a robot that moves, an observer, and one flood after another."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from deltaq_cell.description import CellDescription
from deltaq_cell.load import load_cell
from deltaq_deploy.launch.bring_to_rest import stop_over_a_line
from deltaq_deploy.launch.cell_connection import connect, listen
from deltaq_deploy.launch.launcher import Launcher
from deltaq_deploy.launch.services import Role, Service, cell_services
from deltaq_proofs.floods.attacks import ATTACKS, Attack
from deltaq_protocol import topics
from deltaq_protocol.blocking import BlockingCell
from deltaq_protocol.errors import DeltaqError, ServiceUnreachableError
from deltaq_protocol.messages import Phase, RobotStatus
from deltaq_services.hli.line_encryption import CERTIFICATE_FILE, KEY_FILE

_PATIENCE_S = 60.0
_LOOK_S = 0.05
_SETTLES_S = 1.0
"""Of a flood, before the figures of the others count."""
_ENDS_WITHIN_S = 10.0


@dataclass(frozen=True)
class FloodFigures:
    """What others got in some seconds.

    Attributes:
        states_hz: states a second of all robots, at an observer over zenoh.
        braked_cycles: of the robot that moves, in which no increment had been admitted.
        admitted: share of its cycles with a fresh admission.
    """

    states_hz: float
    braked_cycles: int
    admitted: float


@dataclass(frozen=True)
class FloodRow:
    """One attack of the list.

    Attributes:
        attack: its name.
        steps_s: steps a second of all attackers.
        without: right before it.
        during: while it lasts.
        states_kept: share of the states.
        stop_s: from each question for a stop to the answer that all robots are held, over a session that was there
            before [s]; None: no answer in time.
        line_stop_s: the same over a new connection each, in the clear.
        encrypted_stop_s: the same over a new encrypted line each, of who has the HLI's certificate; none where lines
            are in the clear.
    """

    attack: str
    steps_s: float
    without: FloodFigures
    during: FloodFigures
    states_kept: float
    stop_s: tuple[float | None, ...]
    line_stop_s: tuple[float | None, ...]
    encrypted_stop_s: tuple[float | None, ...]


def measure(
    cell_name: str, robot: str, names: Iterable[str], duration_s: float, attackers: int, stops: int
) -> Iterator[FloodRow]:
    """Figures beside each of these attacks.

    Args:
        cell_name: of a cell that nobody else runs.
        robot: the one that moves.
        names: of attacks.
        duration_s: of each count, without a flood and during one.
        attackers: processes that flood at a time.
        stops: that are asked for each way, of a robot that moves; while others ask for stops none does.
    """
    chosen = {name: ATTACKS[name] for name in names}
    for is_encrypted in (False, True):
        group = {name: one for name, one in chosen.items() if one.encrypted is is_encrypted}
        if group:
            with _certificate() if is_encrypted else _unchanged(), _Bench(cell_name, robot) as bench:
                for name, attack in group.items():
                    yield bench.row(name, attack, duration_s, attackers, stops)


class _Bench:
    """A cell that runs, its holder, and its observer."""

    def __init__(self, cell_name: str, robot: str) -> None:
        self._cell_name, self._robot = cell_name, robot
        self._cell: CellDescription = load_cell(cell_name)
        holder = ("-m", "deltaq_proofs.floods.holder", cell_name, robot)
        services = (
            *cell_services(self._cell, cell_name),
            Service("holder", Role.LEADER, holder, needs=("hli",)),
        )
        self._launcher = Launcher(services, lambda *_: None, signals_raise=True)
        self._states: Counter[str] = Counter()

    def __enter__(self) -> _Bench:
        self._launcher.__enter__()
        try:
            self._launcher.start()
            self._connection = connect(self._cell, "floods")
            self._running: BlockingCell = self._connection.__enter__()
            self._listening = listen(self._cell)
            listener = self._listening.__enter__()
            for robot in self._cell.robots:
                listener.subscribe(topics.STATE, self._counter(robot), robot)
            self._set_moving()
        except BaseException:
            self._launcher.__exit__(None, None, None)
            raise
        return self

    def __exit__(self, *about: Any) -> None:
        with suppress(DeltaqError):
            self._listening.__exit__(None, None, None)
            self._connection.__exit__(None, None, None)
        self._launcher.__exit__(*about)

    def row(self, name: str, attack: Attack, duration_s: float, attackers: int, stops: int) -> FloodRow:
        """The figures of one attack."""
        self._set_moving()
        without = self._figures(duration_s)
        with _flood(self._cell_name, name, attackers) as said:
            time.sleep(_SETTLES_S)
            during = self._figures(duration_s)
            took = self._stops(attack, stops)
        kept = during.states_hz / without.states_hz
        return FloodRow(name, said(), without, during, kept, *took)

    def _stops(self, attack: Attack, stops: int) -> tuple[tuple[float | None, ...], ...]:
        """How long each stop took, over the session, over lines in the clear and encrypted ones, in turns [s]."""
        ways: tuple[Callable[[], object], ...] = (
            lambda: self._running.stop(),
            lambda: stop_over_a_line(self._cell, {}),
            lambda: stop_over_a_line(self._cell),
        )
        took: tuple[list[float | None], ...] = ([], [], [])
        for _ in range(stops):
            for times, stop in zip(took, ways if attack.encrypted else ways[:2], strict=False):
                if not attack.stops:
                    self._set_moving()
                times.append(self._stopped(stop))
        return tuple(map(tuple, took))

    def _counter(self, robot: str) -> Callable[[Any], None]:
        def count(_: Any) -> None:
            self._states[robot] += 1

        return count

    def _figures(self, duration_s: float) -> FloodFigures:
        before, begin_s = self._counts(), time.monotonic()
        states = self._states.total()
        time.sleep(duration_s)
        took_s, states = time.monotonic() - begin_s, self._states.total() - states
        after = self._counts()
        cycles = max(1, after["cycle"] - before["cycle"])
        admissions = after.get("admissions", 0) - before.get("admissions", 0)
        braked = after.get("braked_cycles", 0) - before.get("braked_cycles", 0)
        return FloodFigures(states / took_s, braked, admissions / cycles)

    def _counts(self) -> Mapping[str, int]:
        one: RobotStatus = self._asked(lambda: self._running.status()).robots[self._robot]
        return one.counters | {"cycle": one.cycle}

    def _stopped(self, stop: Callable[[], object]) -> float | None:
        begin_s = time.monotonic()
        try:
            stop()
        except DeltaqError:
            return None
        return time.monotonic() - begin_s

    def _set_moving(self) -> None:
        """Reset what is held, until the robot is driven again."""
        deadline = time.monotonic() + _PATIENCE_S
        while time.monotonic() < deadline:
            robots = self._asked(lambda: self._running.status()).robots
            if robots[self._robot].phase is Phase.ENGAGED:
                return
            for name, one in robots.items():
                if one.phase is Phase.HELD:
                    with suppress(DeltaqError):  # it is not at rest yet
                        self._running.reset(name)
            time.sleep(_LOOK_S)
        raise ServiceUnreachableError(f"{self._robot} was not driven again within {_PATIENCE_S:g} s")

    def _asked(self, ask: Callable[[], Any]) -> Any:
        """An answer, sooner or later: a flood may have the question wait."""
        deadline = time.monotonic() + _PATIENCE_S
        while True:
            try:
                return ask()
            except ServiceUnreachableError:
                if time.monotonic() > deadline:
                    raise


@contextmanager
def _flood(cell_name: str, name: str, attackers: int) -> Iterator[Callable[[], float]]:
    """Attackers in processes of their own; within the block they flood, after it the steps a second are known."""
    command = [sys.executable, "-m", "deltaq_proofs.floods.attacks", cell_name, name]
    processes = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        for _ in range(attackers)
    ]
    rates: list[float] = []
    try:
        for process in processes:
            assert process.stdout is not None  # a pipe was asked for
            if not process.stdout.readline().startswith("ready:"):
                raise ServiceUnreachableError(f"the flood of {name} could not begin")
        begin_s = time.monotonic()
        yield lambda: sum(rates)
        took_s = time.monotonic() - begin_s
    finally:
        for process in processes:
            process.send_signal(signal.SIGTERM)
        for process in processes:
            try:
                told = process.communicate(timeout=_ENDS_WITHIN_S)[0]
            except subprocess.TimeoutExpired:
                process.kill()
                told = process.communicate()[0]
            with suppress(ValueError, UnboundLocalError):
                rates.append(int(told) / took_s)


@contextmanager
def _unchanged() -> Iterator[None]:
    yield


@contextmanager
def _certificate() -> Iterator[None]:
    """The environment names a certificate for the lines, as `docs/how-to/talk-over-a-socket.md` makes one."""
    with tempfile.TemporaryDirectory() as folder:
        key, certificate = Path(folder) / "lines.key", Path(folder) / "lines.pem"
        subprocess.run(
            ["openssl", "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:P-256", "-nodes", "-days", "2",
             "-subj", "/CN=deltaq", "-keyout", str(key), "-out", str(certificate)],
            check=True, capture_output=True,
        )  # fmt: skip
        given = {CERTIFICATE_FILE: str(certificate), KEY_FILE: str(key)}
        before = {name: os.environ.get(name) for name in given}
        os.environ.update(given)
        try:
            yield
        finally:
            for name, value in before.items():
                if value is None:
                    del os.environ[name]
                else:
                    os.environ[name] = value
