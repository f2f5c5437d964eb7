"""The client against a real HLI over real zenoh; the guarded realm is played by a peer."""

import asyncio
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import msgpack
import pytest
import zenoh
from guarded_peer import GuardedPeer, guarded_peer
from small_cell import endpoint, small_cell, told, tool_pose

from deltaq_protocol import connect, topics
from deltaq_protocol.client import Cell
from deltaq_protocol.codec import pack
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.leased_robot import VERDICT_DEADLINE_S, LeasedRobot
from deltaq_protocol.messages import PROTOCOL_VERSION, Increment, Outcome, Phase, Verdict
from deltaq_protocol.reasons import ReasonCode
from deltaq_protocol.session import open_session
from deltaq_services.hli.shell import Hli

DQ = (0.001,) * 6


class Running:
    """A running HLI, its peer, which turns in the cell's cycle, and a client."""

    def __init__(self, hli: Hli, peer: GuardedPeer, cell: Cell) -> None:
        self.hli = hli
        self.peer = peer
        self.cell = cell

    async def commanded(self) -> Any:
        """The next command that the gate got."""
        async with asyncio.timeout(300):
            return await self.peer.commands.get()


@asynccontextmanager
async def turning(peer: GuardedPeer) -> AsyncIterator[None]:
    await peer.turn()
    cycles = asyncio.create_task(peer.run())
    try:
        yield
    finally:
        cycles.cancel()


async def move_for_ever(robot: LeasedRobot) -> None:
    while True:
        await robot.move(DQ)


@pytest.fixture
async def running() -> AsyncIterator[Running]:
    description = small_cell()
    async with (
        guarded_peer(description) as peer,
        Hli(description, told(description), tool_pose) as hli,
        turning(peer),
        connect(description.hli, client="tester") as cell,
    ):
        yield Running(hli, peer, cell)


# --- what goes wrong ---------------------------------------------------------------------------------


async def test_connecting_without_a_listener_fails_with_address_and_remedy() -> None:
    nowhere = endpoint()
    with pytest.raises(ServiceUnreachableError, match=f"{nowhere}.*is the cell up"):
        async with connect(nowhere):
            pass


async def test_a_peer_without_a_cell_is_not_a_server(opened) -> None:
    somewhere = endpoint()
    opened(listen=[somewhere])
    with pytest.raises(ServiceUnreachableError, match="serves no cell"):
        async with connect(somewhere):
            pass


async def test_a_server_of_another_version_is_refused_despite_unknown_fields(opened) -> None:
    somewhere = endpoint()
    session = opened(listen=[somewhere])
    key = topics.DESCRIPTION.key("other")

    def answer(query: zenoh.Query) -> None:
        with query:
            query.reply(key, msgpack.packb({"protocol": PROTOCOL_VERSION + 1, "a_field_of_the_next": 1}))

    session.declare_queryable(key, answer)
    with pytest.raises(RefusedError, match="server speaks protocol 4, this client 3") as refused:
        async with connect(somewhere):
            pass
    assert refused.value.code == ReasonCode.PROTOCOL_VERSION


@pytest.mark.parametrize(
    ("dq", "code"),
    [
        ((math.nan,) * 6, ReasonCode.NOT_FINITE),
        ((0.0,) * 7, ReasonCode.BAD_SHAPE),
        ((), ReasonCode.BAD_SHAPE),
    ],
)
async def test_a_bad_increment_is_refused_and_the_next_one_admitted(
    running: Running, dq: tuple[float, ...], code: ReasonCode
) -> None:
    async with running.cell.lease("fr") as robot:
        verdict = await robot.move(dq)
        assert (verdict.outcome, verdict.reasons[0].code, verdict.dq) == (Outcome.REFUSED, code, ())
        assert (await robot.move(DQ)).outcome is Outcome.ADMITTED


async def test_a_held_lease_is_refused_with_the_holder_and_a_hint(running: Running) -> None:
    async with running.cell.lease("fr", client="first"):
        with pytest.raises(RefusedError, match="first holds it") as refused:
            async with running.cell.lease("fr", client="second"):
                pass
        assert refused.value.code == ReasonCode.LEASE_TAKEN
        assert "take=True" in refused.value.hint


async def test_an_unknown_robot_is_refused_with_the_known_ones(running: Running) -> None:
    with pytest.raises(RefusedError, match="fr, gr"):
        async with running.cell.lease("ghost"):
            pass
    with pytest.raises(RefusedError, match="ghost"):
        await anext(running.cell.states("ghost"))


