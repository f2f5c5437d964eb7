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
from deltaq_protocol.seal import ForgedMessageError, UnboundMessageError
from deltaq_services.guarded_key import KEY_FILE, GuardedKeyError, guarded_seal
from deltaq_services.hli.guarded_front import GuardedFront
from deltaq_services.robot_server.guarded_link import GuardedLink
from deltaq_services.sim.shell import Shell as GateShell

ADMISSION = "deltaq-guarded/lab/fr/admission"
DAY = timedelta(days=1)


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    file = tmp_path_factory.mktemp("cell") / "plant.yaml"
    file.write_text("extends: lab\n", encoding="utf-8")
    return CellModel.load(file)


@pytest.fixture
def cell(model):
    return model.description


@pytest.fixture
def folder(tmp_path, monkeypatch, cell):
    """Identities, of which the environment names the folder; nobody has given a key."""
    folder = make(tmp_path / "identities", cell.cell, people=("operator-desk",))
    monkeypatch.delenv(KEY_FILE)
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
    monkeypatch.delenv(KEY_FILE)
    monkeypatch.setenv(IDENTITY, str(folder))
    start = (await starts(model))[name]
    with pytest.raises(IdentityError, match=r"was valid until .*`deltaq keys CELL --to NEW_FOLDER`"):
        start()


def test_a_folder_of_another_cell_is_told(cell, tmp_path, monkeypatch):
    monkeypatch.delenv(KEY_FILE)
    monkeypatch.setenv(IDENTITY, str(make(tmp_path / "other", "other")))
    with pytest.raises(
        IdentityError, match=f"is an identity of cell other, and this is cell {cell.cell}; `deltaq keys CELL"
    ):
        guarded_seal(cell, "sim")


def test_an_identity_and_a_key_are_one_too_many(cell, folder, monkeypatch):
    monkeypatch.setenv(KEY_FILE, "somewhere")
    with pytest.raises(GuardedKeyError, match="DELTAQ_IDENTITY and DELTAQ_GUARDED_KEY_FILE are both set"):
        guarded_seal(cell, "sim")


def test_a_cell_with_a_robot_more_than_its_identities_is_told(cell, folder, monkeypatch):
    (folder / "sim" / "services" / "robot-server-gr.pem").unlink()
    with pytest.raises(IdentityError, match=r"robot-server-gr\.pem is missing; `deltaq keys` adds"):
        guarded_seal(cell, "sim")


def test_a_service_finds_its_own_folder_or_is_given_it(cell, folder, monkeypatch):
    above = guarded_seal(cell, "sim").close(ADMISSION, b"said")
    monkeypatch.setenv(IDENTITY, str(folder / "sim"))
    given = guarded_seal(cell, "sim").close(ADMISSION, b"said")
    monkeypatch.setenv(IDENTITY, str(folder / "robot-server-fr"))
    receiver = guarded_seal(cell, "robot-server-fr")
    for sealed in (above, given):
        with pytest.raises(UnboundMessageError):
            receiver.open(ADMISSION, sealed)


def test_one_machine_needs_its_own_folder_and_nothing_else(cell, folder, tmp_path, monkeypatch):
    sealed = guarded_seal(cell, "sim").close(ADMISSION, b"said")
    machine = tmp_path / "machine"
    shutil.copytree(folder / "robot-server-fr", machine)
    shutil.rmtree(folder)
    monkeypatch.setenv(IDENTITY, str(machine))
    assert guarded_seal(cell, "robot-server-fr").read(ADMISSION, sealed) == b"said"


def test_health_is_read_with_the_identity_of_the_service_or_of_one_that_it_speaks_to(
    cell, folder, monkeypatch
):
    key = "deltaq-guarded/lab/health/robot-server-fr"
    sealed = guarded_seal(cell, "robot-server-fr").close(key, b"well")
    assert guarded_seal(cell, watched="robot-server-fr").read(key, sealed) == b"well"
    monkeypatch.setenv(IDENTITY, str(folder / "hli"))
    assert guarded_seal(cell, watched="robot-server-fr").read(key, sealed) == b"well"
    monkeypatch.setenv(IDENTITY, str(folder / "robot-server-gr"))
    with pytest.raises(ForgedMessageError, match="nothing is said there to this identity"):
        guarded_seal(cell, watched="robot-server-fr").read(key, sealed)


def test_the_last_thirty_days_are_told_at_the_start_and_a_service_starts(cell, tmp_path, monkeypatch, caplog):
    monkeypatch.delenv(KEY_FILE)
    monkeypatch.setenv(IDENTITY, str(make(tmp_path / "old", age=710 * DAY)))
    assert guarded_seal(cell, "sim").close(ADMISSION, b"said")
    [record] = caplog.records
    assert "sim/certificate.pem is valid for 19 more days, until" in record.getMessage()
    assert record.levelname == "WARNING"
