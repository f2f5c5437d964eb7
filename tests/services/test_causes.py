"""States that the gate cannot have caused: each stops all robots and is told, and no other does."""

import random
from typing import Any

import pytest
from gate_rig import CELL, SMALL, Rig
from small_cell import server_state

from deltaq_protocol.guarded import Admission, Plan, ServerState
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.phases import MAY_MOVE
from deltaq_services.sim.causes import impossible

EPOCH = 1
GAP = 100
DQ = (1e-3,) * 6
MOVING = Plan(dq=DQ, brake_cycles=3, step=1)
AT_REST = Plan(dq=(0.0,) * 6, brake_cycles=1, step=1)


def judged(state: ServerState, before: ServerState | None, **changes: Any) -> str | None:
    known: dict[str, Any] = {"in_flight": (), "epoch": EPOCH, "resets": 0, "longest_gap": GAP} | changes
    return impossible(state, before, **known)


def admitted(sequence: int = 2, brake_cycles: int = 3) -> Admission:
    zeros = (0.0,) * 6
    return Admission(
        robot="fr", epoch=EPOCH, sequence=sequence, cycle=100, follows_sequence=1, follows_q_cmd=zeros,
        follows_dq=zeros, dq=DQ, brake_cycles=brake_cycles,
    )  # fmt: skip


def moving(cycle: int = 101, sequence: int = 2, **changes: Any) -> ServerState:
    fields = {"phase": Phase.ENGAGED, "plan": MOVING, "dq": DQ} | changes
    return server_state(cycle=cycle, sequence=sequence, **fields)


BEFORE = server_state(plan=AT_REST)


@pytest.mark.parametrize("in_flight", [(), (admitted(sequence=3),)])
def test_an_unadmitted_sequence_is_impossible(in_flight: tuple[Admission, ...]) -> None:
    said = judged(moving(), BEFORE, in_flight=in_flight)
    assert said == "sequence 2, which was not admitted"
    assert judged(moving(), BEFORE, in_flight=(admitted(),)) is None


@pytest.mark.parametrize(
    "state",
    [
        server_state(cycle=101, sequence=5, plan=AT_REST),
        moving(sequence=0),
        moving(sequence=1, epoch=EPOCH),
    ],
)
def test_a_sequence_of_this_gate_neither_shown_nor_in_flight_is_impossible(state: ServerState) -> None:
    followed_another = BEFORE.model_copy(update={"epoch": 7, "plan": MOVING})
    said = f"sequence {state.sequence}, which was not admitted"
    assert judged(state, followed_another, in_flight=(admitted(),)) == said


def test_a_robot_without_sequence_elsewhere_without_a_reset_is_impossible() -> None:
    said = judged(server_state(cycle=101, sequence=0, plan=AT_REST, q_cmd=(0.5,) * 6), BEFORE)
    assert said == "a setpoint of joint 1 that no admission leads to"
    assert judged(server_state(cycle=101, sequence=0, plan=AT_REST), BEFORE) is None


def test_a_plan_is_checked_even_at_its_end() -> None:
    said = judged(server_state(cycle=101, plan=MOVING), BEFORE)
    assert said == "a plan that sequence 1 is not"


@pytest.mark.parametrize(
    "plan",
    [
        Plan(dq=(2e-3,) * 6, brake_cycles=3, step=0),
        Plan(dq=DQ, brake_cycles=4, step=0),
        Plan(dq=(*DQ[:5], 2e-3), brake_cycles=3, step=0),
    ],
)
def test_an_unadmitted_plan_is_impossible(plan: Plan) -> None:
    said = judged(moving(plan=plan), BEFORE, in_flight=(admitted(),))
    assert said == "a plan that sequence 2 is not"
    assert judged(moving(102, plan=plan), moving()) == said
    assert judged(moving(102), moving()) is None


def test_a_robot_at_rest_needs_no_plan_and_its_setpoint_must_not_move() -> None:
    assert judged(moving(103, plan=AT_REST, dq=(0.0,) * 6), moving()) is None
    assert judged(moving(103, plan=AT_REST), moving()) == "a plan that sequence 2 is not"


def at(*shares: float, **changes: Any) -> ServerState:
    """In the cycle after so many, at the setpoint that these shares of the increment lead to."""
    q_cmd = tuple(0.1 + sum(shares) * dq for dq in DQ)
    return moving(100 + len(shares), q_cmd=q_cmd, **changes)


@pytest.mark.parametrize("shares", [(1,), (1, 2 / 3), (1, 2 / 3, 1 / 3), (1, 2 / 3, 1 / 3, 0), (0,), (1, 0)])
def test_an_admission_is_followed_along_its_brake_without_states(shares: tuple[float, ...]) -> None:
    assert judged(at(*shares), BEFORE, in_flight=(admitted(),)) is None


