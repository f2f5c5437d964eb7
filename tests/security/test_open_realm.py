"""Strangers at the HLI's own port, over real zenoh: what they hear, and what is believed of what they say."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import msgpack
import pytest
import zenoh
from guarded_peer import guarded_peer
from json_client import json_client
from open_stranger import OpenStranger
from small_cell import endpoint, small_cell, told, tool_pose

from deltaq_protocol import connect, leased_robot, topics
from deltaq_protocol.codec import pack
from deltaq_protocol.errors import RefusedError
from deltaq_protocol.messages import (
    Increment,
    IoRequest,
    LeaseAction,
    LeaseRequest,
    Outcome,
    ResetRequest,
    RobotState,
    Verdict,
)
from deltaq_protocol.proof import Prover
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.session import open_session
from deltaq_services.hli import open_front
from deltaq_services.hli.authentication import Authentication
from deltaq_services.hli.client_roles import ClientRoles
from deltaq_services.hli.shell import Hli

OPERATOR = "the operator's token, 0123456789"
DQ = (0.001,) * 6
GHOST_Q = 0.777


class Running:
    """A running HLI whose robot FR turns, and the operator's client."""

    def __init__(self, hli: Hli, peer: Any, cell: Any, cycles: asyncio.Task[None]) -> None:
        self.hli, self.peer, self.cell, self._cycles = hli, peer, cell, cycles
        self.where = peer.cell.hli

    async def last_turn(self) -> int:
        """One cycle more and no other, so that it is of now however slow the machine is; returns it."""
        self._cycles.cancel()
        return int(await self.peer.turn())

    def token(self) -> str:
        lease = self.hli.core.leases.of("fr")
        assert lease is not None
        return lease.token

    async def stranger(self, mode: str = "client") -> OpenStranger:
        return await asyncio.to_thread(OpenStranger, self.where, "small", mode)


@asynccontextmanager
async def serving(controller_token: str | None = None) -> AsyncIterator[Running]:
    # who is slow here is the machine, and not the holder of a lease, nor a robot whose state is answered late
    cell = small_cell(lease_s=20.0, cycle_s=0.1, gate={"max_request_age_s": 1.0})
    roles = ClientRoles(OPERATOR, controller_token)
    async with guarded_peer(cell) as peer, Hli(cell, told(cell), tool_pose, roles) as hli:
        await peer.turn()
        cycles = asyncio.create_task(peer.run())
        async with connect(cell.hli, client="operator", token=OPERATOR) as client:
            yield Running(hli, peer, client, cycles)
        cycles.cancel()


@pytest.fixture
async def running() -> AsyncIterator[Running]:
    async with serving() as now:
        yield now


async def drive(running: Running) -> Verdict:
    """Everything that needs a secret, and then a motion; its verdict."""
    async with running.cell.lease("fr", take=True) as robot:
        await running.cell.reset("fr")
        await robot.io()
        await robot.lease.renew()
        for _ in range(5):
            verdict = await robot.move(DQ)
            assert verdict.outcome is Outcome.ADMITTED
        return verdict


def secrets_in(heard: list[bytes], tokens: list[str]) -> list[bytes]:
    """What a stranger could use, of what it heard: tokens, and whatever a client sent."""
    sent = (b"increment", b"lease", b"reset", *(token.encode() for token in tokens))
    return [message for message in heard if any(word in message for word in sent)]


async def overheard(running: Running, stranger: OpenStranger) -> list[bytes]:
    """What a stranger hears while the operator drives that is not for everybody."""
    tokens = [OPERATOR]
    driving = asyncio.create_task(drive(running))
    while running.hli.core.leases.of("fr") is None:
        await asyncio.sleep(0)
    tokens.append(running.token())
    last = await driving
    heard = await asyncio.to_thread(stranger.heard, pack(last))
    return secrets_in(heard, tokens)


