"""Starts the services of a cell on this machine, watches them, and leaves nothing running."""

import contextlib
import json
import math
import os
import queue
import shutil
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any, Self

from deltaq_deploy.launch.child_process import Child, Exited, Lifeline, Ready
from deltaq_deploy.launch.given_tokens import ConsoleToken, console_needs_token, controllers_token
from deltaq_deploy.launch.program import LaunchError, LaunchInterruptedError
from deltaq_deploy.launch.services import (
    BRAKING_ROLES,
    OPTIONAL_ROLES,
    ORDINARY_ROLES,
    ListeningSocket,
    Role,
    Service,
)
from deltaq_deploy.launch.warden import Warden
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.log import RESULT, read_json_line
from deltaq_services.console.settings import CONSOLE_TOKEN
from deltaq_services.guarded_realm import GUARDED_FOLDER, guarded_folder
from deltaq_services.robot_server.crash_brake.core import PORT_PATIENCE_S

SHOWN_LINES = 12
GRACE_S = 5.0
IDLE_S = 60.0
"""A service that neither serves nor works for so long will not."""
TOLD_EVERY_S = 15.0
"""A service that works on its start is named this often."""
_LEAST_SHARE = 0.02
"""Of one core; a process that only waits uses less, and one that starts on a busy machine more."""
HEED_S = 0.5
"""After which a signal is heeded at the latest."""
_LOOK_S = 0.02


class _Starting:
    """A process that does not serve yet.

    Attributes:
        begun_s, worked_s: when it began, and when it was last seen to work, on the monotonic clock.
        used_s: processor time that it had used when it was looked at last.
    """

    def __init__(self, child: Child) -> None:
        self._child = child
        self.begun_s = self.worked_s = self._looked_s = time.monotonic()
        self.used_s = 0.0

    def works(self) -> bool:
        """Whether it has used the processor since it was looked at last."""
        now_s, used_s = time.monotonic(), self._child.used_s
        works = used_s - self.used_s >= _LEAST_SHARE * (now_s - self._looked_s)
        self.used_s, self._looked_s = used_s, now_s
        if works:
            self.worked_s = now_s
        return works


@dataclass(frozen=True)
class Interrupted:
    """The launcher was asked to stop."""

    number: signal.Signals


LauncherEvent = Ready | Exited | Interrupted


