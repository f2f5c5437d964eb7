import errno
import json
import os
import queue
import re
import select
import signal
import socket
import subprocess
import sys
import textwrap
import threading
from contextlib import suppress
from dataclasses import replace

import pytest

from deltaq_cell.check_description import LEAST_GIVEN_PORT
from deltaq_cell.load import load_cell
from deltaq_deploy.command.console import json_log
from deltaq_deploy.launch.child_process import NICENESS, Exited, Ready
from deltaq_deploy.launch.launcher import Interrupted, Launcher
from deltaq_deploy.launch.program import LaunchError, LaunchInterruptedError
from deltaq_deploy.launch.services import ListeningSocket, Role, Service, cell_services
from deltaq_protocol.errors import DeltaqError
from deltaq_protocol.log import json_line

SERVES = "import signal; print('ready: here', flush=True); signal.pause()"
STUBBORN = "import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN);" + SERVES
DIES = "import sys; print('no such cell'); sys.exit(3)"
SILENT = "import signal; signal.pause()"


def service(name: str, code: str, **fields: object) -> Service:
    return Service(name=name, role=Role.SIM, arguments=("-c", code), **fields)  # type: ignore[arg-type] # tests pass what they like


def nothing(name: str, line: str) -> None: ...


def is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_a_service_starts_only_after_those_it_needs_are_ready() -> None:
    order: list[tuple[str, str]] = []
    services = [service("sim", SERVES), service("hli", SERVES, needs=("sim", "not started here"))]
    with Launcher(services, lambda *line: order.append(line)) as launcher:
        launcher.start()
        assert launcher.ready == {"sim", "hli"}
        assert list(launcher.children) == ["sim", "hli"]
    assert [line for line in order if line[1] == "ready: here"] == [
        ("sim", "ready: here"),
        ("hli", "ready: here"),
    ]


def test_the_console_has_ordinary_priority_and_the_needed_services_a_higher_one() -> None:
    # started by the service as a driver is by the console, once it is seen to serve
    tells = (
        "import os, signal, subprocess, sys\nprint('ready: here', flush=True)\nsys.stdin.read()\n"
        "signal.sigwait([signal.SIGUSR1])\n"
        "print(subprocess.check_output([sys.executable, '-c', 'import os; print(os.nice(0))'], text=True), end='')\n"
        "sys.stdout.flush(); signal.pause()"
    )
    tells = "import signal; signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGUSR1])\n" + tells
    told: dict[str, queue.SimpleQueue[str]] = {"sim": queue.SimpleQueue(), "console": queue.SimpleQueue()}
    services = [service("sim", tells), replace(service("console", tells), role=Role.CONSOLE)]
    with Launcher(services, lambda name, line: told[name].put(line)) as launcher:
        launcher.start()
        for name, child in launcher.children.items():
            assert told[name].get(timeout=300) == "ready: here"
            os.kill(child.pid, signal.SIGUSR1)
        found = {name: int(lines.get(timeout=300)) for name, lines in told.items()}
    own = os.nice(0)
    may_run_ahead = os.geteuid() == 0
    assert found == {"sim": NICENESS if may_run_ahead else own, "console": own}


def test_leaving_the_block_ends_services_in_reverse_order() -> None:
    launcher = Launcher([service("sim", SERVES), service("hli", SERVES, needs=("sim",))], nothing)
    with launcher:
        launcher.start()
        pids = [child.pid for child in launcher.children.values()]
    assert not any(is_running(pid) for pid in pids)
    ended = []
    while (event := launcher.wait(0)) is not None:
        ended.append(event)
    assert ended == [Exited("hli", -signal.SIGTERM), Exited("sim", -signal.SIGTERM)]


def test_a_service_that_dies_early_is_reported_with_its_last_lines() -> None:
    with (
        Launcher([service("sim", SERVES), service("hli", DIES)], nothing) as launcher,
        pytest.raises(
            LaunchError,
            match=r"hli ended with exit status 3 before it served; hli printed last:\n  no such cell",
        ),
    ):
        launcher.start()
    assert all(child.status is not None for child in launcher.children.values())


