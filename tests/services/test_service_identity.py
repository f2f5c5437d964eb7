"""Services under identities: none starts as another, of another cell, out of date, or where others read its key."""

import asyncio
import shutil
from collections import Counter
from datetime import timedelta
from types import SimpleNamespace

import pytest
from identities import make

from deltaq_cell.cell_model import CellModel
from deltaq_protocol.certified.names import IDENTITY, IdentityError
from deltaq_services.hli.guarded_front import GuardedFront
from deltaq_services.robot_server.guarded_link import GuardedLink
from deltaq_services.service_identity import tls_settings
from deltaq_services.sim.shell import Shell as GateShell

DAY = timedelta(days=1)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    file = tmp_path_factory.mktemp("cell") / "plant.yaml"
    places = "sim: tls/127.0.0.1:7450\nrobots: {fr: {server: tls/127.0.0.1:7451}, gr: {server: tls/127.0.0.1:7452}}"
    file.write_text(f"extends: lab\n{places}\n", encoding="utf-8")
    return CellModel.load(file)


@pytest.fixture
def cell(model):
    return model.description


@pytest.fixture
def folder(tmp_path, monkeypatch, cell):
    """Identities, of which the environment names the folder."""
    folder = make(tmp_path / "identities", cell.cell, people=("operator-desk",))
    monkeypatch.setenv(IDENTITY, str(folder))
    return folder


async def starts(model):
    """Each service of the guarded realm, begun as its process begins it."""
    cell, port = model.description, SimpleNamespace(loop=asyncio.get_running_loop())
    return {
        "robot-server-fr": lambda: GuardedLink(cell, "fr", Counter()),
        "sim": lambda: GateShell(model),
        "hli": lambda: GuardedFront(cell, port),
    }


@pytest.mark.parametrize("name", ["robot-server-fr", "sim", "hli"])
async def test_no_service_starts_under_the_identity_of_another(model, folder, monkeypatch, name):
    start = (await starts(model))[name]
    for other in {"robot-server-fr", "robot-server-gr", "sim", "hli"} - {name}:
        monkeypatch.setenv(IDENTITY, str(folder / other))
        with pytest.raises(
            IdentityError, match=f"is the identity of {other}, and this is {name}; name the folder"
        ):
            start()
    monkeypatch.setenv(IDENTITY, str(folder / "operator-desk"))
    with pytest.raises(
        IdentityError, match="operator-desk, which is no service: operators connect to the HLI"
    ):
        start()


@pytest.mark.parametrize("name", ["robot-server-fr", "sim", "hli"])
async def test_no_service_starts_where_others_may_use_its_key(model, folder, name):
    (folder / name / "key.pem").chmod(0o640)
    start = (await starts(model))[name]
    with pytest.raises(IdentityError, match="has mode 0640"):
        start()


@pytest.mark.parametrize("name", ["robot-server-fr", "sim", "hli"])
async def test_no_service_starts_when_its_certificate_is_out_of_date(model, tmp_path, monkeypatch, name):
    folder = make(tmp_path / "old", model.description.cell, age=800 * DAY)
    monkeypatch.setenv(IDENTITY, str(folder))
    start = (await starts(model))[name]
    with pytest.raises(
        IdentityError, match=r"was valid until .*`deltaq keys --cell CELL --output NEW_FOLDER`"
    ):
        start()


def test_a_folder_of_another_cell_is_reported(cell, tmp_path):
    with pytest.raises(
        IdentityError,
        match=f"is an identity of cell other, and this is cell {cell.cell}; `deltaq keys --cell CELL",
    ):
        tls_settings(cell, make(tmp_path / "other", "other"), "sim")


def test_a_service_finds_its_own_folder_or_is_given_it(cell, folder):
    assert tls_settings(cell, folder, "sim") == tls_settings(cell, folder / "sim", "sim")


def test_one_machine_needs_its_own_folder_and_nothing_else(cell, folder, tmp_path):
    machine = tmp_path / "machine"
    shutil.copytree(folder / "robot-server-fr", machine)
    shutil.rmtree(folder)
    settings = tls_settings(cell, machine, "robot-server-fr")
    assert settings["listen_certificate"] == str(machine / "certificate.pem")


def test_an_observer_may_show_any_identity_of_the_cell(cell, folder):
    settings = tls_settings(cell, folder / "operator-desk", "sim", only_watches=True)
    assert settings["connect_certificate"] == str(folder / "operator-desk" / "certificate.pem")


def test_in_the_last_thirty_days_a_service_starts_with_a_warning(cell, tmp_path, caplog):
    assert tls_settings(cell, make(tmp_path / "old", age=710 * DAY), "sim")
    [record] = caplog.records
    assert "sim/certificate.pem is valid for 19 more days, until" in record.getMessage()
    assert record.levelname == "WARNING"
