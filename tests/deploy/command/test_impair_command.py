"""`deltaq fault impair`: options that belong together, and a wire that is cut for a while."""

import os
import re
import select
import socket
import subprocess
from pathlib import Path

import pytest
from commands import PROGRAM
from ran import ran
from small_cell import endpoint

SOMEWHERE = "tcp/127.0.0.1:9"


def command(*options: str) -> list[str]:
    return [PROGRAM, "fault", "impair", *options]


@pytest.mark.by_day(1)
@pytest.mark.long
@pytest.mark.parametrize(
    ("options", "status", "told"),
    [
        (("--loss-share", "0.2"), 2, "loss does not apply to bytes, only to lines, messages, datagrams"),
        (("--unit", "packets"), 2, "no unit 'packets'; there are bytes, lines, messages, datagrams"),
        (("--loss-share", "1.2"), 2, "--loss-share"),
        (
            ("--jitter-s", "0.1", "--keep-order"),
            2,
            "kept order does not apply to bytes, only to lines, messages",
        ),
        (("--unit", "lines", "--keep-order"), 2, "without --jitter-s messages keep their order"),
        (("--listen", "tcp/192.0.2.1:9"), 3, "cannot listen on tcp/192.0.2.1:9"),
    ],
)
def test_impossible_options_are_reported_with_the_possible_ones(
    options: tuple[str, ...], status: int, told: str
) -> None:
    words = command("--listen", SOMEWHERE, "--to", SOMEWHERE, *options)
    done = ran(words, check=False)
    assert done.returncode == status, done.stderr
    assert told in re.sub(r"[\s│]+", " ", done.stderr)
    assert "Traceback" not in done.stderr


@pytest.mark.service
def test_a_cut_lasts_as_long_as_requested_and_the_link_works_before_and_after() -> None:
    listen, to = endpoint(), endpoint()
    port = int(listen.rpartition(":")[2])
    with socket.create_server(("127.0.0.1", int(to.rpartition(":")[2]))) as server:
        server.settimeout(300)
        words = command("--listen", listen, "--to", to, "--cut", "--after-s", "2", "--for-s", "0.5")
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as relay:
            assert relay.stdout is not None
            try:
                assert relay.stdout.readline().startswith(f"carries bytes from {listen} to {to}")
                with socket.create_connection(("127.0.0.1", port), timeout=300) as client:
                    there, _ = server.accept()
                    client.sendall(b"before")
                    assert there.recv(100) == b"before"
                    assert relay.stdout.readline() == 'impaired: {"cut":true}\n'
                    there.settimeout(300)
                    assert is_broken(there)
                    there.close()
                assert relay.stdout.readline() == "unimpaired again\n"
                with socket.create_connection(("127.0.0.1", port), timeout=300) as client:
                    there, _ = server.accept()
                    client.sendall(b"after")
                    assert there.recv(100) == b"after"
                    there.close()
            finally:
                relay.terminate()
        assert relay.returncode == 0


@pytest.mark.service
def test_unevenly_delayed_lines_keep_their_order_if_requested() -> None:
    listen, to = endpoint(), endpoint()
    port = int(listen.rpartition(":")[2])
    sent = b"".join(b"%d\n" % number for number in range(200))
    with socket.create_server(("127.0.0.1", int(to.rpartition(":")[2]))) as server:
        server.settimeout(300)
        words = command(
            "--listen", listen, "--to", to, "--unit", "lines", "--jitter-s", "0.2", "--keep-order"
        )
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as relay:
            assert relay.stdout is not None
            try:
                assert relay.stdout.readline().startswith(f"carries lines from {listen} to {to}")
                assert relay.stdout.readline() == 'impaired: {"jitter_s":0.2,"keeps_order":true}\n'
                with socket.create_connection(("127.0.0.1", port), timeout=300) as client:
                    there, _ = server.accept()
                    with there, there.makefile("rb") as lines:
                        there.settimeout(300)
                        client.sendall(sent)
                        assert lines.read(len(sent)) == sent
            finally:
                relay.terminate()


@pytest.mark.service
def test_a_relay_ends_with_the_killed_script_that_started_it() -> None:
    words = command("--listen", endpoint(), "--to", endpoint())
    script = ["bash", "-c", '"$@" & wait', "bash", *words]
    with subprocess.Popen(script, stdout=subprocess.PIPE, text=True) as running:
        assert running.stdout is not None
        assert running.stdout.readline().startswith("carries bytes")
        with os.fdopen(os.pidfd_open(child_of(running.pid))) as relay:
            running.kill()
            assert select.select([relay], [], [], 60)[0], "the relay is still running"


def child_of(pid: int) -> int:
    (child,) = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    return int(child)


def is_broken(connection: socket.socket) -> bool:
    try:
        return connection.recv(100) == b""
    except ConnectionResetError:
        return True
