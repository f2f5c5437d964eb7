"""A cell whose guarded realm is off the loopback: its services move a robot, one of another authority is not heard."""

import pytest
from identities import make
from live_stack import live_stack

from deltaq_cell.load import load_cell
from deltaq_deploy.launch.cell_connection import connect
from deltaq_deploy.launch.probes import probe
from deltaq_deploy.launch.services import cell_services
from deltaq_protocol.certified.names import IDENTITY
from deltaq_protocol.messages import Phase
from deltaq_services.recorder.shell import Recorder

# tests/security/test_encrypted_realm.py holds it by day, service by service
pytestmark = [pytest.mark.live, pytest.mark.nightly]


def test_services_with_identities_move_a_robot_and_one_of_another_authority_is_ignored(tmp_path, monkeypatch):
    cell = load_cell("lab")
    folder, other = (make(tmp_path / name, cell.cell) for name in ("identities", "others"))
    monkeypatch.setenv(IDENTITY, str(folder))
    with live_stack(tmp_path, moving=True, encrypted_at="0.0.0.0") as stack:
        for service in cell_services(stack.cell, "lab"):
            assert probe(service, stack.cell).healthy
        with Recorder(stack.cell, tmp_path / "run.mcap") as recorder:
            while not recorder.writer.gate_messages:
                recorder.run(0.1)

        monkeypatch.setenv(IDENTITY, str(other))
        stack.launcher.restart("hli")
        stack.wait_until_at_rest()  # the gate hears no HLI any more
        with connect(stack.cell, "test") as running:
            assert running.status().robots["fr"].phase is Phase.OFFLINE
