"""The exporter beside a real HLI, read as Prometheus reads it."""

import ast
import asyncio
import json
import re
import socket
import urllib.request
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest
from guarded_peer import GuardedPeer, guarded_peer
from json_client import json_client
from prometheus_client.parser import text_string_to_metric_families
from small_cell import server_state, small_cell, told, tool_pose

import deltaq_services
from deltaq_protocol import topics
from deltaq_protocol.client import connect
from deltaq_protocol.codec import pack
from deltaq_services.hli.shell import Hli
from deltaq_services.metrics.shell import Delays, Exporter
from reference_pages.counters import CONSOLE, COUNTERS, HLI, ROBOT_SERVER, SIM

DASHBOARD = Path(__file__).parents[2] / "deploy" / "grafana" / "deltaq.json"

Samples = dict[tuple[str, tuple[tuple[str, str], ...]], float]


class Reader:
    """What Prometheus sees."""

    def __init__(self, url: str) -> None:
        self._url = url

    async def read(self) -> Samples:
        text = await asyncio.to_thread(self._get)
        return {
            (sample.name, tuple(sorted(sample.labels.items()))): sample.value
            for family in text_string_to_metric_families(text)
            for sample in family.samples
        }

    async def until(self, reached: Callable[[Samples], bool]) -> Samples:
        async with asyncio.timeout(300):
            while not reached(read := await self.read()):
                await asyncio.sleep(0.02)
        return read

    def _get(self) -> str:
        with urllib.request.urlopen(self._url, timeout=300) as answer:
            text: str = answer.read().decode()
        return text


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port: int = listening.getsockname()[1]
    return port


@asynccontextmanager
async def exported(hli: str) -> AsyncIterator[Reader]:
    port = free_port()
    serving = asyncio.create_task(Exporter(hli).run("127.0.0.1", port))
    await asyncio.sleep(0)  # it listens as soon as it runs
    try:
        yield Reader(f"http://127.0.0.1:{port}/metrics")
    finally:
        serving.cancel()
        await asyncio.wait([serving])


@asynccontextmanager
async def running() -> AsyncIterator[tuple[GuardedPeer, Reader]]:
    cell = small_cell()
    async with (
        guarded_peer(cell) as peer,
        Hli(cell, told(cell), tool_pose),
        exported(cell.hli) as reader,
    ):
        await peer.turn()
        await reader.until(is_up)
        yield peer, reader


def is_up(read: Samples) -> bool:
    return value(read, "deltaq_up") == 1.0


def value(read: Samples, sample: str, /, **labels: str) -> float | None:
    return read.get((sample, tuple(sorted(labels.items()))))


async def test_metrics_show_the_status_and_the_delays_of_verdicts() -> None:
    async with running() as (peer, reader), connect(peer.cell.hli, "test") as cell, cell.lease("fr") as robot:
        for _ in range(3):
            await peer.turn()
            await robot.move([0.0] * 6)
        read = await reader.until(
            lambda read: (value(read, "deltaq_verdict_delay_seconds_count", robot="fr") or 0) >= 1
        )
        assert value(read, "deltaq_verdicts_total", outcome="admitted") == 3
        assert value(read, "deltaq_phase", robot="fr", phase="ready") == 1
        assert value(read, "deltaq_phase", robot="fr", phase="held") == 0
        assert value(read, "deltaq_leased", robot="fr") == 1
        assert value(read, "deltaq_cycles_total", robot="fr") == peer.cycle
        assert value(read, "deltaq_counter_total", service="hli", robot="", name="leases_granted") == 1
        assert value(read, "deltaq_cell_info", cell=peer.cell.cell, identity=cell.description.identity) == 1


async def test_refusals_are_counted_by_reason() -> None:
    async with running() as (peer, reader), json_client(peer.cell.tcp_port) as rude:
        cycle = await peer.turn()
        rude.send(type="increment", robot="fr", seq=1, cycle=cycle, dq=[0.0] * 6)
        await rude.receive("verdict")
        assert value(await reader.read(), "deltaq_refusals_total", reason="lease_not_held") == 1


async def test_refused_attempts_are_counted_by_action_and_reason() -> None:
    async with running() as (peer, reader), json_client(peer.cell.tcp_port) as rude:
        for _ in range(2):
            await rude.ask("error", type="reset", robot="nobody")
        rude.send(type="increment", robot="fr", seq=1, cycle=await peer.turn(), dq=[0.0] * 6)
        await rude.receive("verdict")
        read = await reader.read()
        refused = {labels: n for (name, labels), n in read.items() if name == "deltaq_attempts_refused_total"}
        assert refused == {
            (("reason", "unknown_robot"), ("what", "reset")): 2,
            (("reason", "lease_not_held"), ("what", "increment")): 1,
        }


async def test_stale_messages_of_the_guarded_realm_are_counted_by_refusing_service() -> None:
    async with running() as (peer, reader):
        key = topics.SERVER_STATE.key(peer.cell.cell, robot="fr")
        once = peer._envelopes[peer._servers["fr"]].close(key, pack(server_state("fr")))

        def repeat_and_look(read: Samples) -> bool:
            peer._sim.put(key, once)
            return bool(value(read, "deltaq_guarded_refused_total", service="hli", robot="", cause="stale"))

        await reader.until(repeat_and_look)


