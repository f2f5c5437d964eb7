"""`drive` in a cell with a lookahead: against a real HLI over zenoh, whose guarded realm is played by a peer."""

import asyncio
import os
import signal
import time
from collections.abc import AsyncIterator, Callable
from contextlib import ExitStack, asynccontextmanager
from dataclasses import dataclass, field

import numpy as np
import pytest
from guarded_peer import GuardedPeer, guarded_peer
from served import Server
from small_cell import free_port, small_cell, told, tool_pose
from told import told_state, told_status

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.advisor.process import AdvisorProcess
from deltaq_controllers.answers import CatchUp, lease, own_view, view_of
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.live import ControlStatistics, drive
from deltaq_controllers.modes.advisor import tracker_of
from deltaq_controllers.robot_clocks import RobotClocks
from deltaq_controllers.task import Task
from deltaq_protocol import connect
from deltaq_protocol.arrays import Array
from deltaq_protocol.client import Cell
from deltaq_protocol.endpoint import Endpoint
from deltaq_protocol.errors import RefusedError, ServiceUnreachableError
from deltaq_protocol.messages import Outcome, RobotState, ToolPose, Verdict
from deltaq_services.hli.shell import Hli
from deltaq_testing.impairment.relay import TrafficUnit
from deltaq_testing.impairment.tcp import StreamFaults
from studies.live_faults.relay_process import RelayProcess

STEP = 1e-4
POSE = ToolPose(position=(0.0, 0.0, 0.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0))


@dataclass
class Running:
    """A running HLI, its peer and a client; `drive` moves the first joint of `fr`."""

    hli: Hli
    peer: GuardedPeer
    cell: Cell
    statistics: ControlStatistics = field(default_factory=ControlStatistics)
    seen: list[float] = field(default_factory=list)
    wanted: Callable[[], bool] = lambda: False
    reached: asyncio.Event = field(default_factory=asyncio.Event)

    def increment(self, view: View) -> Array:
        self.seen.append(float(view.own.q_cmd[0]))
        if self.wanted():
            self.reached.set()
        return np.array([STEP, *np.zeros(5)])

    @asynccontextmanager
    async def driving(self) -> AsyncIterator[asyncio.Task[None]]:
        task = asyncio.create_task(drive(self.cell, "fr", self, self.statistics))
        try:
            yield task
        finally:
            task.cancel()
            await asyncio.wait([task])

    async def until(self, wanted: Callable[[], bool]) -> None:
        """Go on until an increment is asked for while it is so."""
        self.wanted = wanted
        self.reached.clear()
        async with asyncio.timeout(300):
            await self.reached.wait()


@pytest.fixture
async def running() -> AsyncIterator[Running]:
    # who is slow here is the machine, and not the holder of a lease
    description = small_cell(gate={"lookahead_cycles": 3}, lease_s=20.0)
    async with (
        guarded_peer(description) as peer,
        Hli(description, told(description), tool_pose) as hli,
        connect(description.hli, client="tester") as cell,
    ):
        await peer.turn()
        cycles = asyncio.create_task(peer.run())
        yield Running(hli, peer, cell)
        cycles.cancel()


@pytest.mark.long
async def test_without_verdicts_every_state_is_answered_and_missing_verdicts_are_counted(
    running: Running,
) -> None:
    running.peer.judges = False
    async with running.driving():
        await running.until(lambda: running.statistics.unanswered >= 10)
    # those that are given up are not reckoned with: it never moved
    assert max(running.seen) <= running.seen[0] + 3 * STEP + 1e-12
    assert running.statistics.cycles == running.statistics.unanswered


async def test_after_lost_verdicts_it_continues_from_the_present_setpoint(running: Running) -> None:
    async with running.driving():
        await running.until(lambda: len(running.seen) > 10)
        running.peer.judges = False
        await running.until(lambda: running.statistics.unanswered > 3)
        running.peer.judges = True
        begun = len(running.seen)
        await running.until(lambda: len(running.seen) > begun + 20)
    assert running.statistics.summary()["gate"]["admitted"] > 10
    assert running.seen[-1] == pytest.approx(running.peer.q_cmd["fr"][0], abs=5 * STEP)


async def test_a_lost_lease_ends_it(running: Running) -> None:
    async with running.driving() as task:
        await running.until(lambda: len(running.seen) > 5)
        async with running.cell.lease("fr", client="second", take=True):
            async with asyncio.timeout(300):
                with pytest.raises(RefusedError, match="second holds it now"):
                    await task


