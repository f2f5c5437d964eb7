"""The key of the guarded realm: when it is needed, and what is no key."""

import asyncio
from collections import Counter
from types import SimpleNamespace

import pytest
from small_cell import small_cell

from deltaq_cell.cell_model import CellModel
from deltaq_protocol.seal import UNSEALED, KeyedSeal
from deltaq_services.guarded_key import KEY_FILE, GuardedKeyError, guarded_seal, off_loopback, write_new_key
from deltaq_services.hli.guarded_front import GuardedFront
from deltaq_services.robot_server.guarded_link import GuardedLink
from deltaq_services.sim.shell import Shell as GateShell

OUTSIDE = {"sim": "tcp/192.168.7.1:7450"}


def test_a_cell_on_the_loopback_needs_no_key_and_looks_at_none(monkeypatch):
    monkeypatch.setenv(KEY_FILE, "/nowhere")
    assert guarded_seal(small_cell()) is UNSEALED


def test_where_clients_connect_is_not_the_guarded_realm():
    assert off_loopback(small_cell(hli="tcp/0.0.0.0:7447", tcp_address="0.0.0.0")) is None


def test_off_the_loopback_a_missing_key_is_told_with_the_field_and_what_to_do(monkeypatch):
    monkeypatch.delenv(KEY_FILE, raising=False)
    with pytest.raises(
        GuardedKeyError,
        match=r"^sim \(tcp/192\.168\.7\.1:7450\) of cell small .*DELTAQ_GUARDED_KEY_FILE.*`deltaq key",
    ):
        guarded_seal(small_cell(**OUTSIDE))


def test_a_robot_server_off_the_loopback_needs_the_key_too():
    cell = small_cell()
    fr = cell.robots["fr"].model_copy(update={"server": "tcp/robots.example:7451"})
    cell = cell.model_copy(update={"robots": cell.robots | {"fr": fr}})
    assert off_loopback(cell) == "robots.fr.server (tcp/robots.example:7451)"


async def test_no_service_starts_without_the_key_that_it_needs(tmp_path, monkeypatch):
    monkeypatch.delenv(KEY_FILE, raising=False)
    file = tmp_path / "plant.yaml"
    file.write_text("extends: lab\nsim: tcp/192.168.7.1:7450\n", encoding="utf-8")
    model = CellModel.load(file)
    cell, port = model.description, SimpleNamespace(loop=asyncio.get_running_loop())
    for start in (
        lambda: GuardedLink(cell, "fr", Counter()),
        lambda: GateShell(model),
        lambda: GuardedFront(cell, port),
    ):
        with pytest.raises(GuardedKeyError, match="names no key"):
            start()


@pytest.mark.parametrize("text", ["", "secret", "ab" * 31, "ab" * 33, "é" * 64, "0x" + "ab" * 31])
def test_what_is_no_key_is_refused_and_never_shown(tmp_path, monkeypatch, text):
    file = tmp_path / "key"
    file.write_text(text, encoding="utf-8")
    monkeypatch.setenv(KEY_FILE, str(file))
    with pytest.raises(GuardedKeyError, match="holds no key, which is 64 hexadecimal digits") as refused:
        guarded_seal(small_cell(**OUTSIDE))
    assert not text or text not in str(refused.value)


def test_a_file_that_is_not_there_is_told(tmp_path, monkeypatch):
    monkeypatch.setenv(KEY_FILE, str(tmp_path / "none"))
    with pytest.raises(GuardedKeyError, match="none cannot be read: No such file"):
        guarded_seal(small_cell(**OUTSIDE))


def test_a_new_key_is_its_owners_alone_differs_from_every_other_and_is_never_written_over(
    tmp_path, monkeypatch
):
    files = [tmp_path / "one", tmp_path / "other"]
    for file in files:
        write_new_key(file)
        assert file.stat().st_mode & 0o777 == 0o600
    assert files[0].read_text() != files[1].read_text()
    with pytest.raises(GuardedKeyError, match="never written over"):
        write_new_key(files[0])
    with pytest.raises(GuardedKeyError, match="cannot be written: No such file"):
        write_new_key(tmp_path / "no" / "folder")
    monkeypatch.setenv(KEY_FILE, str(files[0]))
    seal = guarded_seal(small_cell(**OUTSIDE))
    assert isinstance(seal, KeyedSeal)