async def test_a_revoked_lease_raises_in_move_and_states_and_leaving_does_not_disturb_the_new_holder(
    running: Running,
) -> None:
    async with running.cell.lease("fr", client="first") as first:
        await first.move(DQ)
        async with running.cell.lease("fr", client="second", take=True) as second:
            with pytest.raises(RefusedError, match="second holds it now"):
                await first.move(DQ)
            with pytest.raises(RefusedError, match="lease of fr was lost"):
                async for _ in first.states():
                    pass
            await first.release()
            assert (await second.move(DQ)).outcome is Outcome.ADMITTED


async def test_a_foreign_increment_with_our_number_does_not_take_our_verdict(
    running: Running,
) -> None:
    running.peer.judges = False
    async with running.cell.lease("fr") as robot:
        move = asyncio.create_task(robot.move(DQ))
        async with asyncio.timeout(300):
            request = await running.peer.increments.get()
        forged = Increment(robot="fr", seq=request.seq, cycle=request.cycle, dq=DQ, lease="guessed")
        intruder = await asyncio.to_thread(open_session, connect=[running.hli._cell.hli], must_connect=True)
        intruder.put(topics.INCREMENT.key("small", robot="fr"), pack(forged))
        await counted(running, "increments_unproven")
        running.peer.judge(request)
        assert (await move).outcome is Outcome.ADMITTED
        await asyncio.to_thread(intruder.close)


async def counted(running: Running, name: str) -> None:
    """Wait until the HLI has counted something of that name."""
    async with asyncio.timeout(300):
        while not running.hli.status().hli.get(name):
            await asyncio.sleep(0.005)


async def test_an_increment_on_the_key_of_another_robot_is_refused(running: Running) -> None:
    session = await asyncio.to_thread(open_session, connect=[running.hli._cell.hli], must_connect=True)
    async with running.cell.lease("fr") as robot:
        stray = pack(Increment(robot="fr", seq=1, cycle=running.peer.cycle, dq=DQ))
        key = topics.INCREMENT.key("small", robot="gr")
        session.put(key, stray, attachment=robot.lease.prover.prove(key, stray))
        await counted(running, "increments_unproven")
    async with running.cell.lease("gr") as other:
        session.put(key, stray, attachment=other.lease.prover.prove(key, stray))
        await counted(running, "malformed")
    await asyncio.to_thread(session.close)
    assert running.peer.increments.empty()


async def test_a_lost_verdict_raises_in_move_and_the_next_move_succeeds(running: Running) -> None:
    running.peer.judges = False
    async with running.cell.lease("fr") as robot:
        lost = await robot.move(DQ)
        assert (lost.seq, lost.outcome, lost.dq) == (1, Outcome.UNKNOWN, ())
        assert (lost.reasons[0].code, lost.reasons[0].bound) == (ReasonCode.UNREACHABLE, VERDICT_DEADLINE_S)
        running.peer.judges = True
        answered = await robot.move(DQ)  # which a busy machine may have refused for the age of its state
        assert (answered.seq, answered.outcome is Outcome.UNKNOWN) == (2, False)


async def test_a_lost_verdict_is_missing_in_the_stream(running: Running) -> None:
    async with running.cell.lease("fr") as robot:
        verdicts = robot.verdicts()
        for judges in (True, False, True):
            running.peer.judges = judges
            seq = await robot.send(DQ)
            async with asyncio.timeout(300):
                assert (await running.peer.increments.get()).seq == seq
        async with asyncio.timeout(300):
            assert [(await anext(verdicts)).seq for _ in range(2)] == [1, 3]


@pytest.mark.long
async def test_a_client_that_reads_no_verdicts_keeps_the_newest(running: Running) -> None:
    async with running.cell.lease("fr") as robot:
        for seq in range(1, 1501):
            await robot.send(DQ)
            verdict = Verdict(robot="fr", cycle=1, seq=seq, outcome=Outcome.ADMITTED, dq=DQ)
            robot.take_verdict(verdict)
        assert (await anext(robot.verdicts())).seq == 1500 - 1024 + 1


async def test_a_verdict_on_an_unsent_increment_is_ignored(running: Running) -> None:
    async with running.cell.lease("fr") as robot:
        foreign = Verdict(robot="fr", cycle=1, seq=77, outcome=Outcome.ADMITTED, dq=DQ)
        robot.take_verdict(foreign)
        assert await robot.send(DQ) == 1
        assert (await anext(robot.verdicts())).seq == 1


async def test_a_revoked_lease_raises_in_send_and_verdicts(running: Running) -> None:
    async with running.cell.lease("fr", client="first") as first:
        await first.send(DQ)
        assert (await anext(first.verdicts())).outcome is Outcome.ADMITTED
        async with running.cell.lease("fr", client="second", take=True):
            await first.send(DQ)
            with pytest.raises(RefusedError, match="second holds it now"):
                await anext(first.verdicts())
            with pytest.raises(RefusedError, match="second holds it now"):
                await first.send(DQ)