async def test_a_lost_hli_ends_it() -> None:
    # who is slow here is the machine, and not the holder of a lease
    description = small_cell(gate={"lookahead_cycles": 3}, lease_s=20.0)
    async with guarded_peer(description) as peer:
        hli = Hli(description, told(description), tool_pose)
        await hli.__aenter__()
        async with connect(description.hli, client="tester") as cell:
            await peer.turn()
            cycles = asyncio.create_task(peer.run())
            running = Running(hli, peer, cell)
            async with running.driving() as task:
                await running.until(lambda: len(running.seen) > 5)
                await hli.__aexit__()
                async with asyncio.timeout(300):
                    with pytest.raises((RefusedError, ServiceUnreachableError)):
                        await task
            cycles.cancel()


@pytest.mark.long
async def test_each_increment_is_added_to_the_preceding_one_while_verdicts_arrive(running: Running) -> None:
    async with running.driving():
        await running.until(lambda: len(running.seen) > 60)
    moved = np.diff(running.seen[5:])
    # on a busy machine a state may be missed, and what that cost is known only later
    assert np.median(moved) == pytest.approx(STEP)


# What a controller sees of its own robot and of others.


class Told(Cell):
    """What a connection knows, without one."""

    def __init__(self, *states: RobotState) -> None:
        self.robots = dict.fromkeys(("fr", "gr"))  # type: ignore[assignment]  # only the names are looked at
        self.known = {state.robot: state for state in states}

    def state(self, robot: str) -> RobotState | None:
        return self.known.get(robot)


def state(robot: str, cycle: int, q_cmd: tuple[float, ...]) -> RobotState:
    return RobotState(
        robot=robot, cycle=cycle, ipoc=0, time_s=0.0, q=q_cmd, q_cmd=q_cmd, tool=POSE, phase="engaged"
    )


def test_an_increment_not_yet_in_the_state_counts_as_commanded() -> None:
    seen = state("fr", 7, (1.0, 2.0))
    verdict = Verdict(robot="fr", cycle=7, seq=1, outcome=Outcome.ADMITTED, dq=(0.1, 0.2))
    under_way = own_view(seen, verdict)
    assert under_way.q_cmd.tolist() == [1.1, 2.2]
    assert under_way.cycle == 8
    for known in (None, verdict.model_copy(update={"cycle": 6}), verdict.model_copy(update={"dq": ()})):
        plain = own_view(seen, known)
        assert plain.q_cmd.tolist() == [1.0, 2.0]
        assert plain.cycle == 7


def test_robots_without_state_or_clock_are_omitted_and_others_are_stamped_on_the_own_clock() -> None:
    fr, gr = state("fr", 7, (1.0,)), state("gr", 3, (2.0,))
    own, clocks = RobotView.from_state(fr), RobotClocks(("fr", "gr"), 0.012)
    assert view_of(Told(fr), "fr", own, clocks).others == {}
    clocks.take(0.0, told_status(fr=(7, 0.0)), 0.0, {"fr": fr})
    assert view_of(Told(fr, gr), "fr", own, clocks).others == {}, "nobody knows how old it is"
    behind = gr.model_copy(update={"time_s": -5.0})
    clocks.take(0.0, told_status(gr=(3, 0.0)), 0.0, {"gr": behind})
    seen = view_of(Told(fr, behind), "fr", own, clocks).others["gr"]
    assert (seen.cycle, seen.time_s) == (3, 0.0)


# Controllers ask for a playout buffer where the way there and back is longer than a cycle, and only there.


@pytest.mark.service
@pytest.mark.parametrize(("delay_s", "cycle_s"), [(0.0, 0.1), (0.07, 0.1), (0.03, 0.012)])
async def test_a_jitter_buffer_is_requested_if_the_round_trip_exceeds_a_cycle(
    delay_s: float, cycle_s: float
) -> None:
    with ExitStack() as served:
        server = served.enter_context(Server(cycle_s=cycle_s))
        away = Endpoint.parse(f"tcp/127.0.0.1:{free_port()}")
        relay = RelayProcess(away, Endpoint.parse(server.description.hli), TrafficUnit.BYTES)
        served.enter_context(relay).impair(StreamFaults(delay_s=delay_s))
        async with connect(str(away)) as cell, await lease(cell, "fr") as robot:
            before = None if robot.state is None else robot.state.cycle
            async for state in robot.states():
                if before is not None and state.cycle > before + 20:  # after the lease was granted
                    break
                before = state.cycle if before is None else before
    assert (state.playout is not None) == (2 * delay_s > cycle_s)


