"""A running cell recorded by a process of its own, and the recording run through the gate."""

import json
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from commands import PROGRAM
from live_stack import Stack
from shared_cell import SharedStack

from deltaq_deploy.launch.cell_connection import connect
from deltaq_deploy.launch.services import recorder
from deltaq_protocol import topics
from deltaq_protocol.audit import AuditEntry, AuditKind, AuditOutcome
from deltaq_services.recorder.reader import Recording
from deltaq_services.recorder.shell import Recorder
from deltaq_testing.replay import replay

pytestmark = pytest.mark.live


def test_a_moving_cell_is_recorded_completely_and_survives_a_recorder_with_a_full_disk(
    moving_stack: SharedStack, tmp_path: Path
) -> None:
    stack, cell = moving_stack, str(moving_stack.file)
    file, filling = tmp_path / "run.mcap", tmp_path / "filling.mcap"
    commands = (
        [PROGRAM, "recording", "record", "--output", str(file), "--cell", cell, "--json"],
        [sys.executable, *recorder(cell, str(filling)).arguments],
    )
    recorders = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for command in commands
    ]
    try:
        wait_until_longer(stack, filling, 300_000)
        # as if the disk had room for so much more, which ends in the middle of a chunk
        full = filling.stat().st_size + 10_000
        resource.prlimit(recorders[1].pid, resource.RLIMIT_FSIZE, (full, full))
        _, said = recorders[1].communicate(timeout=300)
        stack.wait_until_moving()  # nobody misses the recorder
        with connect(stack.cell, "test") as running:
            fingerprint = running.status().gate_fingerprint
            running.stop()
        stack.wait_until_at_rest()
        # a busy machine may leave the recorder behind the cell, and it is ended once it has seen the stop
        wait_until_longer(stack, file, file.stat().st_size + 1)
        recorders[0].send_signal(signal.SIGINT)
        output, _ = recorders[0].communicate(timeout=300)
    finally:
        for process in recorders:
            process.kill()
            process.communicate()
    summary = json.loads(output)
    assert recorders[0].returncode == 0
    assert (summary["lost"], summary["invalid"]) == (0, 0)

    replayed = replay(file)
    assert replayed.good, replayed.differences
    assert replayed.notices == []
    assert replayed.gaps == []
    assert replayed.skipped < topics.GATE_MEMORY.rate.messages  # the second to join waits for the next memory
    assert replayed.verdicts > 50
    assert replayed.fingerprint == replayed.recorded_fingerprint == fingerprint
    seen = {item.topic.name for item in Recording.open(file).messages()}
    assert {"state", "verdict", "proximity", "server-state", "request", "admission", "gate-verdict"} <= seen
    assert {"supervision", "command", "command-reply", "gate-memory"} <= seen
    audit = [item.message for item in Recording.open(file).messages((topics.AUDIT,))]
    stops = [entry for entry in audit if isinstance(entry, AuditEntry) and entry.what is AuditKind.STOP]
    assert [(entry.outcome, entry.client, entry.address) for entry in stops] == [
        (AuditOutcome.ASKED, "test", "zenoh"),
        (AuditOutcome.DONE, "test", "zenoh"),
    ]

    assert recorders[1].returncode == 2
    assert said == (
        f"error: {filling} can no longer be written: File too large; messages written so far can be read\n"
    )
    assert filling.stat().st_size <= full
    cut = replay(filling)
    assert cut.good, cut.differences
    assert cut.messages > 50
    assert len(cut.notices) == 1
    assert "cut off" in cut.notices[0]


def test_received_messages_are_written_before_the_recorder_ends(
    ready_stack: SharedStack, tmp_path: Path
) -> None:
    file, stack = tmp_path / "run.mcap", ready_stack
    with Recorder(stack.cell, file) as recorder:
        while recorder._came.qsize() < 10:
            stack.wait_cycles(4)
        recorder.run(duration_s=0.0)
    assert list(Recording.open(file).messages())


def wait_until_longer(stack: Stack, file: Path, size: int) -> None:
    deadline = time.monotonic() + 300
    while not file.exists() or file.stat().st_size < size:
        assert time.monotonic() < deadline, file
        stack.wait_cycles(4)