def test_a_service_that_never_serves_is_reported_and_ended() -> None:
    with (
        Launcher([service("sim", SILENT)], nothing) as launcher,
        pytest.raises(
            LaunchError, match=r"sim did not serve, and did nothing for [\d.]+ s; sim printed nothing"
        ),
    ):
        launcher.start(idle_s=0.3)
    assert launcher.children["sim"].status == -signal.SIGTERM


def test_a_busy_service_gets_a_longer_deadline_than_an_idle_one() -> None:
    works = "import time\nwhile time.process_time() < 3.0: pass\n" + SERVES
    said: list[str] = []
    with Launcher([service("sim", works)], lambda _, line: said.append(line)) as launcher:
        launcher.start(idle_s=2.0)
        assert launcher.ready == {"sim"}
    assert [
        line
        for line in said
        if re.match(r"sim does not serve yet, .* s of processor time, and is waited for", line)
    ]


def test_a_cell_runs_before_its_console_is_ready() -> None:
    late = "signal.sigwait([signal.SIGUSR1])\n" + SERVES
    late = "import signal; signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGUSR1])\n" + late
    said: list[str] = []
    console = replace(service("console", late), role=Role.CONSOLE)
    with Launcher([service("sim", SERVES), console], lambda _, line: said.append(line)) as launcher:
        launcher.start(idle_s=0.5)
        assert launcher.ready == {"sim"}
        assert "the cell runs without console until it serves" in said
        os.kill(launcher.children["console"].pid, signal.SIGUSR1)
        event = launcher.wait(300)
        assert isinstance(event, Ready)
        assert launcher.ready == {"sim", "console"}


def test_a_console_that_ends_is_reported_and_the_cell_starts_without_it() -> None:
    said: list[str] = []
    console = replace(service("console", DIES), role=Role.CONSOLE)
    with Launcher([console, service("sim", SERVES)], lambda _, line: said.append(line)) as launcher:
        launcher.start()
        assert launcher.ready == {"sim"}
    assert [line for line in said if line.startswith("console ended with exit status 3")]


def test_a_service_that_cannot_start_gives_one_line_and_ends_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def no_more(*_: object, **__: object) -> None:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    with Launcher([service("sim", SERVES), service("hli", SERVES, needs=("sim",))], nothing) as launcher:
        launcher.services, rest = launcher.services[:1], launcher.services[1:]
        launcher.start()
        monkeypatch.setattr("deltaq_deploy.launch.launcher.Child", no_more)
        with pytest.raises(LaunchError, match=r"hli could not be started: .*Too many open files"):
            launcher._start(rest, 1.0)
    assert launcher.children["sim"].status == -signal.SIGTERM


def test_a_service_that_ignores_sigterm_is_killed_after_the_grace() -> None:
    said: list[tuple[str, str]] = []
    with Launcher([service("sim", STUBBORN)], lambda *line: said.append(line), grace_s=0.2) as launcher:
        launcher.start()
    assert launcher.children["sim"].status == -signal.SIGKILL
    assert said[-1] == ("sim", "did not end within 0.2 s of SIGTERM and was killed")


def test_the_children_of_a_service_end_with_it() -> None:
    code = "import subprocess, sys; p = subprocess.Popen(['sleep', '60']); print(p.pid, flush=True);" + SERVES
    with Launcher([service("sim", code)], nothing) as launcher:
        launcher.start()
        grandchild = int(launcher.last_lines("sim")[0])
        assert is_running(grandchild)
    with suppress(ProcessLookupError):  # it may have ended, and init have reaped it
        descriptor = os.pidfd_open(grandchild)
        try:
            assert select.select([descriptor], [], [], 30.0)[0]
        finally:
            os.close(descriptor)


def test_a_service_that_dies_later_is_an_event_and_can_be_started_again() -> None:
    with Launcher([service("sim", SERVES)], nothing) as launcher:
        launcher.start()
        assert launcher.wait(0) is None
        os.kill(launcher.children["sim"].pid, signal.SIGKILL)
        assert launcher.wait(300) == Exited("sim", -signal.SIGKILL)
        assert launcher.ready == set()
        launcher.restart("sim")
        assert launcher.ready == {"sim"}


