"""The key of the guarded realm: no service starts without one, and what is no secret is no key."""

import asyncio
import os
from collections import Counter
from types import SimpleNamespace

import pytest
from small_cell import small_cell

from deltaq_cell.cell_model import CellModel
from deltaq_deploy.launch.launch_key import LaunchKey
from deltaq_protocol.seal import ForgedMessageError
from deltaq_services.guarded_key import (
    KEY_FILE,
    GuardedKeyError,
    guarded_seal,
    off_loopback,
    realm_of,
    write_new_key,
)
from deltaq_services.hli.guarded_front import GuardedFront
from deltaq_services.robot_server.guarded_link import GuardedLink
from deltaq_services.runtime_folder import RuntimeFolderError, runtime_folder
from deltaq_services.sim.shell import Shell as GateShell

OUTSIDE = {"sim": "tcp/192.168.7.1:7450"}
WHERE = "deltaq-guarded/small/command"


@pytest.fixture(autouse=True)
def no_key(tmp_path, monkeypatch):
    """Nobody has given a key, and this user has started nothing."""
    monkeypatch.delenv(KEY_FILE)
    folder = tmp_path / "runtime"
    folder.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder))


def test_where_clients_connect_is_not_the_guarded_realm():
    assert off_loopback(small_cell(hli="tcp/0.0.0.0:7447", tcp_address="0.0.0.0")) is None


def test_off_the_loopback_a_missing_key_is_told_with_the_field_and_what_to_do():
    with pytest.raises(
        GuardedKeyError,
        match=r"^sim \(tcp/192\.168\.7\.1:7450\) of cell small .*DELTAQ_GUARDED_KEY_FILE.*`deltaq keys CELL",
    ):
        guarded_seal(small_cell(**OUTSIDE))


def test_a_robot_server_off_the_loopback_needs_a_key_that_the_user_gives():
    cell = small_cell()
    fr = cell.robots["fr"].model_copy(update={"server": "tcp/robots.example:7451"})
    cell = cell.model_copy(update={"robots": cell.robots | {"fr": fr}})
    assert off_loopback(cell) == "robots.fr.server (tcp/robots.example:7451)"
    assert realm_of(cell) is None


@pytest.mark.parametrize("sim", [None, "tcp/192.168.7.1:7450"])
async def test_no_service_starts_without_a_key(tmp_path, sim):
    file = tmp_path / "plant.yaml"
    file.write_text("extends: lab\n" + (f"sim: {sim}\n" if sim else ""), encoding="utf-8")
    model = CellModel.load(file)
    cell, port = model.description, SimpleNamespace(loop=asyncio.get_running_loop())
    for start in (
        lambda: GuardedLink(cell, "fr", Counter()),
        lambda: GateShell(model),
        lambda: GuardedFront(cell, port),
    ):
        with pytest.raises(GuardedKeyError, match=r"`deltaq key FILE`") as refused:
            start()
        assert KEY_FILE in str(refused.value)


def test_what_to_do_is_told_to_who_starts_a_service_by_hand():
    with pytest.raises(
        GuardedKeyError, match=r"no key: .* `deltaq up --only NAME`.*set \w+=FILE for HLI, SIM"
    ):
        guarded_seal(small_cell())


@pytest.mark.parametrize("text", ["", "secret", "ab" * 31, "ab" * 33, "é" * 64, "0x" + "ab" * 31])
def test_what_is_no_key_is_refused_and_never_shown(tmp_path, monkeypatch, text):
    file = tmp_path / "key"
    file.write_text(text, encoding="utf-8")
    file.chmod(0o600)
    monkeypatch.setenv(KEY_FILE, str(file))
    with pytest.raises(GuardedKeyError, match="holds no key, which is 64 hexadecimal digits") as refused:
        guarded_seal(small_cell())
    assert not text or text not in str(refused.value)


def test_a_file_that_is_not_there_is_told(tmp_path, monkeypatch):
    monkeypatch.setenv(KEY_FILE, str(tmp_path / "none"))
    with pytest.raises(GuardedKeyError, match="none cannot be read: No such file"):
        guarded_seal(small_cell())


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o620, 0o602, 0o666, 0o610])
def test_a_key_that_others_may_use_is_none(tmp_path, monkeypatch, mode):
    file = tmp_path / "key"
    write_new_key(file)
    file.chmod(mode)
    monkeypatch.setenv(KEY_FILE, str(file))
    with pytest.raises(GuardedKeyError, match=rf"has mode {mode:04o}, .* at most 0600 .*`chmod 600 {file}`"):
        guarded_seal(small_cell())
    with pytest.raises(GuardedKeyError, match=f"has mode {mode:04o}"):
        write_new_key(file, keep=True)


def test_a_key_of_somebody_else_is_none(tmp_path, monkeypatch):
    file = tmp_path / "key"
    write_new_key(file)
    try:
        os.chown(file, os.geteuid() + 1, -1)
    except PermissionError:
        pytest.skip("only root gives files away")
    monkeypatch.setenv(KEY_FILE, str(file))
    with pytest.raises(GuardedKeyError, match=rf"belongs to user {os.geteuid() + 1}, .*`sudo chown"):
        guarded_seal(small_cell())


