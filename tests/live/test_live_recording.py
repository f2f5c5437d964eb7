"""A running cell recorded by a process of its own, and the recording run through the gate."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from live_stack import live_stack

from deltaq_deploy.running import connect
from deltaq_deploy.services import recorder
from deltaq_experiments.replay import replay
from deltaq_services.recorder.reader import Recording
from deltaq_services.sim.gate_log import MEMORY_PERIOD

pytestmark = pytest.mark.live

DELTAQ = str(Path(sys.executable).with_name("deltaq"))


def test_a_moving_cell_is_recorded_and_replays_to_the_last_bit_and_outlives_its_recorder(
    tmp_path: Path,
) -> None:
    with live_stack(tmp_path, moving=True) as stack:
        cell = str(tmp_path / "private.yaml")
        file, killed = tmp_path / "run.mcap", tmp_path / "killed.mcap"
        commands = (
            [DELTAQ, "record", str(file), "--cell", cell, "--json"],
            [sys.executable, *recorder(cell, str(killed)).arguments],
        )
        recorders = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for command in commands]
        try:
            wait_until_longer(killed, 300_000)
            recorders[1].kill()
            stack.wait_until_moving()  # nobody misses the recorder
            with connect(stack.cell, "test") as running:
                fingerprint = running.status().gate_fingerprint
                running.stop()
            stack.wait_until_at_rest()
            recorders[0].send_signal(signal.SIGINT)
            output, _ = recorders[0].communicate(timeout=30)
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
    assert replayed.skipped < MEMORY_PERIOD  # the second to join waits for the next memory
    assert replayed.verdicts > 50
    assert replayed.fingerprint == replayed.recorded_fingerprint == fingerprint
    seen = {item.topic.name for item in Recording.open(file).messages()}
    assert {"state", "verdict", "proximity", "server-state", "request", "admission", "gate-verdict"} <= seen
    assert {"supervision", "command", "command-reply", "gate-memory"} <= seen

    cut = replay(killed)
    assert cut.good, cut.differences
    assert cut.messages > 50
    assert len(cut.notices) == 1
    assert "cut off" in cut.notices[0]


def wait_until_longer(file: Path, size: int) -> None:
    deadline = time.monotonic() + 40
    while not file.exists() or file.stat().st_size < size:
        assert time.monotonic() < deadline, file
        time.sleep(0.05)
