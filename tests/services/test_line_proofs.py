"""A hello over TCP that shows the role of a token without sending it."""

from __future__ import annotations

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from guarded_peer import guarded_peer
from json_client import JsonClient, json_client
from small_cell import small_cell, told, tool_pose

from deltaq_protocol.proof import line_proof
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.shell import Hli

OPERATOR, CONTROLLER = "0123456789abcdef-operator", "0123456789abcdef-controller"

ROLES = ClientRoles(OPERATOR, CONTROLLER)


@asynccontextmanager
async def serving(roles: ClientRoles = ROLES) -> AsyncIterator[tuple[Hli, int]]:
    cell = small_cell()
    async with guarded_peer(cell) as peer, Hli(cell, told(cell), tool_pose, roles) as hli:
        await peer.turn()
        yield hli, peer.cell.tcp_port


async def challenge_of(client: JsonClient) -> str:
    return str((await client.ask("challenge", type="challenge"))["challenge"])


async def greet(client: JsonClient, **fields: Any) -> dict[str, Any]:
    return await client.ask("welcome", type="hello", protocol=3, client="octave", **fields)


@pytest.mark.parametrize(("token", "may_take"), [(OPERATOR, True), (CONTROLLER, False)])
async def test_who_answers_the_challenge_has_the_role_of_the_token(token: str, may_take: bool) -> None:
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


async def test_a_proof_is_good_once_and_for_its_challenge_alone() -> None:
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


async def test_a_proof_without_a_challenge_or_of_a_wrong_token_is_none() -> None:
    async with serving() as (_, port):
        for fields in ({"proof": "0" * 64}, {"proof": line_proof(OPERATOR, ""), "token": OPERATOR}):
            async with json_client(port, name=None) as stranger:
                assert (await greet(stranger, **fields))["type"] == "error"


async def test_where_there_are_no_tokens_whoever_shows_one_is_served_as_everybody_is() -> None:
    async with serving(ClientRoles()) as (_, port), json_client(port, name=None) as client:
        challenge = await challenge_of(client)
        assert (await greet(client, challenge=challenge, proof=line_proof("any", challenge)))[
            "type"
        ] == "welcome"
        assert (await client.ask("lease", type="lease", robot="fr", action="acquire"))["granted"]
