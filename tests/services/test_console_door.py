"""The console's door: who is let in, and what is answered to whoever is not; without a running cell."""

import asyncio
import json
from collections import Counter
from dataclasses import replace

import pytest
import websockets
from served_console import live, served, told

from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_protocol.reasons import EXPLANATIONS, ReasonCode
from deltaq_services.console.hli_link import HliLink
from deltaq_services.console.settings import Door, Entrance, NoTokenError, Settings
from deltaq_services.console.web import listening_socket
from deltaq_testing.private_cell import free_ports

TOKEN = "0123456789abcdef-desk"


async def answered(host, head):
    """The head of the answer to a request with these lines."""
    address, port = host.split(":")
    reader, writer = await asyncio.open_connection(address, int(port))
    writer.write(("\r\n".join(head) + "\r\nConnection: close\r\n\r\n").encode())
    answer = await reader.readuntil(b"\r\n\r\n")
    writer.close()
    return answer.decode()


@pytest.mark.by_day(2)
@pytest.mark.long
@pytest.mark.parametrize(
    "origin", ["https://evil.example", "http://127.0.0.1:1", "http://localhost.evil.example", "null"]
)
async def test_a_page_of_another_site_opens_no_websocket(tmp_path, origin):
    async with served(tmp_path) as (console, host):
        with pytest.raises(websockets.InvalidStatus) as refused:
            await websockets.connect(live(host), origin=origin)
        assert refused.value.response.status_code == 403
        assert console.core.counters["turned_away"] == 1
        assert not console.core.clients


@pytest.mark.long
async def test_a_request_under_another_host_name_is_refused(tmp_path):
    async with served(tmp_path) as (_, host):
        for path in ("/scene.json", "/health"):
            status = await answered(host, [f"GET {path} HTTP/1.1", "Host: rebound.example"])
            assert " 400 " in status
        assert " 200 " in await answered(host, ["GET /scene.json HTTP/1.1", f"Host: {host}"])


async def test_the_page_has_a_content_security_policy_and_other_files_are_not_served(tmp_path, caplog):
    async with served(tmp_path) as (_, host):
        for path in ("/", "/index.js", "/vendor/three.js"):
            answer = await answered(host, [f"GET {path} HTTP/1.1", f"Host: {host}"])
            assert " 200 " in answer
            (policy,) = [line for line in answer.splitlines() if line.startswith("content-security-policy: ")]
            assert "default-src 'none'; script-src 'self'" in policy
            assert "frame-ancestors 'none'" in policy
        for path in ("/../web.py", "/%2e%2e/web.py", "/vendor/", "/nothing.js"):
            assert " 404 " in await answered(host, [f"GET {path} HTTP/1.1", f"Host: {host}"])
        with pytest.raises(websockets.InvalidStatus):
            await websockets.connect(f"ws://{host}/elsewhere")
    assert not [record for record in caplog.records if record.exc_info]


@pytest.mark.long
async def test_a_wrong_token_is_refused_and_no_token_makes_an_observer(tmp_path):
    async with served(tmp_path, token=TOKEN) as (console, host):
        with pytest.raises(websockets.InvalidStatus):
            await websockets.connect(live(host, token="guessed"))
        assert console.core.counters["turned_away"] == 1
        async with websockets.connect(live(host)) as observer:
            hello = await told(observer, "hello")
            assert (hello["operator"], hello["token_needed"]) == (False, True)
            await observer.send(
                json.dumps({"type": "lease", "id": "1", "sent_ms": 0, "robot": "fr", "action": "take"})
            )
            assert "observer" in (await told(observer, "ack"))["text"]
        async with websockets.connect(live(host, token=TOKEN, name="desk")) as operator:
            hello = await told(operator, "hello")
            assert (hello["operator"], hello["client"]) == (True, "desk")


async def test_each_console_process_has_its_own_id_for_browsers(tmp_path):
    told_by = []
    for _ in range(2):
        async with served(tmp_path) as (_, host):
            for _ in range(2):
                async with websockets.connect(live(host)) as browser:
                    told_by.append((await told(browser, "hello"))["console"])
    one, again, other, _ = told_by
    assert one == again
    assert one != other


async def test_garbage_ends_neither_the_connection_nor_the_service(tmp_path):
    async with served(tmp_path) as (console, host):
        async with websockets.connect(live(host), origin=f"http://{host}") as browser:
            for garbage in ("", "{", b"\xff\x00", '{"type": "jog"}', "x" * 60_000):
                await browser.send(garbage)
                assert (await told(browser, "ack"))["outcome"] == "refused"
            await browser.send(json.dumps({"type": "ping", "id": "p", "sent_ms": 5.0}))
            assert (await told(browser, "pong"))["sent_ms"] == 5.0
        assert console.core.counters["malformed"] == 5


async def test_text_that_is_not_utf_8_ends_its_connection_and_is_counted_without_a_traceback(
    tmp_path, caplog
):
    caplog.set_level("WARNING")
    async with served(tmp_path) as (console, host), websockets.connect(live(host)) as other:
        async with websockets.connect(live(host)) as browser:
            await browser.send(b"\xff\xfe{", text=True)
            with pytest.raises(websockets.ConnectionClosed) as closed:
                await told(browser, "never")
        assert closed.value.rcvd.code == 1007
        assert console.core.counters["malformed"] == 1
        assert await told(other, "status")
    assert not caplog.records


