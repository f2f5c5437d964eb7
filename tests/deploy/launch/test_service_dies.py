"""A cell that `deltaq up` runs loses a service, which is started again; beside no other cell."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from test_running_cell import SERVICES, finish, start, wait_for_phases

from deltaq_deploy.launch.private_cell import write_private_cell

pytestmark = pytest.mark.live


def test_a_service_that_dies_is_named_and_can_be_started_again_and_nothing_is_left_in_the_end(
    tmp_path: Path,
) -> None:
    cell = start(write_private_cell(tmp_path))
    again = None
    try:
        cell.read_until("cell lab is up")
        wait_for_phases(cell, {"fr": "ready", "gr": "ready"})
        children = cell.children()
        assert len(children) == len(SERVICES)
        (sim,) = [
            pid for pid in children if b"deltaq_services.sim" in Path(f"/proc/{pid}/cmdline").read_bytes()
        ]
        os.kill(sim, signal.SIGKILL)
        assert "sim was ended by SIGKILL; the others go on" in cell.read_until("SIGKILL")
        again = start(cell.file, "--only", "sim")
        again.read_until("cell lab is up: sim")
        assert cell.deltaq("health", "sim").returncode == 0
    finally:
        if again is not None:
            assert finish(again) == 0
        assert finish(cell) == 1  # a service died: that is told in the exit status too
    assert not any(Path(f"/proc/{pid}").exists() for pid in children)