@pytest.mark.parametrize("shares", [(1.001,), (1, 1), (1 + 2 / 3,), (0.5,), (-1,), (0, 0, 0, 0, 100)])
def test_a_setpoint_off_every_admitted_path_is_impossible(shares: tuple[float, ...]) -> None:
    said = "a setpoint of joint 1 that no admission leads to"
    assert judged(at(*shares), BEFORE, in_flight=(admitted(),)) == said
    held = at(*shares, phase=Phase.HELD, sequence=1, plan=AT_REST, dq=(0.0,) * 6)
    assert judged(held, BEFORE) == said
    one = BEFORE.model_copy(update={"q_cmd": (*BEFORE.q_cmd[:3], 0.3, *BEFORE.q_cmd[4:]), "cycle": 101})
    assert judged(one, BEFORE) == "a setpoint of joint 4 that no admission leads to"


def test_under_an_earlier_gate_an_unadmitted_robot_must_stay() -> None:
    before = BEFORE.model_copy(update={"epoch": 7})
    state = at(1, epoch=7, sequence=1, plan=AT_REST, dq=(0.0,) * 6)
    assert judged(state, before) == "a setpoint of joint 1 that no admission leads to"


def test_the_brake_continues_from_its_step() -> None:
    begun = at(1)
    begun = begun.model_copy(update={"plan": MOVING.model_copy(update={"step": 0})})
    assert judged(at(1, 2 / 3), begun) is None
    assert judged(at(1, 2 / 3, 1 / 3), begun) is None
    assert judged(at(1, 1), begun) is not None


def test_an_admission_that_was_not_taken_does_not_change_the_course() -> None:
    begun = at(1).model_copy(update={"plan": MOVING.model_copy(update={"step": 0})})
    missed = admitted(sequence=3).model_copy(update={"cycle": 101, "dq": tuple(2 * dq for dq in DQ)})
    assert judged(at(1, 2 / 3), begun, in_flight=(missed,)) is None
    assert judged(at(1, 2), begun, in_flight=(missed,)) == "a setpoint of joint 1 that no admission leads to"


def test_a_reset_adopts_the_setpoint_of_the_krc() -> None:
    held = server_state(phase=Phase.HELD, plan=AT_REST, resets=3)
    elsewhere = {"cycle": 101, "plan": AT_REST, "sequence": 0, "q_cmd": (0.7,) * 6}
    assert judged(server_state(**elsewhere, resets=4), held, resets=4) is None
    assert judged(server_state(**elsewhere), server_state(phase=Phase.OFFLINE, plan=AT_REST)) is None


@pytest.mark.parametrize(
    ("cycle", "phase", "is_possible"),
    [
        (100 + GAP, Phase.READY, True),
        (101 + GAP, Phase.READY, False),
        (101 + GAP, Phase.ENGAGED, False),
        (101 + GAP, Phase.BRAKING, False),
        (2**40, Phase.READY, False),
        (2**40, Phase.HELD, True),
        (2**40, Phase.OFFLINE, True),
        (100 - GAP, Phase.READY, True),
        (99 - GAP, Phase.READY, False),
        (99 - GAP, Phase.HELD, False),
    ],
)
def test_a_jump_of_the_cycle_number_is_impossible(cycle: int, phase: Phase, is_possible: bool) -> None:
    before = server_state(cycle=100, plan=AT_REST)
    if cycle < 0:
        cycle, before = cycle + 100, server_state(cycle=200, plan=AT_REST)
    said = judged(server_state(cycle=cycle, phase=phase, plan=AT_REST), before)
    assert (said is None) is is_possible
    assert said is None or said.startswith(f"cycle {cycle} after cycle {before.cycle}")


def test_a_hold_without_a_reset_and_a_reset_without_an_order_are_found() -> None:
    held = server_state(phase=Phase.HELD, plan=AT_REST, resets=3)
    said = judged(server_state(cycle=101, plan=AT_REST, resets=3), held, resets=3)
    assert said == "a hold that ended without a reset"
    reset = server_state(cycle=101, plan=AT_REST, resets=4, sequence=0)
    assert judged(reset, held, resets=3) == "reset 4, of which 3 were ordered"
    assert judged(reset, held, resets=4) is None


def test_unjudged_parts_are_accepted() -> None:
    ghost = moving(2**40)
    assert judged(ghost, None) is None  # the first
    assert judged(ghost, BEFORE.model_copy(update={"process": 9})) is None  # of another process: held anyway
    assert judged(BEFORE, BEFORE) is None  # said again
    assert judged(moving(99), BEFORE) is None  # overtaken
    assert judged(moving(100), BEFORE) is None  # the KRC is silent: of this cycle nothing new is sent
    assert judged(at(1, epoch=7), BEFORE) is None  # it follows an earlier gate


# --- in the gate ------------------------------------------------------------------------------------


def ghosts(rig: Rig) -> dict[str, ServerState]:
    """States of fr that its Robot Server did not send."""
    state = rig.state
    following = {"cycle": state.cycle + 1, "time_s": state.time_s + 0.012}
    plan = Plan(dq=SMALL, brake_cycles=1, step=0)
    changes: dict[str, dict[str, Any]] = {
        "sequence": {"sequence": 10_000, "plan": plan, "dq": SMALL},
        "plan": {"plan": plan, "dq": SMALL},
        "leap": {"cycle": state.cycle + 5000},
        "elsewhere": {"q": (0.0,) * 6, "q_cmd": (0.0,) * 6},
        "reset": {"resets": state.resets + 1},
    }
    return {name: state.model_copy(update=following | change) for name, change in changes.items()}