async def test_sending_without_a_received_state_raises(running: Running) -> None:
    async with running.cell.lease("gr") as robot:
        for ask in (robot.move, robot.send):
            with pytest.raises(ServiceUnreachableError, match="no state of gr"):
                await ask((0.0,) * 9)


async def test_waiting_for_states_raises_if_the_server_ends() -> None:
    description = small_cell()
    async with guarded_peer(description) as peer:
        hli = Hli(description, told(description), tool_pose)
        await hli.__aenter__()
        async with connect(description.hli) as cell:
            await peer.turn()
            await hli.__aexit__()
            with pytest.raises(ServiceUnreachableError, match="is the cell up"):
                async for _ in cell.states("fr"):
                    pass


async def test_a_restarted_server_is_found_again_and_voids_the_old_lease() -> None:
    description = small_cell()
    async with guarded_peer(description) as peer:
        hli = Hli(description, told(description), tool_pose)
        await hli.__aenter__()
        async with turning(peer), connect(description.hli) as cell, cell.lease("fr") as old:
            await old.move(DQ)
            await hli.__aexit__()
            async with Hli(description, told(description), tool_pose):
                with pytest.raises((RefusedError, ServiceUnreachableError)):
                    await move_for_ever(old)
                await anext(cell.states("fr"))
                async with cell.lease("fr") as new:
                    await new._newest.after(new._newest.read()[1], 10)
                    assert (await new.move(DQ)).outcome is Outcome.ADMITTED


# --- leaving ----------------------------------------------------------------------------------------


class _OwnError(Exception):
    pass


@pytest.mark.parametrize("road", ["end", "error", "cancel"])
async def test_every_exit_from_the_block_releases_the_lease_without_holding_the_robot(
    running: Running, road: str
) -> None:
    inside = asyncio.Event()

    async def controller() -> None:
        async with running.cell.lease("fr") as robot:
            await robot.move(DQ)
            inside.set()
            if road == "error":
                raise _OwnError
            if road == "cancel":
                await asyncio.Event().wait()

    task = asyncio.create_task(controller())
    await inside.wait()
    if road == "cancel":
        task.cancel()
    (result,) = await asyncio.gather(task, return_exceptions=True)
    assert isinstance(result, {"end": type(None), "error": _OwnError, "cancel": asyncio.CancelledError}[road])
    status = await running.cell.status()
    assert status.robots["fr"].lease.holder is None
    assert running.peer.commands.empty()


async def test_a_cell_and_a_lease_are_opened_and_closed_without_a_block(running: Running) -> None:
    connection = connect(running.hli._cell.hli, client="notebook")
    cell = await connection.open()
    lease = cell.lease("fr")
    robot = await lease.open()
    assert (await robot.move(DQ)).outcome is Outcome.ADMITTED
    assert (await cell.status()).robots["fr"].lease.holder == "notebook"
    await lease.close()
    await lease.close()
    assert (await running.cell.status()).robots["fr"].lease.holder is None
    await connection.close()
    await connection.close()
    assert running.peer.commands.empty()


async def test_closing_the_connection_releases_its_leases_first(running: Running) -> None:
    connection = connect(running.hli._cell.hli, client="notebook")
    cell = await connection.open()
    robot = await cell.lease("fr").open()
    await robot.move(DQ)
    await connection.close()
    assert (await running.cell.status()).robots["fr"].lease.holder is None
    assert running.peer.commands.empty()
    with pytest.raises(RefusedError, match="was released"):
        await robot.send(DQ)


async def test_after_the_block_the_robot_can_no_longer_be_moved(running: Running) -> None:
    async with running.cell.lease("fr") as robot:
        await robot.move(DQ)
    with pytest.raises(RefusedError, match="was released"):
        await robot.move(DQ)


async def test_a_client_that_vanishes_while_it_moves_a_robot_stops_it(running: Running) -> None:
    async with connect(running.hli._cell.hli, client="doomed") as doomed, doomed.lease("fr") as robot:
        await robot.move(DQ)
        await asyncio.to_thread(doomed._wire.close)  # without a word, as a kill would
        command = await running.commanded()
    assert (command.robot, command.reason) == ("fr", ReasonCode.CONTROLLER_LOST)


# --- what goes right ---------------------------------------------------------------------------------


async def test_a_controller_answers_states_with_increments_and_gets_the_admitted_ones(
    running: Running,
) -> None:
    async with running.cell.lease("fr") as robot:
        moved = 0
        async for state in robot.states():
            verdict = await robot.move(DQ)
            assert verdict.cycle >= state.cycle
            assert verdict.dq == DQ
            moved += 1
            if moved == 20:
                break
    seqs = [running.peer.increments.get_nowait().seq for _ in range(20)]
    assert seqs == list(range(1, 21))


