"""A hello over TCP that shows the role of a token without sending it."""

import json
import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest
from certificate import certificate
from guarded_peer import guarded_peer
from json_client import JsonClient, json_client
from networks import own_address
from small_cell import small_cell, told, tool_pose

from deltaq_protocol.proof import line_proof
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.line_encryption import is_overheard, line_encryption
from deltaq_services.hli.shell import Hli

OPERATOR, CONTROLLER = "0123456789abcdef-operator", "0123456789abcdef-controller"

ROLES = ClientRoles(OPERATOR, CONTROLLER)


off_loopback = pytest.mark.skipif(
    own_address() is None, reason="this machine has no address but its loopback"
)


@asynccontextmanager
async def serving(
    roles: ClientRoles = ROLES, encryption: ssl.SSLContext | None = None, address: str = "127.0.0.1"
) -> AsyncIterator[tuple[Hli, int]]:
    cell = small_cell(tcp_address=address)
    async with guarded_peer(cell) as peer, Hli(cell, told(cell), tool_pose, roles, encryption) as hli:
        await peer.turn()
        yield hli, peer.cell.tcp_port


async def challenge_of(client: JsonClient) -> str:
    return str((await client.ask("challenge", type="challenge"))["challenge"])


async def greet(client: JsonClient, **fields: Any) -> dict[str, Any]:
    return await client.ask("welcome", type="hello", protocol=3, client="octave", **fields)


@pytest.mark.parametrize(("token", "may_take"), [(OPERATOR, True), (CONTROLLER, False)])
async def test_a_proven_challenge_gives_the_role_of_the_token(token: str, may_take: bool) -> None:
    async with serving() as (_, port), json_client(port, name=None) as client:
        challenge = await challenge_of(client)
        assert (await greet(client, challenge=challenge, proof=line_proof(token, challenge)))[
            "type"
        ] == "welcome"
        assert (await client.ask("lease", type="lease", robot="fr", action="acquire"))["granted"]
        async with json_client(port, name=None) as second:
            challenge = await challenge_of(second)
            await greet(second, challenge=challenge, proof=line_proof(token, challenge))
            taken = await second.ask("lease", type="lease", robot="fr", action="take")
            assert taken["granted"] is may_take


async def test_a_proof_is_valid_once_and_only_for_its_challenge() -> None:
    """The attack: whoever listened to one hello says it again, or says its proof for another challenge."""
    async with serving() as (hli, port), json_client(port, name=None) as client:
        challenge, other = await challenge_of(client), await challenge_of(client)
        proof = line_proof(OPERATOR, challenge)
        assert (await greet(client, challenge=challenge, proof=proof))["type"] == "welcome"
        for repeated in (
            {"challenge": challenge, "proof": proof},
            {"challenge": other, "proof": proof},
            {"challenge": "00" * 48, "proof": line_proof(OPERATOR, "00" * 48)},
        ):
            async with json_client(port, name=None) as stranger:
                refused = await greet(stranger, **repeated)
                assert (refused["type"], refused["code"]) == ("error", "not_permitted")
                assert "wrong token" in refused["message"]
                await stranger.ended()
        counters = hli.status().hli
        assert counters["tokens_wrong"] + counters.get("tokens_not_compared", 0) == 3


async def test_a_proof_without_challenge_or_with_a_wrong_token_is_invalid() -> None:
    async with serving() as (_, port):
        for fields in ({"proof": "0" * 64}, {"proof": line_proof(OPERATOR, ""), "token": OPERATOR}):
            async with json_client(port, name=None) as stranger:
                assert (await greet(stranger, **fields))["type"] == "error"


async def test_without_configured_tokens_a_client_with_a_token_is_served_like_others() -> None:
    async with serving(ClientRoles()) as (_, port), json_client(port, name=None) as client:
        challenge = await challenge_of(client)
        assert (await greet(client, challenge=challenge, proof=line_proof("any", challenge)))[
            "type"
        ] == "welcome"
        assert (await client.ask("lease", type="lease", robot="fr", action="acquire"))["granted"]


# --- tokens that are sent as they are -----------------------------------------------------------------


@off_loopback
@pytest.mark.parametrize("with_a_proof", [False, True])
async def test_an_unencrypted_token_gives_no_role_over_a_network(with_a_proof: bool) -> None:
    """The attack: who has read a token off the wire, which any program did that sent one, sends it again."""
    fields = {"token": OPERATOR}
    async with serving(address="0.0.0.0") as (hli, port):
        async with json_client(port, name=None, host=str(own_address())) as client:
            if with_a_proof:
                challenge = await challenge_of(client)
                fields |= {"challenge": challenge, "proof": line_proof(OPERATOR, challenge)}
            refused = await greet(client, **fields)
            assert (refused["type"], refused["code"]) == ("error", "not_permitted")
            for remedy in ("`challenge`", "`proof`", "DELTAQ_LINES_CERTIFICATE_FILE", "Draw a new token"):
                assert remedy in refused["hint"]
            assert OPERATOR not in json.dumps(refused)
            await client.ended()
        counters = hli.status().hli
        assert counters["tokens_in_clear"] == 1
        assert counters["attempts_refused_connected_not_permitted"] == 1
        assert "tokens_wrong" not in counters, "it was not compared"


@off_loopback
async def test_over_a_network_clients_with_and_without_a_token_are_served_as_on_the_loopback() -> None:
    async with serving(address="0.0.0.0") as (_, port):
        async with json_client(port, name=None, host=str(own_address())) as client:
            challenge = await challenge_of(client)
            welcome = await greet(client, challenge=challenge, proof=line_proof(OPERATOR, challenge))
            assert welcome["type"] == "welcome"
            assert (await client.ask("lease", type="lease", robot="fr", action="take"))["granted"]
        async with json_client(port, host=str(own_address())) as observer:
            assert not (await observer.ask("lease", type="lease", robot="fr", action="acquire"))["granted"]


@off_loopback
async def test_a_plain_token_is_accepted_on_the_loopback_and_over_tls(tmp_path: Path) -> None:
    files = certificate(tmp_path)
    trusted = ssl.create_default_context(cafile=files["DELTAQ_LINES_CERTIFICATE_FILE"])
    trusted.check_hostname = False  # the certificate is for the loopback
    async with serving(address="0.0.0.0") as (_, port), json_client(port, token=OPERATOR) as client:
        assert (await client.ask("lease", type="lease", robot="fr", action="take"))["granted"]
    encryption = line_encryption(small_cell(), files)
    async with (
        serving(encryption=encryption, address="0.0.0.0") as (_, port),
        json_client(port, host=str(own_address()), encryption=trusted, token=OPERATOR) as client,
    ):
        assert (await client.ask("lease", type="lease", robot="fr", action="take"))["granted"]


@pytest.mark.parametrize("address", ["192.0.2.7", "fd00::2", "fe80::1%eth0", "::ffff:192.0.2.7", ""])
def test_any_address_but_the_loopback_can_be_listened_to_unless_encrypted(address: str) -> None:
    assert is_overheard(address, is_encrypted=False)
    assert not is_overheard(address, is_encrypted=True)
    assert not any(is_overheard(here, is_encrypted=False) for here in ("127.0.0.1", "127.8.9.1", "::1"))