def test_what_is_no_file_is_no_key(monkeypatch):
    monkeypatch.setenv(KEY_FILE, "/dev/null")
    with pytest.raises(GuardedKeyError, match="/dev/null is no regular file"):
        guarded_seal(small_cell())


def test_a_new_key_is_its_owners_alone_differs_from_every_other_and_is_never_written_over(
    tmp_path, monkeypatch
):
    files = [tmp_path / "one", tmp_path / "other"]
    for file in files:
        write_new_key(file)
        assert file.stat().st_mode & 0o777 == 0o600
    text = files[0].read_text()
    assert text != files[1].read_text()
    with pytest.raises(GuardedKeyError, match="never overwritten"):
        write_new_key(files[0])
    write_new_key(files[0], keep=True)
    assert files[0].read_text() == text
    with pytest.raises(GuardedKeyError, match="cannot be written: No such file"):
        write_new_key(tmp_path / "no" / "folder")
    monkeypatch.setenv(KEY_FILE, str(files[0]))
    assert are_of_one_realm(small_cell(**OUTSIDE), small_cell(**OUTSIDE))


def are_of_one_realm(one, other):
    sealed = guarded_seal(one).close(WHERE, b"said")
    return guarded_seal(other).read(WHERE, sealed) == b"said"


# --- keys of launches -------------------------------------------------------------------------------


def test_a_launch_has_a_key_of_its_own_and_leaves_nothing_behind():
    cell, keys = small_cell(), []
    for _ in range(2):
        launched = LaunchKey(realm_of(cell))
        assert launched.file.stat().st_mode & 0o777 == 0o600
        assert launched.file.parent.stat().st_mode & 0o777 == 0o700
        assert are_of_one_realm(cell, cell)
        keys.append(launched.file.read_text())
        launched.close()
        assert list(runtime_folder().iterdir()) == []
    assert keys[0] != keys[1]
    with pytest.raises(GuardedKeyError, match="no key"):
        guarded_seal(cell)


def test_a_launch_that_starts_a_service_again_joins_the_others_and_takes_nothing_from_them():
    realm = realm_of(small_cell())
    first = LaunchKey(realm)
    key = first.file.read_text()
    again = LaunchKey(realm)
    assert again.file == first.file
    again.close()
    assert first.file.read_text() == key
    again = LaunchKey(realm)
    first.close()
    assert again.file.read_text() == key
    again.close()
    assert not again.file.exists()


def test_a_key_that_a_killed_launch_has_left_is_not_used_again():
    cell = small_cell()
    left = LaunchKey(realm_of(cell))
    key = left.file.read_text()
    os.close(left._descriptor)  # as the system does for a process that was killed
    after = LaunchKey(realm_of(cell))
    assert after.file.read_text() != key
    assert are_of_one_realm(cell, cell)
    after.close()


def test_cells_on_other_ports_have_other_realms():
    cell = small_cell()
    assert realm_of(cell) == realm_of(cell)
    assert realm_of(cell) != realm_of(small_cell())


def test_a_key_that_the_user_gives_stands_before_that_of_a_launch(tmp_path, monkeypatch):
    cell = small_cell()
    launched = LaunchKey(realm_of(cell))
    of_launch = guarded_seal(cell)
    monkeypatch.setenv(KEY_FILE, str(tmp_path / "key"))
    write_new_key(tmp_path / "key")
    given = guarded_seal(cell)
    with pytest.raises(ForgedMessageError):
        given.read(WHERE, of_launch.close(WHERE, b"said"))
    launched.close()


def test_a_file_laid_there_by_somebody_is_not_made_a_key():
    realm = realm_of(small_cell())
    file = runtime_folder() / f"{realm}.key"
    file.symlink_to("/tmp/elsewhere")
    with pytest.raises(GuardedKeyError, match="cannot be written"):
        LaunchKey(realm)
    file.unlink()
    file.write_text("ab" * 32)
    file.chmod(0o644)
    with pytest.raises(GuardedKeyError, match="has mode 0644"):
        LaunchKey(realm)


def test_a_runtime_folder_that_others_may_enter_is_refused(tmp_path, monkeypatch):
    folder = runtime_folder()
    folder.chmod(0o750)
    with pytest.raises(RuntimeFolderError, match=rf"has mode 0750, .* 0700 is needed: `chmod 700 {folder}`"):
        runtime_folder()
    folder.chmod(0o700)
    folder.rename(tmp_path / "moved")
    folder.symlink_to(tmp_path / "moved")
    with pytest.raises(RuntimeFolderError, match="is no folder"):
        runtime_folder()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "none"))
    with pytest.raises(RuntimeFolderError, match=r"cannot be made: No such file.* XDG_RUNTIME_DIR"):
        runtime_folder()


def test_a_runtime_folder_of_somebody_else_is_refused():
    folder = runtime_folder()
    try:
        os.chown(folder, os.geteuid() + 1, -1)
    except PermissionError:
        pytest.skip("only root gives folders away")
    with pytest.raises(RuntimeFolderError, match=f"belongs to user {os.geteuid() + 1}"):
        runtime_folder()


def test_without_a_runtime_folder_of_the_system_there_is_one_among_the_temporary(monkeypatch, tmp_path):
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert runtime_folder() == tmp_path / f"deltaq-runtime-{os.geteuid()}"
    assert runtime_folder().stat().st_mode & 0o777 == 0o700