async def test_a_non_blocking_controller_sends_one_increment_a_cycle_and_gets_every_verdict(
    running: Running,
) -> None:
    async with running.cell.lease("fr") as robot:
        sent = []
        async for _ in robot.states():
            sent.append(await robot.send(DQ))
            if len(sent) == 50:
                break
        verdicts = robot.verdicts()
        async with asyncio.timeout(300):
            got = [await anext(verdicts) for _ in sent]
    assert sorted(verdict.seq for verdict in got) == sent == list(range(1, 51))


@pytest.mark.long
async def test_the_client_renews_its_lease_automatically(running: Running) -> None:
    async with running.cell.lease("fr") as robot:
        until = asyncio.get_running_loop().time() + 1.6 * running.hli._cell.lease_s
        async for _ in robot.states():
            if asyncio.get_running_loop().time() > until:
                break
        async for _ in robot.states():
            verdict = await robot.move(DQ)  # raises without the lease
            if verdict.outcome is Outcome.ADMITTED:
                break
            # on a machine that stood still the HLI's state may be old
            assert [reason.code for reason in verdict.reasons] == [ReasonCode.NOT_READY]


async def test_a_slow_reader_of_states_skips_to_the_newest(running: Running) -> None:
    states = running.cell.states("fr")
    first = await anext(states)
    async with asyncio.timeout(300):
        while running.peer.cycle < first.cycle + 20:
            await asyncio.sleep(0.01)
    second = await anext(states)
    assert second.cycle >= first.cycle + 15


async def test_stop_reset_and_status_are_answered_from_the_running_cell(running: Running) -> None:
    assert (await running.cell.stop()).what == "stop"
    assert (await running.commanded()).reason is ReasonCode.OPERATOR_STOP
    running.peer.phases["fr"] = Phase.HELD
    running.peer.refuses = ReasonCode.NOT_AT_REST
    with pytest.raises(RefusedError, match=r"not_at_rest.*reset of fr refused"):
        await running.cell.reset("fr")
    running.peer.refuses = None
    assert (await running.cell.reset("fr")).what == "reset fr"
    async for state in running.cell.states("fr"):
        if state.phase is Phase.HELD:
            break
    status = await running.cell.status()
    assert (status.cell, status.robots["fr"].phase) == ("small", Phase.HELD)
    assert status.hli["stops"] == 1


async def test_the_description_suffices_to_model_the_cell(running: Running) -> None:
    assert running.cell.description.urdf == {"fr": "<robot/>", "gr": "<robot/>"}
    assert running.cell.robots["gr"].units == ("m",) * 3 + ("rad",) * 6
    assert running.cell.robots["fr"].max_increment[0] == pytest.approx(math.radians(90) * 0.012)


@pytest.mark.parametrize("lost", [{0}, {4}, {0, 1, 2, 3}, {1, 2, 3, 4}])
async def test_the_round_trip_is_measured_despite_lost_answers(
    running: Running, monkeypatch: pytest.MonkeyPatch, lost: set[int]
) -> None:
    asked, status = iter(range(5)), running.cell.status

    async def losing() -> Any:
        if next(asked) in lost:
            raise ServiceUnreachableError("no answer within 1 s")
        return await status()

    monkeypatch.setattr(running.cell, "status", losing)
    assert 0.0 < await running.cell.round_trip_s() < 1.0


async def test_without_any_answer_the_round_trip_is_unknown(
    running: Running, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    async def losing() -> Any:
        asked.append(1)
        raise ServiceUnreachableError("no answer within 1 s")

    monkeypatch.setattr(running.cell, "status", losing)
    with pytest.raises(ServiceUnreachableError):
        await running.cell.round_trip_s()
    assert len(asked) == 5


@pytest.mark.parametrize(("lost", "is_there"), [(1, True), (2, False)])
async def test_one_lost_question_does_not_count_as_a_lost_server(
    monkeypatch: pytest.MonkeyPatch, lost: int, is_there: bool
) -> None:
    description, asked, status = small_cell(), [], Cell.status

    async def losing(cell: Cell) -> Any:
        asked.append(1)
        if len(asked) <= lost:
            raise ServiceUnreachableError("no answer within 1 s")
        answer = await status(cell)
        await peer.turn()  # the silence ends
        return answer

    monkeypatch.setattr(Cell, "status", losing)
    async with (
        guarded_peer(description) as peer,
        Hli(description, told(description), tool_pose),
        connect(description.hli) as cell,
    ):
        if is_there:
            assert (await anext(cell.states("fr"))).robot == "fr"
        else:
            with pytest.raises(ServiceUnreachableError):
                await anext(cell.states("fr"))
    assert len(asked) == 2
