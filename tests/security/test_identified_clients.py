"""Clients with identities at a running HLI: by a signature over zenoh, by TLS over lines; the log has proven names."""

import asyncio
import contextlib
import ssl
from datetime import timedelta

import pytest
from audited import OPERATOR, audited
from certificate import certificate
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from json_client import JsonClient
from signed_clients import authority_pem, known_to, people
from small_cell import small_cell

from deltaq_protocol import connect
from deltaq_protocol.certified.authority import Authority
from deltaq_protocol.certified.certificate import now_utc
from deltaq_protocol.certified.names import AUTHORITY_FILE, CLIENT_IDENTITY, IDENTITY, IdentityError
from deltaq_protocol.errors import RefusedError
from deltaq_protocol.given_token import GivenTokenError
from deltaq_protocol.topic import ClientRole
from deltaq_services.hli.client_roles import client_roles
from deltaq_services.hli.line_encryption import line_encryption
from deltaq_services.service_identity import authority_of_clients


@pytest.fixture
def folder(tmp_path):
    return people(tmp_path / "identities")


@pytest.fixture
async def hli(tmp_path, folder):
    async with audited(tmp_path / "audit.jsonl", identities=known_to(folder)) as running:
        turning = asyncio.create_task(running.peer.run())
        yield running
        turning.cancel()


async def test_an_operator_needs_no_token_and_the_log_has_the_proven_name(hli, folder):
    async with connect(hli.peer.cell.hli, client="desk", identity=folder / "operator-desk") as cell:
        async with cell.lease("fr", take=True):
            await hli.entry("lease_granted", "done", client="desk", identity="operator-desk", role="operator")
        await cell.reset("fr")
    for outcome in ("asked", "done"):
        await hli.entry("reset", outcome, identity="operator-desk", role="operator")


async def test_a_controller_may_move_but_not_reset(hli, folder, monkeypatch):
    monkeypatch.setenv(CLIENT_IDENTITY, str(folder / "controller-tower"))
    async with connect(hli.peer.cell.hli, client="camera") as cell:
        async with cell.lease("fr"):
            await hli.entry("lease_granted", "done", identity="controller-tower", role="controller")
        with pytest.raises(RefusedError, match="not_permitted"):
            await cell.reset("fr")
    await hli.entry("reset", "refused", identity="controller-tower", role="controller")


async def test_a_claimed_name_proves_nothing(hli, folder, tmp_path):
    others = people(tmp_path / "others")
    for identity in (None, others / "operator-desk"):
        async with connect(hli.peer.cell.hli, client="operator-desk", identity=identity) as cell:
            with pytest.raises(RefusedError, match="not_permitted"):
                await cell.reset("fr")
    await hli.entry("reset", "refused", client="operator-desk", identity="", role="observer", count=1)
    assert hli.peer.commands.empty()


async def test_tokens_are_accepted_beside_identities(hli):
    async with connect(hli.peer.cell.hli, client="desk", token=OPERATOR) as cell:
        await cell.reset("fr")
    await hli.entry("reset", "done", client="desk", identity="", role="operator")


async def test_a_cell_without_authority_serves_a_client_with_an_identity(tmp_path, folder):
    async with audited(tmp_path / "audit.jsonl") as running:
        turning = asyncio.create_task(running.peer.run())
        async with connect(running.peer.cell.hli, identity=folder / "operator-desk") as cell:
            assert (await cell.status()).cell == "small"
            with pytest.raises(RefusedError, match="not_permitted"):
                await cell.reset("fr")
        turning.cancel()


async def test_a_wrong_identity_folder_is_reported_before_connecting(folder, tmp_path):
    for identity, told in (
        (folder / "sim", "is the identity of sim, a service"),
        (tmp_path / "none", "cannot be read"),
    ):
        with pytest.raises(IdentityError, match=told):
            connect("tcp/127.0.0.1:1", identity=identity)


# --- lines ----------------------------------------------------------------------------------------------