@pytest.mark.by_day(1)
@pytest.mark.parametrize("mode", ["client", "peer", "router"])
async def test_an_eavesdropper_reads_no_token_no_increment_and_no_request(
    running: Running, mode: str
) -> None:
    stranger = await running.stranger(mode)
    assert await overheard(running, stranger) == []
    await asyncio.to_thread(stranger.close)


async def test_without_access_control_an_eavesdropper_reads_increments(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(open_front, "access", lambda *_: None)
    async with serving() as running:
        stranger = await asyncio.to_thread(OpenStranger, running.where, "small", answers=False)
        heard = await overheard(running, stranger)
        assert any(b"increment" in message for message in heard)
        assert not any(OPERATOR.encode() in message for message in heard)  # it is not sent at all
        await asyncio.to_thread(stranger.close)


@pytest.mark.by_day(1)
@pytest.mark.parametrize("mode", ["client", "peer", "router"])
async def test_forged_states_and_verdicts_reach_no_client(running: Running, mode: str) -> None:
    stranger = await running.stranger(mode)
    async with running.cell.lease("fr") as robot:
        await anext(running.cell.states("fr"))
        verdicts = running.cell.verdicts("fr")
        seen: list[Verdict] = []
        outcomes: list[Outcome] = []
        watching = asyncio.create_task(anext(verdicts))
        await asyncio.sleep(0)
        for _ in range(20):
            state = running.cell.state("fr")
            ghost = state.model_copy(update={"cycle": state.cycle + 1, "q": (GHOST_Q,) * 6})
            lie = Verdict(robot="fr", cycle=state.cycle, seq=10**6, outcome=Outcome.HELD)
            await asyncio.to_thread(stranger.say, topics.STATE, ghost, robot="fr")
            await asyncio.to_thread(stranger.say, topics.VERDICT, lie, robot="fr")
            outcomes.append((await robot.move(DQ)).outcome)
            newest: RobotState = running.cell.state("fr")
            assert GHOST_Q not in newest.q
            if watching.done():
                seen.append(watching.result())
                watching = asyncio.create_task(anext(verdicts))
        assert seen
        assert all(verdict.seq < 10**6 for verdict in seen)
        # where the machine is busy a verdict may be late, which a client tells from one that it got
        assert Outcome.ADMITTED in outcomes
        assert {*outcomes} <= {Outcome.ADMITTED, Outcome.UNKNOWN}
        watching.cancel()
    await asyncio.to_thread(stranger.close)


async def test_a_lease_token_without_a_valid_proof_achieves_nothing(running: Running) -> None:
    stranger = await running.stranger()
    async with running.cell.lease("fr") as robot:
        token, cycle = running.token(), running.peer.cycle
        key = topics.INCREMENT.key("small", robot="fr")
        increment = Increment(robot="fr", seq=10**6, cycle=cycle, dq=DQ, lease=token)
        for proof in (None, b"", b"short", bytes(32), token.encode(), bytes(10_000)):
            await asyncio.to_thread(stranger.say, topics.INCREMENT, increment, proof, robot="fr")
        elsewhere = Prover(token).prove(topics.INCREMENT.key("small", robot="gr"), pack(increment))
        await asyncio.to_thread(stranger.say, topics.INCREMENT, increment, elsewhere, robot="fr")
        another = Prover(token).prove(key, pack(increment) + b" ")
        await asyncio.to_thread(stranger.say, topics.INCREMENT, increment, another, robot="fr")
        assert running.hli.status().hli["increments_unproven"] == 8
        for action in (LeaseAction.RELEASE, LeaseAction.RENEW, LeaseAction.TAKE):
            request = LeaseRequest(robot="fr", action=action, lease=token, token=OPERATOR)
            reply = await asyncio.to_thread(stranger.ask, topics.LEASE, request, bytes(40), "fr")
            assert not msgpack.unpackb(reply.ok.payload.to_bytes())["granted"]
        outputs = IoRequest(robot="fr", outputs={}, lease=token)
        assert (await asyncio.to_thread(stranger.ask, topics.IO, outputs, None, "fr")).ok is not None
        reset = ResetRequest(robot="fr", token=OPERATOR)
        refused = await asyncio.to_thread(stranger.ask, topics.RESET, reset)
        assert msgpack.unpackb(refused.err.payload.to_bytes())["code"] == ReasonCode.NOT_PERMITTED
        assert (await robot.move(DQ)).outcome is Outcome.ADMITTED
    await asyncio.to_thread(stranger.close)


class Relay:
    """Sits where a client takes it for the HLI, hands on every query, and keeps a copy of each."""

    def __init__(self, where: str, hli: str) -> None:
        self._hli = open_session(connect=[hli], must_connect=True)
        self._session = open_session(listen=[where])
        self.recording: list[tuple[str, bytes, bytes]] = []
        self._session.declare_queryable("deltaq/**", self._hand_on)

    def _hand_on(self, query: Any) -> None:
        asked = (
            str(query.key_expr),
            query.payload.to_bytes() if query.payload else b"",
            query.attachment.to_bytes() if query.attachment else b"",
        )
        self.recording.append(asked)
        with query:
            reply = self.repeat(*asked)
            if reply.ok is None:
                query.reply_err(reply.err.payload.to_bytes())
            else:
                query.reply(reply.ok.key_expr, reply.ok.payload.to_bytes())

    def repeat(self, key: str, payload: bytes, proof: bytes) -> Any:
        (reply,) = self._hli.get(key, payload=payload, attachment=proof or None, timeout=300.0)
        return reply

    def close(self) -> None:
        self._session.close()
        self._hli.close()


async def test_an_eavesdropper_in_the_middle_learns_no_token_and_can_replay_nothing(
    running: Running,
) -> None:
    where = endpoint()
    relay = await asyncio.to_thread(Relay, where, running.where)
    async with connect(where, client="deceived", token=OPERATOR) as deceived:
        await deceived.reset("fr")
        async with deceived.lease("fr", take=True) as robot:
            await robot.io()
            await robot.lease.renew()
            kept = list(relay.recording)
            assert not any(OPERATOR.encode() in part for asked in kept for part in asked[1:])
            renewals = [asked for asked in kept if asked[2] and b"renew" in asked[1]]
            (reset,) = (asked for asked in kept if asked[0].endswith("/reset"))
            (take,) = (asked for asked in kept if b"take" in asked[1])
            said = await asyncio.to_thread(relay.repeat, *reset)
            assert msgpack.unpackb(said.err.payload.to_bytes())["code"] == ReasonCode.NOT_PERMITTED
            for asked in (take, *renewals):
                said = await asyncio.to_thread(relay.repeat, *asked)
                assert not msgpack.unpackb(said.ok.payload.to_bytes())["granted"], asked
            assert renewals
    await asyncio.to_thread(relay.close)


async def test_a_lease_over_tcp_is_valid_only_for_its_connection(running: Running) -> None:
    port = running.peer.cell.tcp_port
    async with json_client(port, "holder") as holder, json_client(port, "thief") as thief:
        granted = await holder.ask("lease", type="lease", robot="fr", action="acquire")
        assert granted["granted"]
        assert granted["lease"] is None
        token = running.token()
        line = {"type": "increment", "robot": "fr", "cycle": running.peer.cycle, "dq": list(DQ)}
        refused = await thief.ask("verdict", seq=1, lease=token, **line)
        assert refused["reasons"][0]["code"] == ReasonCode.LEASE_NOT_HELD
        for action in ("renew", "release"):
            reply = await thief.ask("lease", type="lease", robot="fr", action=action, lease=token)
            assert not reply["granted"]
        io = await thief.ask("io", type="io", robot="fr", outputs={"x": True}, lease=token)
        assert io["type"] == "error"
        line["cycle"] = await running.last_turn()
        assert (await holder.ask("verdict", seq=2, **line))["outcome"] == "admitted"


async def test_without_the_operator_token_a_client_neither_takes_nor_resets_a_robot(
    running: Running,
) -> None:
    for token in (None, "guessed"):
        async with connect(running.where, client="other", token=token) as other:
            with pytest.raises(RefusedError) as refused:
                await other.reset("fr")
            assert refused.value.code is ReasonCode.NOT_PERMITTED
            with pytest.raises(RefusedError):
                await other.lease("fr", take=True).open()
    assert running.peer.commands.empty()


async def test_each_role_has_exactly_its_permissions() -> None:
    token = "the controller's token"
    async with serving(token) as running:
        operator, cell = running.cell, running.peer.cell
        async with (
            connect(cell.hli, client="observer") as observer,
            connect(cell.hli, client="controller", token=token) as controller,
        ):
            with pytest.raises(RefusedError, match="not entitled"):
                await observer.lease("fr").open()
            async with controller.lease("fr") as robot:
                assert (await robot.move(DQ)).outcome is Outcome.ADMITTED
                with pytest.raises(RefusedError):
                    await controller.reset("fr")
                await observer.stop()  # anybody may
                await operator.reset("fr")
            async with json_client(cell.tcp_port) as line:
                asked = {"type": "lease", "robot": "fr", "action": "acquire"}
                assert not (await line.ask("lease", **asked))["granted"]
                io = await line.ask("io", type="io", robot="gr", outputs={"gripper": True})
                assert io["code"] == ReasonCode.LEASE_NOT_HELD
            async with json_client(cell.tcp_port, token=token) as line:
                assert (await line.ask("lease", **asked))["granted"]


async def test_tokens_cannot_be_guessed_over_tcp(running: Running, caplog: pytest.LogCaptureFixture) -> None:
    port = running.peer.cell.tcp_port
    for _ in range(50):
        async with json_client(port, name=None) as guesser:
            told_so = await guesser.ask("welcome", type="hello", protocol=1, client="guesser", token="guess")
            assert told_so["code"] == ReasonCode.NOT_PERMITTED
            await guesser.ended()
    counters = running.hli.status().hli
    assert counters["tokens_wrong"] + counters["tokens_not_compared"] == 50
    logged = [record.getMessage() for record in caplog.records if "wrong token" in record.getMessage()]
    assert len(logged) == counters["tokens_wrong"]
    assert "127.0.0.1" in logged[0]
    assert "guess" not in logged[0].replace("guesser", "")
    async with json_client(port) as line:  # without a token everybody may look on, and stop
        assert (await line.ask("done", type="stop"))["type"] == "done"


@pytest.mark.long
async def test_replayed_increments_do_not_use_up_the_rate_of_the_lease_holder(
    running: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The attack: an eavesdropper beside the holder's link has one increment with its proof, and repeats it."""
    overheard: list[tuple[bytes, bytes]] = []
    of = Authentication.holder_of_increment

    def listening(ours: Authentication, robot: str, key: str, message: bytes, proof: bytes) -> Any:
        overheard.append((message, proof))
        return of(ours, robot, key, message, proof)

    monkeypatch.setattr(Authentication, "holder_of_increment", listening)
    stranger = await running.stranger()
    async with running.cell.lease("fr") as robot:
        await robot.move(DQ)
        monkeypatch.undo()
        # an increment that is not judged is the failure; one that is judged late, on a busy machine, is none
        monkeypatch.setattr(leased_robot, "VERDICT_DEADLINE_S", 60.0)
        payload, proof = overheard[0]
        key, block = topics.INCREMENT.key("small", robot="fr"), zenoh.CongestionControl.BLOCK
        for _ in range(20):
            for _ in range(20):  # as many as ten cycles' share of the holder
                stranger.session.put(key, payload, attachment=proof, congestion_control=block)
            await asyncio.to_thread(stranger.wait)
            async with asyncio.timeout(300):
                assert (await robot.move(DQ)).outcome is Outcome.ADMITTED
    counters = running.hli.status().hli
    assert counters["increments_too_many"] >= 300
    await asyncio.to_thread(stranger.close)
