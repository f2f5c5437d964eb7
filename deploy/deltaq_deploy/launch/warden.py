"""Ends the services of a launcher that was killed: the robots come to rest first.

The launcher passes each process that it starts on to a small process of its own, the warden, over a socket. When the
launcher ends, however it ends, the kernel closes the socket. The warden then terminates the services that decide and
command; Robot Servers miss the gate and complete their brakes; then it terminates those and the emulators.

The warden also holds the reading ends of their output: a Robot Server whose output broke would end in mid-brake. If it
is killed with the launcher, the lifelines of the services break, which ends them as SIGTERM does; see `Lifeline`.
"""

import contextlib
import os
import select
import signal
import socket
import subprocess
import sys
import time
from dataclasses import dataclass
from typing import Self

REST_S = 3.0
"""Time after which a Robot Server without a gate is at rest: a brake takes well below a second on every shipped
robot.
"""
GRACE_S = 5.0
"""How long a process may take to end by itself."""

_MESSAGE_BYTES = 64
_MOST_HELD = 4


class Warden:
    """The launcher's side; a context manager that lets the warden go."""

    def __init__(self) -> None:
        self._socket, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with its:
            # in a session of its own, so that nothing meant for the launcher reaches it
            self._process = subprocess.Popen(
                [sys.executable, "-m", "deltaq_deploy.launch.warden"],
                stdin=its.fileno(),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def keep(self, pid: int, *held: int, brakes: bool = False) -> None:
        """Have a process ended after this one.

        Args:
            pid: of the process, the leader of its group.
            held: descriptors that the warden holds for it: where its output is read from, and of its lifeline.
            brakes: a robot may need it to come to rest.
        """
        with contextlib.suppress(OSError):  # a warden that was killed is missed only if the launcher is, too
            socket.send_fds(self._socket, [f"{pid} {int(brakes)}".encode()], held)

    def close(self) -> None:
        """End the warden; it ends the processes that still run."""
        self._socket.close()
        self._process.wait()


@dataclass(frozen=True)
class _Kept:
    """A process, by a descriptor that stays its own even if its number is given away again."""

    pid: int
    descriptor: int
    held: tuple[int, ...]
    brakes: bool

    def runs(self) -> bool:
        return not select.select([self.descriptor], [], [], 0)[0]

    def signal(self, number: signal.Signals) -> None:
        if self.runs():
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self.pid, number)

    def close(self) -> None:
        for number in (self.descriptor, *self.held):
            os.close(number)


def main() -> int:
    """Hold the launcher's processes until the launcher ends, then end them in order."""
    kept: list[_Kept] = []
    with socket.socket(fileno=sys.stdin.fileno()) as launcher:
        while True:
            message, held, _, _ = socket.recv_fds(launcher, _MESSAGE_BYTES, _MOST_HELD)
            if not message:
                break
            pid, brakes = map(int, message.split())
            try:
                descriptor = os.pidfd_open(pid)
            except ProcessLookupError:
                for number in held:
                    os.close(number)
                continue  # it has ended since
            kept.append(_Kept(pid, descriptor, tuple(held), bool(brakes)))
            for ended in [each for each in kept if not each.runs()]:
                ended.close()
                kept.remove(ended)
    _end([each for each in kept if not each.brakes])
    braking = [each for each in kept if each.brakes]
    _wait(braking, REST_S)
    _end(braking)
    _wait(kept, GRACE_S)
    for each in kept:
        each.signal(signal.SIGKILL)
    return 0


def _end(kept: list[_Kept]) -> None:
    for each in kept:
        each.signal(signal.SIGTERM)


def _wait(kept: list[_Kept], at_most_s: float) -> None:
    """Until all of them have ended, or the time is over."""
    poll = select.poll()
    running = {each.descriptor for each in kept if each.runs()}
    for descriptor in running:
        poll.register(descriptor, select.POLLIN)
    end = time.monotonic() + at_most_s
    while running and (left_s := end - time.monotonic()) > 0.0:
        for descriptor, _ in poll.poll(left_s * 1e3):
            poll.unregister(descriptor)
            running.discard(descriptor)


if __name__ == "__main__":
    raise SystemExit(main())