@pytest.mark.long
async def test_an_oversized_message_ends_only_its_connection(tmp_path):
    async with (
        served(tmp_path) as (_, host),
        websockets.connect(live(host)) as other,
        websockets.connect(live(host)) as browser,
    ):
        await browser.send("x" * 200_000)
        with pytest.raises(websockets.ConnectionClosed):
            await told(browser, "never")
        assert await told(other, "status")


async def test_a_stop_without_an_hli_is_requested_and_not_confirmed(tmp_path):
    async with served(tmp_path) as (_, host), websockets.connect(live(host)) as browser:
        await browser.send('{"type": "stop", "id": "s"}')
        assert (await told(browser, "ack"))["outcome"] == "asked"
        status = await told(browser, "status")
        assert (status["stop"], status["hli"]) == ("asked", False)


@pytest.mark.long
async def test_a_disconnected_browser_is_forgotten(tmp_path):
    async with served(tmp_path) as (console, host):
        async with websockets.connect(live(host)) as browser:
            await told(browser, "hello")
            assert len(console.core.clients) == 1
        async with websockets.connect(live(host)) as browser:
            assert (await told(browser, "status"))["clients"] == 1


@pytest.mark.long
async def test_a_used_port_is_an_error_without_a_substitute(tmp_path):
    async with served(tmp_path) as (_, host):
        settings = Settings("lab", True, "127.0.0.1", int(host.split(":")[1]))
        with pytest.raises(ServiceUnreachableError, match=f"{host}: .*in use"):
            listening_socket(settings)


def test_an_address_beyond_this_machine_needs_a_token():
    here = Settings("lab", True, "127.0.0.1", free_ports(1)[0])
    for address in ("0.0.0.0", "192.168.1.5", "::", "plant.example"):
        with pytest.raises(NoTokenError, match=address):
            replace(here, address=address)
        assert replace(here, address=address, token=TOKEN).token_needed
    for address in ("127.0.0.2", "::1", "localhost"):
        assert not replace(here, address=address).token_needed


def test_guesses_beyond_three_a_second_of_an_address_are_not_compared():
    counters = Counter()
    door = Door(Settings("lab", True, "0.0.0.0", 7480, TOKEN), counters)
    found = [door.look(f"guess {n}", "10.0.0.9", n / 1000) for n in range(900)]
    assert found[:3] == [Entrance.WRONG] * 3
    assert counters["tokens_wrong"] <= 6
    assert counters["tokens_wrong"] + counters["tokens_not_compared"] == 900
    # not even the right one, which a guess might be; it is from elsewhere, and a moment later
    assert door.look(TOKEN, "10.0.0.9", 0.9) is Entrance.NOT_COMPARED
    assert door.look(TOKEN, "10.0.0.8", 0.9) is Entrance.OPERATOR
    assert door.look(TOKEN, "10.0.0.9", 2.0) is Entrance.OPERATOR
    assert door.look("", "10.0.0.9", 0.9) is Entrance.OBSERVER


async def test_each_wrong_token_is_logged_with_its_address(tmp_path, caplog):
    async with served(tmp_path, token=TOKEN) as (console, host):
        for guess in range(4):
            with pytest.raises(websockets.InvalidStatus):
                await websockets.connect(live(host, token=f"guessed{guess}"))
        assert console.core.counters["tokens_wrong"] >= 3
    said = [record.getMessage() for record in caplog.records if "wrong token" in record.getMessage()]
    assert len(said) == console.core.counters["tokens_wrong"]
    assert all("127.0.0.1" in line and "guessed" not in line for line in said)


def test_a_token_that_can_be_guessed_is_refused():
    with pytest.raises(NoTokenError, match="15 characters, at least 16"):
        Settings("lab", True, "0.0.0.0", 7480, "x" * 15)


async def test_requests_before_the_session_wait_for_it():
    link = HliLink(f"tcp/127.0.0.1:{free_ports(1)[0]}", "lab", ("fr",), None)
    asking = asyncio.ensure_future(link.asking())
    async with link:
        assert await asking is await link.asking()


@pytest.mark.long
async def test_failing_commands_and_ticks_are_reported_and_the_browser_stays_connected(
    tmp_path, monkeypatch, caplog
):
    async with served(tmp_path) as (console, host), websockets.connect(live(host)) as browser:
        monkeypatch.setattr(console.core, "_command", lambda *_: 1 / 0)
        monkeypatch.setattr(console.core.picture, "frame", lambda _: 1 / 0)
        await told(browser, "hello")
        for id_ in ("a", "b"):
            await browser.send(
                json.dumps({"type": "lease", "id": id_, "sent_ms": 0, "robot": "fr", "action": "take"})
            )
            ack = await told(browser, "ack")
            assert (ack["id"], ack["outcome"]) == (id_, "refused")
            assert ack["text"] == EXPLANATIONS[ReasonCode.INTERNAL_ERROR]
        while console.core.counters["internal_errors"] < 3:  # a tick
            await asyncio.sleep(0)
        monkeypatch.undo()
        while not isinstance(await browser.recv(), bytes):
            pass
    assert caplog.text.count("ZeroDivisionError") == 2