@pytest.mark.parametrize(
    ("transport", "kind"), [("tcp", socket.SOCK_STREAM), ("udp", socket.SOCK_DGRAM)], ids=["tcp", "udp"]
)
def test_a_taken_port_is_named_before_anything_starts(transport: str, kind: int) -> None:
    with socket.socket(socket.AF_INET, kind) as taken:
        taken.bind(("127.0.0.1", 0))
        if kind == socket.SOCK_STREAM:
            taken.listen()
        port = taken.getsockname()[1]
        listener = ListeningSocket(transport, "127.0.0.1", port, "tcp_port")  # type: ignore[arg-type] # a parameter
        with (
            Launcher([service("hli", SERVES, listens=(listener,))], nothing) as launcher,
            pytest.raises(
                LaunchError, match=rf"hli cannot listen on {transport} 127.0.0.1:{port} .*`tcp_port`"
            ),
        ):
            launcher.start()
        assert launcher.children == {}


def test_the_robots_are_brought_to_rest_before_the_hli_is_ended() -> None:
    alive: list[bool] = []
    hli = service("hli", SERVES)
    launcher = Launcher([hli], nothing, lambda: alive.append(launcher.children["hli"].status is None))
    with launcher:
        launcher.start()
    assert alive == [True]


def test_services_are_ended_even_if_the_robots_cannot_be_asked_to_rest() -> None:
    def unreachable() -> None:
        raise DeltaqError("no answer")

    said: list[str] = []
    with Launcher([service("hli", SERVES)], lambda _, line: said.append(line), unreachable) as launcher:
        launcher.start()
    assert launcher.children["hli"].status == -signal.SIGTERM
    assert "the robots could not be asked to rest: no answer" in said


def test_robots_are_not_asked_to_rest_if_the_hli_never_served() -> None:
    asked: list[bool] = []
    launcher = Launcher([service("hli", DIES)], nothing, lambda: asked.append(True))
    with launcher, pytest.raises(LaunchError):
        launcher.start()
    assert asked == []


