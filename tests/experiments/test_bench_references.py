"""The references of the benchmark: real processes on bare sockets, and what goes wrong."""

import os
import socket
import struct
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from deltaq_deploy.launch.launcher import Launcher
from deltaq_deploy.launch.program import LaunchError
from deltaq_deploy.launch.services import Role, Service
from deltaq_experiments.bench.hop_reference import hop_reference, processor_seconds, program
from deltaq_experiments.bench.live import _counted, _wait
from deltaq_experiments.live import LastLines
from deltaq_protocol.errors import DeltaqError


def test_a_failing_compiler_is_reported_with_its_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    broken = tmp_path / "cc"
    broken.write_text("#!/bin/sh\necho out of memory >&2\nexit 1\n", encoding="utf-8")
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    with pytest.raises(DeltaqError, match="out of memory"):
        program("hops", tmp_path)


def test_without_a_compiler_the_error_names_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(DeltaqError, match=r"no compiler 'no-such-compiler': install one, or name it in CC"):
        program("hops", tmp_path)


@pytest.mark.long
def test_a_message_passes_five_hops_in_their_order(tmp_path: Path) -> None:
    begin_ns = time.monotonic_ns()
    with hop_reference(0.004, 0.2, tmp_path) as reference:
        assert reference.processor_s() >= 0.0
        times = reference.times(begin_ns, begin_ns + 10**12)
    back = times.rows[times.rows[:, -1] > 0]
    assert len(times.rows) == 300  # with the second that it runs longer
    assert len(back) > 0
    assert (np.diff(back, axis=1) > 0).all()
    assert 0.0 <= times.in_time <= 1.0


def test_the_reference_counts_only_the_window(tmp_path: Path) -> None:
    with hop_reference(0.004, 0.1, tmp_path) as reference:
        assert len(reference.times(0, 1).rows) == 0


def test_a_killed_reference_is_an_error_and_leaves_no_process(tmp_path: Path) -> None:
    with hop_reference(0.004, 60.0, tmp_path) as reference:
        reference.process.kill()
        with pytest.raises(DeltaqError, match="ended with -9"):
            reference.times(0, 1)


def test_a_reference_that_cannot_write_its_file_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "hops.bin").mkdir()
    with (
        hop_reference(0.004, 0.0, tmp_path) as reference,
        pytest.raises(DeltaqError, match=r"hops\.bin"),
    ):
        reference.times(0, 1)


def test_the_asker_times_a_server_and_its_own_echo_and_notes_silent_peers(tmp_path: Path) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))
        server.settimeout(300.0)

        def answer_the_second_half() -> None:
            # an answer that comes too late for its telegram is taken for one to the next
            for number in range(50):
                telegram, sender = server.recvfrom(4096)
                assert telegram == b"telegram %d" % number
                if number >= 25:
                    server.sendto(b"reply", sender)

        answering = threading.Thread(target=answer_the_second_half)
        answering.start()
        telegrams, took = tmp_path / "telegrams", tmp_path / "took"
        sent = [b"telegram %d" % number for number in range(50)]
        telegrams.write_bytes(b"".join(struct.pack("=I", len(one)) + one for one in sent))
        port = server.getsockname()[1]
        command = [program("asker", tmp_path), "20000000", "127.0.0.1", f"{port}", str(telegrams), str(took)]
        subprocess.run(command, check=True, timeout=300)
        answering.join()
    server_ns, echo_ns = np.fromfile(took, dtype="=i8").reshape(-1, 2).T
    assert len(server_ns) == 50
    assert (server_ns[:25] == -1).all()
    assert (server_ns[25:] > 0).any()
    assert (echo_ns > 0).any()


def test_processor_time_of_this_process_is_its_own() -> None:
    before = time.process_time()
    found = processor_seconds(os.getpid())
    assert before <= found <= time.process_time()


@pytest.mark.long
def test_processor_time_of_children_counts_if_asked() -> None:
    busy = "import time\nwhile time.process_time() < 0.3: pass\nprint(flush=True)\ninput()"
    with subprocess.Popen(
        [sys.executable, "-c", busy], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as child:
        assert child.stdout is not None
        child.stdout.readline()
        own = processor_seconds(os.getpid())
        assert processor_seconds(os.getpid(), with_children=True) - own > 0.25
        assert processor_seconds(child.pid) > 0.25
        child.communicate(b"\n")


def test_processor_time_of_a_process_that_has_ended_is_an_error() -> None:
    with subprocess.Popen([sys.executable, "-c", ""]) as child:
        child.wait()
    with pytest.raises(ProcessLookupError, match=f"process {child.pid} has ended"):
        processor_seconds(child.pid)


def test_a_process_that_ended_before_its_measurement_is_named_with_its_output() -> None:
    ends = "print('ready: here', flush=True); print('no such cell'); raise SystemExit(3)"
    lines = LastLines()
    launcher = Launcher([Service(name="follower", role=Role.FOLLOWER, arguments=("-c", ends))], lines)
    with launcher:
        launcher.start()
        assert launcher.children["follower"].exited.wait(300)
        wait = partial(_wait, launcher, lines, time.monotonic(), lambda _: None)
        with pytest.raises(LaunchError, match=r"follower ended with exit status 3(.|\n)*no such cell"):
            _counted(launcher, wait, processor_seconds)
