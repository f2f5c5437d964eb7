"""A guarded realm off the loopback: who has the key moves the robot, who has not is counted and ignored."""

import pytest
from identities import make
from live_stack import live_stack

from deltaq_cell.load import load_cell
from deltaq_deploy.launch.cell_connection import connect
from deltaq_deploy.launch.probes import probe
from deltaq_deploy.launch.services import cell_services
from deltaq_protocol import topics
from deltaq_protocol.certified.names import IDENTITY
from deltaq_protocol.codec import pack
from deltaq_protocol.guarded import Command, Supervision
from deltaq_protocol.messages import Phase
from deltaq_protocol.seal import Seal
from deltaq_protocol.seal_keys import KEY_BYTES, RealmKey
from deltaq_protocol.session import open_session
from deltaq_services.guarded_key import KEY_FILE, write_new_key
from deltaq_services.phases import MAY_MOVE
from deltaq_services.recorder.shell import Recorder

pytestmark = pytest.mark.live


def test_only_those_who_have_the_key_are_listened_to(tmp_path, monkeypatch):
    keys = [tmp_path / "key", tmp_path / "another"]
    for key in keys:
        write_new_key(key)
    monkeypatch.setenv(KEY_FILE, str(keys[0]))
    with live_stack(tmp_path, moving=True, guarded="0.0.0.0") as stack:
        for service in cell_services(stack.cell, "lab"):
            assert probe(service, stack.cell).healthy

        stranger = open_session(connect=[stack.cell.sim, stack.cell.robots["fr"].server], must_connect=True)
        try:
            with connect(stack.cell, "test") as running:
                while not forged_and_counted(running.status()):
                    publish_forged_stops(stranger)
                    stack.wait_cycles(4)
                status = running.status()
        finally:
            stranger.close()
        assert status.gate.get("command_stop", 0) == 0
        assert status.robots["fr"].phase in MAY_MOVE
        stack.wait_until_moving()

        monkeypatch.setenv(KEY_FILE, str(keys[1]))
        stack.launcher.restart("hli")
        stack.wait_until_at_rest()  # the gate hears no HLI any more
        with connect(stack.cell, "test") as running:
            while not running.status().hli.get("forged_guarded"):
                stack.wait_cycles(4)
            assert running.status().robots["fr"].phase is Phase.OFFLINE


def forged_and_counted(status):
    fr = status.robots["fr"].counters
    return status.gate.get("forged_messages") and fr.get("forged_supervision")


def publish_forged_stops(stranger):
    """Without a seal, and with one of a key that somebody guessed."""
    command = topics.COMMAND.key("lab")
    supervision = topics.SUPERVISION.key("lab", robot="fr")
    stop = pack(Command(id=2**60, kind="stop"))
    order = pack(Supervision(robot="fr", epoch=1, cycle=1, stop="operator_stop"))
    guessed = Seal(RealmKey(bytes(KEY_BYTES)))
    for close in (lambda _, message: message, guessed.close):
        stranger.put(command, close(command, stop))
        stranger.put(supervision, close(supervision, order))


@pytest.mark.parametrize("transport", [pytest.param("tcp", marks=pytest.mark.nightly), "tls"])
def test_services_under_identities_move_a_robot_and_one_of_another_authority_is_not_heard(
    tmp_path, monkeypatch, transport
):
    cell = load_cell("lab")
    folder, other = (make(tmp_path / name, cell.cell) for name in ("identities", "others"))
    monkeypatch.delenv(KEY_FILE)
    monkeypatch.setenv(IDENTITY, str(folder))
    with live_stack(tmp_path, moving=True, guarded="0.0.0.0", transport=transport) as stack:
        for service in cell_services(stack.cell, "lab"):
            assert probe(service, stack.cell).healthy
        with connect(stack.cell, "test") as running:
            status = running.status()
        assert status.gate.get("forged_messages", 0) == 0
        assert status.hli.get("forged_guarded", 0) == 0
        with Recorder(stack.cell, tmp_path / "run.mcap") as recorder:
            while not recorder.writer.gate_messages:
                recorder.run(0.1)

        monkeypatch.setenv(IDENTITY, str(other))
        stack.launcher.restart("hli")
        stack.wait_until_at_rest()  # the gate hears no HLI any more
        with connect(stack.cell, "test") as running:
            # over TLS it is not let in, and there is nothing to be counted
            while transport == "tcp" and not running.status().hli.get("forged_guarded"):
                stack.wait_cycles(4)
            assert running.status().robots["fr"].phase is Phase.OFFLINE