def test_a_signal_is_an_event_while_services_run() -> None:
    with Launcher([service("sim", SERVES)], nothing) as launcher:
        launcher.start()
        os.kill(os.getpid(), signal.SIGINT)
        assert launcher.wait(300) == Interrupted(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_interrupts_a_program_outside_of_events_and_ends_the_services(
    number: signal.Signals,
) -> None:
    launcher = Launcher([service("sim", SERVES)], nothing, signals_raise=True)
    before = signal.getsignal(number)

    def interrupted() -> None:
        with launcher:
            launcher.start()
            os.kill(os.getpid(), number)
            threading.Event().wait(300)

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert launcher.children["sim"].status == -signal.SIGTERM
    assert signal.getsignal(number) is before


def test_signals_do_not_interrupt_the_shutdown() -> None:
    def interrupted_again() -> None:
        os.kill(os.getpid(), signal.SIGINT)
        asked.append(True)

    asked: list[bool] = []
    launcher = Launcher([service("hli", SERVES)], nothing, interrupted_again, signals_raise=True)
    with launcher:
        launcher.start()
    assert asked == [True]
    assert launcher.children["hli"].status == -signal.SIGTERM


def test_a_signal_ends_a_start() -> None:
    with Launcher([service("sim", SILENT)], nothing) as launcher:
        os.kill(os.getpid(), signal.SIGTERM)
        with pytest.raises(LaunchInterruptedError, match="SIGTERM"):
            launcher.start()
    assert launcher.children["sim"].status is not None


def test_the_last_json_line_of_a_service_is_found_among_others() -> None:
    code = "print('[1]'); print('{\"a\": 1}'); print('{broken'); " + SERVES
    with Launcher([service("sim", code)], nothing) as launcher:
        launcher.start()
        assert launcher.last_json("sim") == {"a": 1}
        assert launcher.last_json("nobody") is None


@pytest.mark.long
@pytest.mark.parametrize("with_warden", [True, False])
def test_no_service_outlives_a_launcher_that_is_killed_alone_or_with_its_warden(with_warden: bool) -> None:
    program = textwrap.dedent(f"""
        from deltaq_deploy.launch.launcher import Launcher
        from deltaq_deploy.launch.services import Role, Service
        with Launcher([Service("sim", Role.SIM, ("-c", {SERVES!r}))], lambda *line: None) as launcher:
            launcher.start()
            print(launcher.children["sim"].pid, launcher._warden._process.pid, flush=True)
            launcher.wait()
    """)
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        pid, warden = map(int, process.stdout.readline().split())
        watched = os.pidfd_open(pid)
        if with_warden:
            os.kill(warden, signal.SIGKILL)
            assert not select.select([watched], [], [], 0.2)[0], "a warden that is killed alone ends nothing"
        process.kill()
    try:
        with os.fdopen(watched) as ended:
            assert select.select([ended], [], [], 60)[0], "the service is still running"
    finally:
        if is_running(pid):
            os.kill(pid, signal.SIGKILL)


def test_only_a_line_that_begins_with_ready_counts_as_ready() -> None:
    code = "print('not ready: yet', flush=True);" + SERVES
    with Launcher([service("sim", code)], nothing) as launcher:
        launcher.start()
        assert launcher.last_lines("sim") == ["not ready: yet", "ready: here"]


LOGS_JSON = (
    "from deltaq_protocol import log; import logging; log.configure('sim'); log.say_result({'cycles': 3});"
    "logging.getLogger('deltaq_services').info('ready: here'); import signal; signal.pause()"
)


@pytest.mark.long
def test_services_that_log_as_json_are_understood(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DELTAQ_LOG_FORMAT", "json")
    with Launcher([service("sim", LOGS_JSON)], nothing) as launcher:
        launcher.start()
        assert launcher.last_json("sim") == {"cycles": 3}


def test_every_line_of_a_launch_that_logs_as_json_is_an_object(capsys: pytest.CaptureFixture[str]) -> None:
    server = replace(service("robot-server-fr", ""), role=Role.ROBOT_SERVER, robot="fr")
    said = json_line("robot-server", "ready: here", robot="fr")
    log = json_log([server])
    for line in (
        (server.name, said),
        (server.name, 'a library \x1b[31m"says" so'),
        ("deltaq", "cell lab is up"),
    ):
        log(*line)
    told = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert told[0] == json.loads(said)
    named = [(one["service"], one["robot"], one["message"]) for one in told[1:]]
    assert named == [
        ("robot-server", "fr", 'a library \x1b[31m"says" so'),
        ("deltaq", None, "cell lab is up"),
    ]


def test_the_launcher_handles_a_signal_that_does_not_wake_it() -> None:
    # as one that comes right before it falls asleep: the handler is due, and nothing interrupts the wait
    with Launcher((), lambda *_: None) as launcher:
        elsewhere = threading.Timer(0.2, lambda: signal.pthread_kill(threading.get_ident(), signal.SIGTERM))
        elsewhere.start()
        assert launcher.wait() == Interrupted(signal.SIGTERM)  # for ever, if it is lost
        elsewhere.join()


def test_only_the_rsi_ports_of_the_lab_lie_in_the_ephemeral_range() -> None:
    listeners = [each for service in cell_services(load_cell("lab"), "lab") for each in service.listens]
    given = [each.field for each in listeners if each.port >= LEAST_GIVEN_PORT]
    assert given == ["robots.fr.driver.port", "robots.gr.driver.port"]  # as in KUKA's examples


def test_an_hli_with_datagrams_needs_its_port_over_tcp_and_udp() -> None:
    cell = load_cell("lab").model_copy(update={"hli": "tcp+udp/127.0.0.1:7447"})
    hli = next(service for service in cell_services(cell, "lab") if service.name == "hli")
    zenoh = [(at.transport, at.port) for at in hli.listens if at.field == "hli"]
    assert zenoh == [("tcp", 7447), ("udp", 7447)]