class Launcher:
    """Processes of a cell, one a service; a context manager that ends them all.

    `unrested` says why the robots could not be brought to rest before that; it is empty if they could.

        with Launcher(cell_services(cell, "lab"), on_line=print) as launcher:
            launcher.start()
            launcher.wait()

    Services of a guarded realm meet in a folder that this launch makes, and removes at its end; consoles and
    controllers get the tokens that `given_tokens` tells of. SIGINT, SIGTERM and SIGHUP are events inside the block if
    the thread is the main one; or they raise KeyboardInterrupt there, for callers that do not wait for events. If
    this process is killed, its warden ends the services; those that robots need to come to rest end last.
    """

    def __init__(
        self,
        services: Sequence[Service],
        on_line: Callable[[str, str], None],
        bring_to_rest: Callable[[], None] | None = None,
        grace_s: float = GRACE_S,
        python: Sequence[str] = (sys.executable,),
        signals_raise: bool = False,
    ) -> None:
        """Prepare; nothing starts yet.

        Args:
            services: rows of the table, each after those that it needs.
            on_line: called from a thread with a service's name and each line of its output.
            bring_to_rest: called before services are stopped while robots may still move.
            grace_s: how long a service may take to end by itself.
            python: the interpreter that runs the services.
            signals_raise: signals are no events, but raise KeyboardInterrupt.
        """
        self.services = tuple(services)
        self.unrested = ""
        self.children: dict[str, Child] = {}
        self.ready: set[str] = set()
        self._on_line = on_line
        self._bring_to_rest = bring_to_rest
        self._grace_s = grace_s
        self._python = tuple(python)
        self._signals_raise = signals_raise
        # signal handlers may put into a SimpleQueue at any time, not into a Queue
        self._events: queue.SimpleQueue[LauncherEvent] = queue.SimpleQueue()
        self._handlers: dict[signal.Signals, Any] = {}
        self._warden: Warden | None = None
        self._lifelines: dict[str, Lifeline] = {}
        self._folders: dict[str, Path] = {}
        self.console_token: ConsoleToken | None = None

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                self._handlers[number] = signal.signal(number, self._interrupt)
        return self

    def __exit__(self, *_: object) -> None:
        self._signals_raise = False  # nothing keeps the robots from coming to rest
        try:
            self.stop()
        finally:
            if self._warden is not None:
                self._warden.close()
            for folder in self._folders.values():
                if not any(_is_listened_at(path) for path in folder.glob("*.sock")):  # by another launch
                    shutil.rmtree(folder, ignore_errors=True)
            if self.console_token is not None:
                self.console_token.close()
            for number, handler in self._handlers.items():
                signal.signal(number, handler)

    def start(self, idle_s: float = IDLE_S) -> None:
        """Start every service as soon as those it needs serve, and wait until all serve.

        A service that is busy starting is named and waited for. The cell needs no console: a late one becomes a
        `Ready` event, and its end is reported.

        Args:
            idle_s: how long a service may do nothing before it serves.

        Raises:
            LaunchError: if a port is taken, or a service ends or does nothing instead of serving.
            RuntimeFolderError: if other users may enter the folder of the guarded realm.
            LaunchInterruptedError: if a signal came first.
        """
        self._start(self.services, idle_s)

    def restart(self, name: str) -> None:
        """Start a service again that has ended; raises as `start` does."""
        self.stop_service(name)
        again = [service for service in self.services if service.name == name]
        self._wait_for_ports(again)
        self._start(again, IDLE_S)

    def wait(self, timeout_s: float | None = None) -> LauncherEvent | None:
        """The next event, or None if there is none within `timeout_s`."""
        event = self._next_event(math.inf if timeout_s is None else time.monotonic() + timeout_s)
        match event:
            case Ready(name):
                self.ready.add(name)
            case Exited(name):
                self.ready.discard(name)
        return event

    def _next_event(self, until_s: float) -> LauncherEvent | None:
        # a signal that comes right before this thread falls asleep is heeded when it wakes, so it wakes now and then
        while True:
            left_s = until_s - time.monotonic()
            with contextlib.suppress(queue.Empty):
                return self._events.get(timeout=min(max(left_s, 0.0), HEED_S))
            if left_s <= HEED_S:
                return None

    def stop_service(self, name: str) -> None:
        """End one service; its output can still be read."""
        child = self.children.get(name)
        if child is None:
            return
        self.ready.discard(name)
        if not child.stop(self._grace_s):
            self._on_line(name, f"did not end within {self._grace_s:g} s of SIGTERM and was killed")

    def stop(self) -> None:
        """Bring the robots to rest, then end every service, the last started first."""
        running = [name for name, child in self.children.items() if child.status is None]
        if self._bring_to_rest and any(self._role_moves(name) for name in running):
            try:
                self._bring_to_rest()
            except (DeltaqError, OSError, RuntimeError, MemoryError) as error:
                # the services' own watchdogs do it then
                self.unrested = str(error)
                self.say(f"the robots could not be asked to rest: {error}")
        for name in reversed(self.children):
            self.stop_service(name)

    def say(self, line: str) -> None:
        """Print a line of the launcher between the services' lines."""
        self._on_line("deltaq", line)

    def last_lines(self, name: str, count: int = SHOWN_LINES) -> list[str]:
        """The last lines of a service."""
        child = self.children.get(name)
        return list(child.lines)[-count:] if child else []

    def last_json(self, name: str) -> dict[str, Any] | None:
        """The last line of a service that is a JSON object, decoded; None if it printed none."""
        for line in reversed(self.last_lines(name, count=sys.maxsize)):
            try:
                data = json.loads(line)
            except ValueError:
                continue
            if (told := read_json_line(line)) is not None:
                data = told["fields"] if told["message"] == RESULT else None
            if isinstance(data, dict):
                return data
        return None

    def _role_moves(self, name: str) -> bool:
        return name == "hli" and name in self.ready

    def _interrupt(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002 - signal's signature
        if self._signals_raise:
            raise KeyboardInterrupt
        self._events.put(Interrupted(signal.Signals(number)))

    def _start(self, services: Sequence[Service], idle_s: float) -> None:
        check_ports(services)
        if self._warden is None:
            self._warden = Warden()
        here = {service.name for service in self.services}
        waiting = list(services)
        optional = {service.name for service in services if service.role in OPTIONAL_ROLES}
        pending: dict[str, _Starting] = {}
        look_s = time.monotonic() + min(TOLD_EVERY_S, idle_s)
        while waiting or pending:
            for service in [s for s in waiting if here.intersection(s.needs) <= self.ready]:
                waiting.remove(service)
                pending[service.name] = _Starting(self._begin(service))
            match self.wait(max(0.0, look_s - time.monotonic())):
                case Ready(name):
                    pending.pop(name, None)
                case Exited(name, status) if self._ended_early(name, services):
                    when = "before it served" if name in pending else "while others were starting"
                    text = f"{describe_exit(name, status)} {when}{self._quote(name)}"
                    if name not in optional:
                        raise LaunchError(text)
                    pending.pop(name, None)
                    del self.children[name]
                    self.say(f"{text}; the cell runs without it")
                case Interrupted(number):
                    raise LaunchInterruptedError(f"stopped by {number.name} while services were starting")
                case Exited():
                    pass  # the process that one of these replaces, or another service
                case None:
                    look_s = time.monotonic() + min(TOLD_EVERY_S, idle_s)
                    for name in sorted(pending):
                        self._look_at(name, pending[name], idle_s)
                    if not waiting and pending.keys() <= optional:
                        self.say(f"the cell runs without {', '.join(sorted(pending))} until it serves")
                        return

    def _begin(self, service: Service) -> Child:
        """Start a service's process.

        Raises:
            LaunchError: the system gives no process, thread or descriptor for it.
        """
        assert self._warden is not None  # it comes first
        # an emulated robot is braked by its Robot Server, and ends after it
        emulated = [s.name for s in self.services if s.role is Role.EMULATOR and service.name in s.needs]
        try:
            child = Child(
                service.name,
                [*self._python, *service.arguments],
                self._events.put,
                self._on_line,
                environment=self._environment_of(service),
                is_ordinary=service.role in ORDINARY_ROLES,
                lifeline=self._lifelines.pop(service.name, None),
                outlived_by=[self._lifelines.setdefault(name, Lifeline()) for name in emulated],
            )
        except (OSError, RuntimeError, MemoryError) as error:
            raise LaunchError(
                f"{service.name} could not be started: {error}; the limits of this user are too low (`ulimit -a`)"
            ) from error
        self._warden.keep(
            child.pid, child.output, child.lifeline.writer, brakes=service.role in BRAKING_ROLES
        )
        self.children[service.name] = child
        return child

    def _ended_early(self, name: str, services: Sequence[Service]) -> bool:
        """Whether one of these has ended, and not a process that it replaces."""
        return name in {service.name for service in services} and self.children[name].status is not None

    def _look_at(self, name: str, starting: _Starting, idle_s: float) -> None:
        """Say that a service is waited for while it works.

        Raises:
            LaunchError: it does nothing.
        """
        if not starting.works():
            idle_for_s = time.monotonic() - starting.worked_s
            if idle_for_s >= idle_s:
                raise LaunchError(
                    f"{name} did not serve, and did nothing for {idle_for_s:.2g} s{self._quote(name)}"
                )
        self.say(
            f"{name} does not serve yet, {time.monotonic() - starting.begun_s:.0f} s after its start; it has used "
            f"{starting.used_s:.1f} s of processor time, and is waited for"
        )

    def _wait_for_ports(self, services: Sequence[Service]) -> None:
        """Wait while a robot whose Robot Server has died is still braked, which keeps its port."""
        end = time.monotonic() + PORT_PATIENCE_S
        while time.monotonic() < end:
            try:
                check_ports(services)
            except LaunchError:
                time.sleep(_LOOK_S)
            else:
                return

    def _environment_of(self, service: Service) -> dict[str, str]:
        """A service's environment variables, in addition to the user's."""
        if service.role is Role.CONSOLE and console_needs_token():
            self.console_token = self.console_token or ConsoleToken(service.listens[0].port)
            return {f"{CONSOLE_TOKEN}_FILE": str(self.console_token.file)}
        if service.role in (Role.LEADER, Role.FOLLOWER):
            return controllers_token(os.environ)
        return {} if service.realm is None else {GUARDED_FOLDER: str(self._folder_of(service.realm))}

    def _folder_of(self, realm: str) -> Path:
        """The folder in which the services of a realm meet; a launch that joins another finds it there."""
        if realm not in self._folders:
            self._folders[realm] = guarded_folder(realm)
        return self._folders[realm]

    def _quote(self, name: str) -> str:
        lines = self.last_lines(name)
        if not lines:
            return f"; {name} printed nothing"
        return f"; {name} printed last:\n" + "\n".join(f"  {line}" for line in lines)


def describe_exit(name: str, status: int) -> str:
    """Say how a service ended."""
    if status < 0:
        return f"{name} was ended by {signal.Signals(-status).name}"
    return f"{name} ended with exit status {status}"


def check_ports(services: Iterable[Service]) -> None:
    """Check that no other program listens on the ports of these services.

    Raises:
        LaunchError: naming the service, the port, and where the cell's file sets it.
    """
    for service in services:
        for listener in service.listens:
            try:
                _bind(listener)
            except OSError as error:
                raise LaunchError(
                    f"{service.name} cannot listen on {listener.transport} {listener.address}:{listener.port}"
                    f" ({error.strerror}); is another cell up (`deltaq status`)? Otherwise change"
                    f" `{listener.field}` in the cell's file"
                ) from error


def _is_listened_at(path: Path) -> bool:
    with (
        socket.socket(socket.AF_UNIX) as probe,
        contextlib.suppress(OSError),
    ):  # a path can be too long for a socket
        return probe.connect_ex(str(path)) == 0
    return False


def _bind(listener: ListeningSocket) -> None:
    kind = socket.SOCK_STREAM if listener.transport == "tcp" else socket.SOCK_DGRAM
    family = socket.AF_INET6 if ":" in listener.address else socket.AF_INET
    with socket.socket(family, kind) as probe:
        if kind is socket.SOCK_STREAM:
            # connections of the last run that are still closing do not block the port, a listener does
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind((listener.address, listener.port))