# Without a lookahead: one state is left out once every increment has been decided a state late for a while.


def verdict_on(cycle: int, setpoint_cycle: int | None) -> Verdict:
    outcome = Outcome.REFUSED if setpoint_cycle is None else Outcome.ADMITTED
    return Verdict(robot="fr", cycle=cycle, seq=cycle, outcome=outcome, setpoint_cycle=setpoint_cycle)


def left_out(catch_up: CatchUp, cycles: int, late: Callable[[int], bool]) -> list[int]:
    """The states that are left out of so many, if the increment that answers a state is `late` or not."""
    found, answered = [], None
    for cycle in range(1, cycles + 1):
        state = told_state(cycle, 0.0)
        verdict = None if answered is None else verdict_on(answered, answered + 1 + late(answered))
        if catch_up.leaves_out(state, verdict):
            found.append(cycle)
            answered = None
        else:
            answered = cycle
    return found


def test_a_punctual_or_occasionally_late_controller_answers_every_state() -> None:
    assert left_out(CatchUp(), 2000, lambda cycle: False) == []
    assert left_out(CatchUp(), 2000, lambda cycle: cycle % 99 > 0) == []


def test_a_permanently_late_controller_omits_one_state_and_no_second_if_that_helps() -> None:
    catch_up = CatchUp()
    (first,) = left_out(catch_up, 2000, lambda cycle: cycle < 102)
    assert first == 101


def test_omissions_without_effect_become_rarer() -> None:
    gaps = np.diff(left_out(CatchUp(), 100_000, lambda cycle: True))
    assert gaps[:3].tolist() == [201, 401, 801]
    assert set(gaps[6:]) == {10_001}


def test_a_refusing_or_missing_verdict_is_not_late() -> None:
    catch_up = CatchUp()
    refused = verdict_on(1, None)
    assert not any(catch_up.leaves_out(told_state(1, 0.0), verdict) for verdict in [refused, None] * 1000)


# The advisor's own process: asked, given up, asked again, and gone.


LAB = CellModel.load("lab")
GR = LAB.robots["gr"]
OTHERS = {"fr": LAB.robots["fr"].home}


def advisor(**weights: float) -> AdvisorProcess:
    return AdvisorProcess(
        CellModel.load("lab").description_message(),
        tracker_of(GR, task=Task(weights=weights or None)),
        lambda: OTHERS,
    )


def wait_for(advisor: AdvisorProcess, reached: Callable[[], bool]) -> None:
    """Until what the process has said makes it so; each wait ends with a word of it."""
    deadline = time.monotonic() + 300
    while not reached():
        assert advisor._line.poll(max(0.0, deadline - time.monotonic())), "the process says nothing"


@pytest.mark.service
def test_options_precede_their_paths_and_a_cancelled_question_gets_no_answer() -> None:
    with advisor() as asked:
        asked.ask(GR.home)
        assert asked.is_busy
        wait_for(asked, lambda: asked.progress is not None and bool(asked.progress.options))
        assert asked.is_busy
        asked.give_up()
        assert not asked.is_busy
        assert asked.progress is not None
        first = asked.progress.options
        elsewhere = GR.home + np.eye(GR.n)[0] * 0.1
        asked.ask(elsewhere)
        wait_for(asked, lambda: not asked.is_busy)
        assert asked.trouble == ""
        options = asked.progress.options
        assert len(options) == len(first)
        for option in options:
            np.testing.assert_array_equal(option.start, elsewhere)
            assert option.path is not None or option.no_path
        asked.seek(elsewhere[None], 1)
        assert asked.is_busy
        wait_for(asked, lambda: not asked.is_busy)
        assert asked.progress.options[0].path is not None


@pytest.mark.service
def test_unanswerable_requests_are_reported() -> None:
    with advisor(travle=1.0) as asked:
        asked.ask(GR.home)
        wait_for(asked, lambda: not asked.is_busy)
        assert asked.trouble.startswith("no criterion 'travle'; there are travel")


@pytest.mark.service
def test_an_ended_process_is_reported_without_ending_the_loop() -> None:
    with advisor() as asked:
        asked.ask(GR.home)
        assert asked._process.pid is not None
        os.kill(asked._process.pid, signal.SIGKILL)
        wait_for(asked, lambda: not asked.is_busy)
        assert "the advisor's process has ended" in asked.trouble
        asked.ask(GR.home)
        assert "the advisor's process has ended" in asked.trouble