@pytest.mark.parametrize("name", ["sequence", "plan", "leap", "elsewhere", "reset"])
def test_an_impossible_state_holds_all_robots_until_a_reset(name: str) -> None:
    rig = Rig()
    assert rig.sim.disbelieved == ""
    known = {robot: gated.tracker.state for robot, gated in rig.sim.robots.items()}
    (answer,) = rig.sim.on_state(ghosts(rig)[name])
    assert answer.message.stop is ReasonCode.IMPOSSIBLE_STATE
    assert rig.sim.robots["fr"].tracker.state is known["fr"]  # it is not believed
    assert rig.sim.counters["impossible_states_fr"] == 1
    assert rig.sim.disbelieved.startswith("fr told ")
    for _ in range(3):
        rig.cycle()
    for server in rig.servers.values():
        assert (server.state.phase, server.state.reason) == (Phase.HELD, ReasonCode.IMPOSSIBLE_STATE)
    for _ in range(30):
        rig.cycle()
    for robot in rig.servers:
        assert rig.command(kind="reset", robot=robot) is None
        for _ in range(3):
            rig.cycle()
        assert rig.servers[robot].state.phase in MAY_MOVE
    assert rig.request() is not None
    rig.cycle()
    assert rig.servers["fr"].counters["admissions"] == 1
    assert rig.sim.counters["impossible_states_fr"] == 1


def test_a_forged_held_state_is_detected_by_the_next_true_state() -> None:
    rig = Rig()
    ghost = rig.state.model_copy(update={"cycle": rig.state.cycle + 5000, "phase": Phase.HELD})
    rig.sim.on_state(ghost)
    assert rig.sim.counters["impossible_states_fr"] == 0
    for _ in range(3):
        rig.cycle()
    assert rig.sim.counters["impossible_states_fr"] == 3
    # the gate cannot know which of the two is the robot: both robots stay held
    assert {server.state.phase for server in rig.servers.values()} == {Phase.HELD}
    # until its Robot Server is started again
    rig.restart_server("fr")
    for _ in range(80):
        rig.cycle()
    assert rig.state.phase is Phase.HELD
    counted = rig.sim.counters["impossible_states_fr"]
    assert rig.command(kind="reset", robot="fr") is None
    for _ in range(3):
        rig.cycle()
    assert rig.state.phase in MAY_MOVE
    assert rig.sim.counters["impossible_states_fr"] == counted


class LossyRig(Rig):
    """States that are lost, said twice, or late, in motion."""

    def __init__(self, seed: int) -> None:
        self.random: random.Random | None = None
        super().__init__()
        self.random = random.Random(seed)
        self.late: list[ServerState] = []
        on_state = self.sim.on_state

        def unreliable(state: ServerState) -> list[Any]:
            assert self.random is not None  # from now on
            chance = self.random.random()
            outputs = [] if chance < 0.2 else on_state(state)
            if chance > 0.8:
                outputs += on_state(state)
            if chance > 0.9:
                self.late.append(state)
            if self.late and self.random.random() < 0.05:
                outputs += on_state(self.late.pop())
            return outputs

        self.sim.on_state = unreliable  # type: ignore[method-assign] # the link, not the gate


@pytest.mark.long
@pytest.mark.parametrize("seed", range(5))
def test_lost_duplicated_and_late_states_are_possible(seed: int) -> None:
    rig = LossyRig(seed)
    assert rig.random is not None
    for _ in range(400):
        rig.cycle()
        if rig.random.random() < 0.8:
            rig.request()
        if rig.random.random() < 0.01:
            rig.restart_server(rig.random.choice(["fr", "gr"]))
        if rig.random.random() < 0.05:
            rig.command(kind="stop")
        for robot in rig.servers:
            if rig.random.random() < 0.1:
                rig.command(kind="reset", robot=robot)
    assert rig.sim.counters["admitted"] > 0
    assert not [name for name in rig.sim.counters if name.startswith("impossible") and rig.sim.counters[name]]


def test_states_after_an_hour_of_silence_are_possible() -> None:
    rig = Rig()
    for server in rig.servers.values():
        server._cycle += 300_000
        server.end()  # held, as it is without a gate
    for _ in range(5):
        rig.cycle()
    assert {server.state.phase for server in rig.servers.values()} == {Phase.HELD}
    assert not rig.sim.counters["impossible_states_fr"]


def test_a_gap_longer_than_the_gate_timeout_is_impossible() -> None:
    rig = Rig()
    timeout = CELL.description.gate.gate_timeout_s / CELL.description.cycle_s
    assert all(robot.longest_gap_cycles > 2 * timeout for robot in rig.sim.robots.values())