@pytest.fixture
async def lines(tmp_path, folder):
    """An HLI with lines over TLS, and a way to connect with somebody's identity."""
    files = certificate(tmp_path)
    encryption = line_encryption(small_cell(), files, authority_pem(folder))

    async def line(identity=None):
        trusted = ssl.create_default_context(cafile=files["DELTAQ_LINES_CERTIFICATE_FILE"])
        if identity is not None:
            trusted.load_cert_chain(identity / "certificate.pem", identity / "key.pem")
        reader, writer = await asyncio.open_connection("127.0.0.1", running.port, ssl=trusted, limit=2**22)
        opened.append(writer)
        return JsonClient(reader, writer)

    opened = []
    async with audited(tmp_path / "audit.jsonl", encryption, known_to(folder)) as running:
        turning = asyncio.create_task(running.peer.run())
        yield running, line
        turning.cancel()
        for writer in opened:
            writer.close()


def out_of_date(folder, to):
    """An identity that the right authority issued two years ago."""
    long_ago = now_utc() - timedelta(days=731)
    key, issued = Authority.read(folder / "authority", now_utc()).issue("operator-late", long_ago)
    to.mkdir()
    (to / "key.pem").write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    (to / "certificate.pem").write_bytes(issued.public_bytes(Encoding.PEM))
    return to


async def test_a_line_s_certificate_proves_role_and_name(lines, folder):
    running, line = lines
    client = await line(folder / "operator-desk")
    await client.ask("welcome", type="hello", protocol=1, client="desk")
    await client.ask("done", type="reset", robot="fr")
    await running.entry("connected", "done", client="desk", identity="operator-desk", role="operator")
    await running.entry("reset", "done", identity="operator-desk", role="operator")


async def test_a_line_without_a_personal_certificate_proves_nothing(lines, folder):
    running, line = lines
    for number, identity in enumerate((None, folder / "robot-server-fr")):
        client = await line(identity)
        await client.ask("welcome", type="hello", protocol=1, client=f"stranger-{number}")
        assert (await client.ask("error", type="reset", robot="fr"))["code"] == "not_permitted"
        await running.entry("connected", "done", client=f"stranger-{number}", identity="", role="observer")


async def test_a_line_with_a_foreign_or_expired_certificate_is_refused(lines, folder, tmp_path):
    running, line = lines
    others = people(tmp_path / "others") / "operator-desk"
    for number, identity in enumerate((others, out_of_date(folder, tmp_path / "late")), start=1):
        with contextlib.suppress(OSError):  # TLS 1.3 tells the client later
            client = await line(identity)
            client.send(type="hello", protocol=1, client="stranger")
        refused = await running.counted("connected", number)
        assert {(entry["outcome"], entry["code"], entry["identity"]) for entry in refused} == {
            ("refused", "malformed", "")
        }
    assert not running.hli._tcp.connections


# --- what an HLI is given -------------------------------------------------------------------------------


def test_with_an_authority_no_tokens_are_needed_and_clients_without_identity_observe(folder):
    exposed = small_cell(hli="tcp/0.0.0.0:7447", clients_need_tokens=True)
    with pytest.raises(GivenTokenError, match="DELTAQ_IDENTITY"):
        client_roles(exposed, {})
    for variable in (IDENTITY, AUTHORITY_FILE):
        roles = client_roles(exposed, {variable: str(folder)})
        assert roles.of(None) is ClientRole.OBSERVER
        assert roles.of(None, "operator-desk") is ClientRole.OPERATOR
        assert all(len(token) >= 64 for token in roles.tokens)
        assert len(set(roles.tokens)) == 2


def test_the_authority_comes_from_the_hli_or_from_a_file(folder, tmp_path):
    cell = small_cell()
    own = authority_of_clients(cell, {IDENTITY: str(folder)})
    file = folder / "hli" / "authority.pem"
    assert authority_of_clients(cell, {AUTHORITY_FILE: str(file)}) == own
    with pytest.raises(IdentityError, match="is not the certificate of an authority"):
        authority_of_clients(cell, {AUTHORITY_FILE: str(folder / "hli" / "certificate.pem")})
    with pytest.raises(IdentityError, match="is the authority of cell small, and this is cell other"):
        authority_of_clients(small_cell(cell="other"), {AUTHORITY_FILE: str(file)})
    file.chmod(0o666)
    with pytest.raises(IdentityError, match="other users may write it"):
        authority_of_clients(cell, {AUTHORITY_FILE: str(file)})