async def test_braked_cycles_are_counted_by_cause() -> None:
    async with running() as (peer, reader):
        counted = {"braked_cycles": 7, "braked_cycles_no_admission": 5, "braked_cycles_operator_stop": 2}

        def told(read: Samples) -> dict[str | None, float]:
            peer.publish_state("fr", counters=counted)
            return {
                dict(labels).get("cause"): n
                for (name, labels), n in read.items()
                if name == "deltaq_braked_cycles_total" and dict(labels)["robot"] == "fr"
            }

        await reader.until(lambda read: told(read) == {"no_admission": 5, "operator_stop": 2})


async def test_clients_are_counted_over_zenoh_and_over_lines() -> None:
    """The exporter is one of those over zenoh."""

    def connected(sessions: int, lines: int) -> Callable[[Samples], bool]:
        return lambda read: (
            (value(read, "deltaq_zenoh_sessions"), value(read, "deltaq_tcp_connections")) == (sessions, lines)
        )

    async with running() as (peer, reader):
        await reader.until(connected(1, 0))
        async with connect(peer.cell.hli, "one"), connect(peer.cell.hli, "two"):
            await reader.until(connected(3, 0))
            async with json_client(peer.cell.tcp_port):
                await reader.until(connected(3, 1))
        await reader.until(connected(1, 0))


async def test_no_label_contains_a_clients_name() -> None:
    name = 'stranger"}\ndeltaq_up 7\n'
    async with running() as (peer, reader), json_client(peer.cell.tcp_port, name=name) as client:
        assert (await client.ask("lease", type="lease", robot="fr", action="acquire"))["granted"]
        read = await reader.read()
        assert is_up(read)
        assert value(read, "deltaq_leased", robot="fr") == 1
        assert not any("stranger" in text for _, labels in read for _, text in labels)


async def test_a_lost_hli_is_reported_and_found_again() -> None:
    cell = small_cell()
    async with exported(cell.hli) as reader:
        read = await reader.read()
        assert value(read, "deltaq_up") == 0
        assert value(read, "deltaq_cell_info") is None
        for _ in range(2):
            async with guarded_peer(cell) as peer, Hli(cell, told(cell), tool_pose):
                await peer.turn()
                await reader.until(is_up)
            await reader.until(lambda read: not is_up(read))


async def test_a_used_port_is_an_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listening, pytest.raises(OSError, match="in use"):
        await Exporter("tcp/127.0.0.1:1").run("127.0.0.1", listening.getsockname()[1])


def test_a_verdict_on_an_unknown_cycle_has_no_delay() -> None:
    delays = Delays()
    assert delays.state(5, 1.0) is None
    assert delays.verdict(4, 1.1) is None
    assert delays.verdict(5, 1.25) == 0.25
    assert delays.state(6, 1.5) == 0.5
    for cycle in range(100, 200):
        delays.state(cycle, 2.0)
    assert delays.verdict(6, 2.0) is None


async def test_every_sample_of_the_dashboard_exists_in_the_exporter() -> None:
    board = json.loads(DASHBOARD.read_text(encoding="utf-8"))
    asked = {
        name
        for panel in board["panels"]
        for target in panel["targets"]
        for name in re.findall(r"deltaq_\w+", target["expr"])
    }
    assert len(board["panels"]) == 14
    async with (
        running() as (peer, reader),
        json_client(peer.cell.tcp_port) as rude,
        connect(peer.cell.hli, "test") as cell,
        cell.lease("fr") as robot,
    ):
        await peer.turn()
        await robot.move([0.0] * 6)
        rude.send(type="increment", robot="fr", seq=1, cycle=1, dq=[0.0] * 6)
        await rude.receive("verdict")
        await peer.turn()  # the time between two states takes two
        # what this peer never does: it brakes and holds nobody, says nothing twice, and its gate judges nothing
        silent = {
            "deltaq_braked_cycles_total",
            "deltaq_held_total",
            "deltaq_admissions_not_taken_total",
            "deltaq_gate_reasons_total",
            "deltaq_guarded_refused_total",
            "deltaq_clearance_metres",
        }
        await reader.until(lambda read: asked - {name for name, _ in read} <= silent)


# Everything that a service counts is explained, and nothing is explained that nobody counts.

SERVICES = Path(deltaq_services.__path__[0])
COUNTED_BY_VARIABLE = {
    "decision.outcome": "{outcome}",
    "Outcome.REFUSED": "{outcome}",
    "why": "{refusal}",
    "who": "{sender}",
}
"""Counters whose whole name is in a variable, and their rows."""


def counted(source: str) -> Iterator[str]:
    """Names of the counters that a program has, each variable part as `{}`."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Subscript) and ast.unparse(node.value).endswith("counters"):
            yield name_of(node.slice)
        elif isinstance(node, ast.Call) and ast.unparse(node.func) == "Counter":
            yield from (name_of(made.key) for made in node.args if isinstance(made, ast.DictComp))


def name_of(key: ast.expr) -> str:
    if isinstance(key, ast.Constant):
        return str(key.value)
    if isinstance(key, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in key.values)
    return without_names(COUNTED_BY_VARIABLE.get(ast.unparse(key), f"a variable: {ast.unparse(key)}"))


def without_names(template: str) -> str:
    return re.sub(r"\{\w+\}", "{}", template)


@pytest.mark.parametrize("service", [HLI, SIM, ROBOT_SERVER, CONSOLE])
def test_every_counter_has_a_row_and_every_row_a_counter(service: str) -> None:
    sources = [file.read_text() for file in (SERVICES / service).glob("*.py")]
    in_code = {name for source in sources for name in counted(source)}
    in_table = {without_names(row.name) for row in COUNTERS if row.service == service}
    assert in_code == in_table, "see tools/reference_pages/counters.py"
