"""Where the guarded realm meets: a folder of this user alone, or TLS; nothing starts elsewhere."""

import asyncio
import os
import stat
from collections import Counter
from types import SimpleNamespace

import pytest
from small_cell import small_cell

from deltaq_cell.cell_model import CellModel
from deltaq_deploy.launch.launcher import Launcher
from deltaq_deploy.launch.services import Role, Service
from deltaq_services.guarded_realm import (
    GUARDED_FOLDER,
    GuardedRealmError,
    guarded_folder,
    guarded_links,
    realm_of,
)
from deltaq_services.hli.guarded_front import GuardedFront
from deltaq_services.robot_server.guarded_link import GuardedLink
from deltaq_services.runtime_folder import RuntimeFolderError, runtime_folder
from deltaq_services.sim.shell import Shell as GateShell


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A runtime folder in which this user has started nothing."""
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    return tmp_path / f"deltaq-runtime-{os.geteuid()}"


def paths(cell):
    return {service: link.removeprefix("unixsock-stream/") for service, link in guarded_links(cell).items()}


def test_each_service_has_a_socket_in_a_private_folder():
    cell = small_cell()
    folder = runtime_folder() / realm_of(cell)
    assert paths(cell) == {
        service: str(folder / f"{service}.sock") for service in ("sim", "robot-server-fr", "robot-server-gr")
    }
    about = folder.lstat()
    assert (about.st_uid, stat.S_IMODE(about.st_mode)) == (os.geteuid(), 0o700)


def test_an_older_cell_with_loopback_ports_uses_the_same_sockets():
    cell = small_cell()
    fr = cell.robots["fr"].model_copy(update={"server": "tcp/127.0.0.1:7451"})
    before = cell.model_copy(update={"sim": "tcp/localhost:7450", "robots": cell.robots | {"fr": fr}})
    assert guarded_links(before) == guarded_links(cell)


def test_an_endpoint_may_name_its_socket(monkeypatch, tmp_path):
    monkeypatch.setenv(GUARDED_FOLDER, "/tmp/dq-test-name")
    try:
        assert paths(small_cell(sim="local/relay"))["sim"] == "/tmp/dq-test-name/relay.sock"
    finally:
        os.rmdir("/tmp/dq-test-name")  # noqa: PTH106 - beside the path above


@pytest.mark.parametrize("mode", [0o750, 0o701, 0o777])
def test_a_folder_that_others_may_enter_is_refused_with_its_mode(folder, mode):
    guarded_folder("lab-1")
    (folder / "lab-1").chmod(mode)
    with pytest.raises(
        RuntimeFolderError, match=rf"lab-1 has mode {mode:04o}, .* 0700 is needed: `chmod 700"
    ):
        guarded_folder("lab-1")


def test_a_folder_of_another_user_is_refused_with_its_owner(folder):
    made = guarded_folder("lab-1")
    try:
        os.chown(made, os.geteuid() + 1, -1)
    except PermissionError:
        pytest.skip("only root gives folders away")
    with pytest.raises(RuntimeFolderError, match=f"belongs to user {os.geteuid() + 1}"):
        guarded_folder("lab-1")
    os.chown(folder, os.geteuid() + 1, -1)
    with pytest.raises(RuntimeFolderError, match=f"deltaq-runtime.* belongs to user {os.geteuid() + 1}"):
        guarded_folder("lab-1")


def test_a_link_or_file_in_place_of_the_folder_is_refused(folder, tmp_path):
    runtime_folder()
    (tmp_path / "elsewhere").mkdir(mode=0o700)
    (folder / "lab-1").symlink_to(tmp_path / "elsewhere")
    (folder / "lab-2").write_text("")
    for name in ("lab-1", "lab-2"):
        with pytest.raises(RuntimeFolderError, match=f"{name} (is no folder|cannot be made)"):
            guarded_folder(name)


def test_a_path_too_long_for_a_socket_is_reported(monkeypatch, tmp_path):
    long = tmp_path / ("x" * 90)
    monkeypatch.setenv(GUARDED_FOLDER, str(long))
    with pytest.raises(GuardedRealmError, match=rf"at most 100; let {GUARDED_FOLDER} name a shorter folder"):
        guarded_links(small_cell())


def test_cells_at_other_addresses_have_other_folders():
    cell = small_cell()
    assert realm_of(cell) == realm_of(cell.model_copy(update={"sim": "local/relay"}))
    assert realm_of(cell) != realm_of(small_cell())


@pytest.mark.parametrize(
    ("sim", "said"),
    [
        ("tcp/192.168.7.1:7450", r"^sim \(tcp/192.*plain tcp/ lets all of them in.*`deltaq keys --cell CELL"),
        ("tls/192.168.7.1:7450", r"^robots\.fr\.server \(local\) .*has to be"),
    ],
)
async def test_no_service_starts_in_an_open_guarded_realm(tmp_path, sim, said):
    file = tmp_path / "plant.yaml"
    file.write_text(f"extends: lab\nsim: {sim}\n", encoding="utf-8")
    model = CellModel.load(file)
    cell, port = model.description, SimpleNamespace(loop=asyncio.get_running_loop())
    for start in (
        lambda: GuardedLink(cell, "fr", Counter()),
        lambda: GateShell(model),
        lambda: GuardedFront(cell, port),
    ):
        with pytest.raises(GuardedRealmError, match=said):
            start()


async def test_over_tls_no_service_starts_without_an_identity(tmp_path):
    at = "tls/127.0.0.1"
    places = f"sim: {at}:7450\nrobots: {{fr: {{server: {at}:7451}}, gr: {{server: {at}:7452}}}}"
    file = tmp_path / "plant.yaml"
    file.write_text(f"extends: lab\n{places}\n", encoding="utf-8")
    model = CellModel.load(file)
    with pytest.raises(GuardedRealmError, match="is encrypted, and DELTAQ_IDENTITY names no identity"):
        GuardedLink(model.description, "fr", Counter())


def sleeper(realm, name):
    said = f"print(os.environ[{GUARDED_FOLDER!r}], flush=True); print('ready: x', flush=True)"
    program = f"import os, time; {said}; time.sleep(60)"
    return Service(name, Role.SIM, ("-c", program), realm=realm)


def test_a_launch_makes_the_folder_gives_it_to_its_services_and_removes_it(folder):
    with Launcher([sleeper("lab-1", "sim")], lambda *_: None) as launcher:
        launcher.start()
        made = folder / "lab-1"
        assert launcher.last_lines("sim")[0] == str(made)
        assert stat.S_IMODE(made.stat().st_mode) == 0o700
        (made / "robot-server-fr.sock").write_text("left by a process that was killed")
    assert not made.exists()


def test_a_launch_that_joins_another_leaves_its_folder(folder):
    import socket

    made = guarded_folder("lab-1")
    with socket.socket(socket.AF_UNIX) as other:
        other.bind(str(made / "sim.sock"))
        other.listen()
        with Launcher([sleeper("lab-1", "hli")], lambda *_: None) as launcher:
            launcher.start()
        assert made.exists()


def test_a_runtime_folder_that_others_may_enter_is_refused(folder, tmp_path, monkeypatch):
    runtime_folder().chmod(0o750)
    with pytest.raises(RuntimeFolderError, match=r"has mode 0750, .* 0700 is needed"):
        runtime_folder()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "none"))
    with pytest.raises(RuntimeFolderError, match="cannot be made: No such file"):
        runtime_folder()
