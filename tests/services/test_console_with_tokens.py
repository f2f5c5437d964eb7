"""A console whose HLI was given tokens: it shows the operator's where a role is needed, and sends it to nobody."""

from contextlib import asynccontextmanager

import pytest
import websockets
import zenoh
from guarded_peer import guarded_peer
from served_console import Browser, live, served
from small_cell import tool_pose

from deltaq_cell.cell_model import CellModel
from deltaq_protocol.audit import AuditKind
from deltaq_protocol.codec import pack
from deltaq_protocol.messages import Challenge
from deltaq_protocol.session import open_session
from deltaq_services.console.settings import NoTokenError, Settings
from deltaq_services.hli.audit import Audit
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.shell import Hli
from deltaq_testing.private_cell import write_private_cell

pytestmark = pytest.mark.long

OPERATOR, CONTROLLER, DESK = (
    "0123456789abcdef-operator",
    "0123456789abcdef-controller",
    "0123456789abcdef-desk",
)


@asynccontextmanager
async def operated(folder, operator_token, shown=DESK):
    """The HLI of a cell with tokens, and a browser at its console that shows this token, or none."""
    cell = CellModel.load(write_private_cell(folder))
    description = cell.description
    roles = ClientRoles(OPERATOR, CONTROLLER)
    async with (
        guarded_peer(description) as peer,
        Hli(description, cell.description_message(), tool_pose, roles) as hli,
    ):
        await peer.turn("fr")
        async with (
            served(folder, DESK, cell, operator_token) as (_, host),
            websockets.connect(live(host, **({"token": shown} if shown else {}))) as websocket,
        ):
            browser = Browser(websocket)
            while not (await browser.status())["hli"]:
                pass
            yield browser, hli


async def test_a_console_with_the_operator_token_takes_robots_and_changes_views(tmp_path):
    async with operated(tmp_path, OPERATOR) as (browser, hli):
        assert (await browser.ask("reset", robot="fr"))["outcome"] == "done"
        assert (await browser.ask("view_distance", robot="fr", value_m=1.5))["outcome"] == "done"
        assert hli.core.counters["views_asked"] == 1


async def test_the_audit_log_names_browser_and_address_of_console_requests(tmp_path, monkeypatch):
    told = []
    monkeypatch.setattr(Audit, "tell", lambda _, deed, *more: told.append(deed))
    async with operated(tmp_path, OPERATOR) as (browser, _):
        await browser.ask("reset", robot="fr")
        await browser.ask("stop")
    names = {deed.what: deed.origin.client for deed in told if deed.what in (AuditKind.RESET, AuditKind.STOP)}
    assert names == dict.fromkeys((AuditKind.RESET, AuditKind.STOP), "console: operator 1 at 127.0.0.1")


async def test_another_user_cannot_use_a_console_with_the_operator_token(
    tmp_path,
):
    """The attack: a program that is no browser, of any user, at the loopback's port, without a word of who it is."""
    async with operated(tmp_path, OPERATOR, shown=None) as (stranger, hli):
        for kind, fields in (
            ("reset", {"robot": "fr"}),
            ("lease", {"robot": "fr", "action": "take"}),
            ("view_distance", {"robot": "fr", "value_m": 1.5}),
        ):
            answer = await stranger.ask(kind, **fields)
            assert (answer["outcome"], "observer" in answer["text"]) == ("refused", True)
        assert hli.status().robots["fr"].lease.holder is None
        assert (await stranger.ask("stop"))["outcome"] == "done"


@pytest.mark.parametrize("holds", [{"operator_token": OPERATOR}, {"has_role": True}])
def test_a_console_that_commands_in_a_role_does_not_start_without_a_token_of_its_own(holds):
    with pytest.raises(NoTokenError, match="DELTAQ_CONSOLE_TOKEN_FILE"):
        Settings("lab", True, "127.0.0.1", 7480, **holds)
    assert Settings("lab", True, "127.0.0.1", 7480, DESK, **holds).token_needed


async def test_a_console_without_the_token_gets_a_hint(tmp_path):
    async with operated(tmp_path, None) as (browser, _):
        for kind, fields in (("reset", {}), ("view_distance", {"value_m": 1.5})):
            answer = await browser.ask(kind, robot="fr", **fields)
            assert answer["outcome"] == "refused"
            assert "token" in answer["text"]


async def test_a_fake_hli_learns_no_token(tmp_path):
    cell = CellModel.load(write_private_cell(tmp_path))
    asked = {}
    with open_session(listen=[cell.description.hli]) as impostor:

        def answer(query):
            name = str(query.key_expr).rpartition("/")[2]
            asked[name] = query.payload.to_bytes() + (
                query.attachment.to_bytes() if query.attachment else b""
            )
            if name == "challenge":
                query.reply(query.key_expr, pack(Challenge(challenge="00" * 16)))

        impostor.declare_queryable("deltaq/**", zenoh.handlers.Callback(answer, indirect=False))
        async with (
            served(tmp_path, DESK, cell, OPERATOR) as (_, host),
            websockets.connect(live(host, token=DESK)) as websocket,
        ):
            browser = Browser(websocket)
            while not asked:  # the console's session may not have found whom it takes for the HLI yet
                await browser.status()
            await browser.ask("reset", robot="fr")
    assert "reset" in asked
    assert all(OPERATOR.encode() not in said for said in asked.values())


@pytest.mark.service
@pytest.mark.nightly
async def test_drivers_of_the_console_use_the_same_token(tmp_path):
    async with operated(tmp_path, OPERATOR) as (browser, hli):
        await browser.ask("lease", robot="fr", action="take")
        while not (lease := (await browser.status())["robots"]["fr"]["lease"])["mine"]:
            assert "token" not in lease["text"]
        assert hli.status().robots["fr"].lease.holder
