"""The process that brakes a robot whose Robot Server has died: real processes, a real socket, no cell."""

import os
import select
import signal
import socket
import subprocess
import sys
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from crash_bench import PLAN, CrashSide

from deltaq_protocol.brake import brake_increment

pytestmark = pytest.mark.long

SUPPORT = Path(__file__).parents[1] / "support"
WAITS_S = 300.0
ROUNDING = 2e-8


class Beside:
    """A server in motion, the process beside it, and the KRC that both speak to."""

    def __init__(self, krc, sock, server):
        self.krc, self.sock, self.server = krc, sock, server
        port, self.pid = map(int, server.stdout.readline().split())
        self.place = ("127.0.0.1", port)
        self.descriptor = os.pidfd_open(self.pid)

    def ask(self):
        """One telegram of the KRC, and the reply to it."""
        self.krc.tick()
        self.sock.sendto(self.krc.own(), self.place)
        told = self.krc.codec.decode(self.sock.recv(4096))
        assert told.ipoc == self.krc.ipoc
        return told

    def has_ended(self, seconds=WAITS_S):
        """Whether the process beside it ends within so long."""
        return bool(select.select([self.descriptor], [], [], seconds)[0])

    def assert_brakes(self):
        """It sends the brake, and the stop in the end, and ends."""
        state = self.krc.server.state
        dq, n = np.array(state.plan.dq), state.plan.brake_cycles
        expected = np.array(self.krc.driver.correction)
        for step in range(1, n + 1 + PLAN.lag_cycles):
            told = self.ask()
            expected = expected + brake_increment(dq, n, step)
            assert told.correction == pytest.approx(expected, abs=ROUNDING)
            assert not told.outputs["stop"]
        for _ in range(3):
            told = self.ask()
            assert told.correction == pytest.approx(expected, abs=ROUNDING)
            assert told.outputs["stop"]
        assert self.has_ended()

    def assert_port_is_free(self):
        with socket.socket(type=socket.SOCK_DGRAM) as free:
            free.bind(self.place)


@contextmanager
def beside(krc=None, silence_s=WAITS_S):
    """A server in motion; this test is its KRC, and may be kept from its cycle for as long as `silence_s`."""
    krc = krc or CrashSide().begin().run_up(4)
    with socket.socket(type=socket.SOCK_DGRAM) as sock:
        sock.bind(("127.0.0.1", 0))
        sock.settimeout(WAITS_S)
        body = krc.record(krc.own()).hex()
        path = os.pathsep.join([str(SUPPORT), os.environ.get("PYTHONPATH", "")])
        with subprocess.Popen(
            [
                sys.executable,
                str(SUPPORT / "dying_server.py"),
                body,
                str(sock.getsockname()[1]),
                str(silence_s),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": path},
            start_new_session=True,
            text=True,
        ) as server:
            beside = Beside(krc, sock, server)
            try:
                yield beside
            finally:
                server.kill()
                with suppress(ProcessLookupError):
                    signal.pidfd_send_signal(beside.descriptor, signal.SIGKILL)
                assert beside.has_ended()
                os.close(beside.descriptor)


@pytest.mark.by_day(1)
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV, signal.SIGABRT])
def test_the_robot_of_a_killed_server_is_braked(number):
    with beside() as both:
        both.server.send_signal(number)
        both.assert_brakes()
        assert both.server.wait(WAITS_S) == -number  # the kernel may still be taking its memory away
        both.assert_port_is_free()
        assert "its robot was braked" in both.server.stdout.read()


@pytest.mark.parametrize(
    ("number", "says"), [(signal.SIGSTOP, "was stopped by SIGSTOP"), (signal.SIGKILL, "was ended by SIGKILL")]
)
def test_a_killed_or_stopped_brake_process_is_reported_and_replaced(number, says):
    with beside() as both:
        os.kill(both.pid, number)
        both.server.stdin.write("mend\n")
        both.server.stdin.flush()
        assert says in both.server.stdout.readline()
        assert both.has_ended()
        os.close(both.descriptor)
        both.pid = int(both.server.stdout.readline())
        both.descriptor = os.pidfd_open(both.pid)
        both.server.kill()
        both.assert_brakes()


def test_signals_to_the_process_group_do_not_end_the_brake_process():
    with beside() as both:
        for ending in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            os.kill(both.pid, ending)
        os.killpg(both.server.pid, signal.SIGKILL)
        for ending in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
            os.kill(both.pid, ending)
        both.assert_brakes()


def test_a_failing_server_has_its_robot_braked_before_it_ends():
    with beside() as both:
        both.server.stdin.write("fail\n")
        both.server.stdin.flush()
        both.assert_brakes()
        assert "ended" in both.server.stdout.read()
        assert both.server.wait(WAITS_S) == 1
        both.assert_port_is_free()


def test_an_orderly_end_of_the_server_ends_the_brake_process():
    with beside() as both:
        both.server.terminate()
        assert both.server.wait(WAITS_S) == 0
        assert both.has_ended(0)
        assert both.server.stdout.read() == "ended\n"


def test_without_a_krc_the_brake_process_ends():
    with beside(silence_s=PLAN.silence_s) as both:
        both.server.kill()
        assert both.has_ended()


def test_while_the_server_runs_the_brake_process_does_not_answer():
    with beside() as both:
        both.krc.tick()
        both.sock.sendto(both.krc.own(), both.place)
        both.sock.settimeout(5 * PLAN.cycle_s)
        with pytest.raises(TimeoutError):
            both.sock.recv(4096)


def test_the_brake_process_may_run_where_its_server_may_not():
    every = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(every)})  # as a server that keeps to one processor
    try:
        with beside() as brake:
            assert os.sched_getaffinity(brake.server.pid) == {min(every)}
            assert os.sched_getaffinity(brake.pid) >= every
    finally:
        os.sched_setaffinity(0, every)


def test_the_brake_process_imports_no_library_of_the_cell():
    with beside() as both:
        mapped = Path(f"/proc/{both.pid}/maps").read_text(encoding="utf-8")
    assert not [name for name in ("numpy", "zenoh", "pinocchio", "openblas") if name in mapped]


def test_the_server_dumps_no_core_that_would_delay_the_brake():
    with beside() as both:
        limits = Path(f"/proc/{both.server.pid}/limits").read_text(encoding="utf-8")
    line = next(line for line in limits.splitlines() if line.startswith("Max core file size"))
    assert line.split()[4] in ("0", "1")


def test_the_brake_process_answers_the_krc_of_the_record():
    with beside() as both, socket.socket(type=socket.SOCK_DGRAM) as other:
        both.server.kill()
        other.bind(("127.0.0.1", 0))
        both.krc.tick()
        other.sendto(both.krc.own(), both.place)
        both.krc.ipoc -= 12
        both.assert_brakes()
        other.setblocking(False)
        with pytest.raises(BlockingIOError):
            other.recv(4096)
