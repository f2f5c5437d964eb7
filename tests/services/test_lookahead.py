"""Deciding a few cycles ahead: what is in flight, what becomes of it where the chain breaks, what clients are told."""

import random
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from small_cell import server_state, small_cell

from deltaq_cell.description import CellDescription
from deltaq_cell.identity import content_identity
from deltaq_emulator.faults import LinkFaults
from deltaq_protocol import topics
from deltaq_protocol.guarded import Admission, Plan, Supervision
from deltaq_protocol.messages import Increment, Outcome, Phase, Verdict
from deltaq_protocol.setpoint_motion import SetpointMotion
from deltaq_services.hli.playout import Asked, CarriedMotion
from deltaq_services.hli.robot_link import AdmittedAhead, RobotLink
from deltaq_services.robot_server.core import RobotServer
from deltaq_services.robot_server.guards import AdmissionsDue, Refusal
from deltaq_services.robot_server.measurement import Measurement
from deltaq_services.sim.tube import courses, motions, still_due
from deltaq_testing.virtual_cell.cell import VirtualCell
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from deltaq_testing.virtual_cell.parts import Link, MessageWire, Process

ZEROS = (0.0,) * 6
STEP = 4e-4
DQ = (STEP,) * 6
BRAKING = Plan(dq=DQ, brake_cycles=4, step=1)


def following(
    motion: SetpointMotion, cycle: int, sequence: int, dq: tuple[float, ...] = DQ, **changes: Any
) -> Admission:
    """An admission that is taken after `cycle`, and follows a motion."""
    fields: dict[str, Any] = {
        "robot": "fr",
        "epoch": 1,
        "sequence": sequence,
        "cycle": cycle,
        "follows_sequence": motion.sequence,
        "follows_q_cmd": tuple(motion.q_cmd.tolist()),
        "follows_dq": tuple(motion.dq.tolist()),
        "dq": dq,
        "brake_cycles": 4,
    }
    return Admission(**fields | changes)


def chain_of(state: Any, *cycles: int) -> tuple[Admission, ...]:
    """Admissions for the cycles after these, each following the one before it and the brake between them."""
    motion, at, chain = SetpointMotion.of(state), state.cycle, []
    for sequence, cycle in enumerate(cycles, start=state.sequence + 1):
        while at < cycle:
            motion, at = motion.braked(), at + 1
        chain.append(following(motion, cycle, sequence))
        motion, at = motion.admitted(chain[-1]), at + 1
    return tuple(chain)


# --- what a Robot Server keeps ----------------------------------------------------------------------------


def at(cycle: int, sequence: int = 2) -> Admission:
    return following(SetpointMotion.at_rest(np.zeros(6)), cycle, sequence)


@pytest.mark.parametrize(("ahead", "kept"), [(-1, False), (0, True), (1, True), (2, True), (3, False)])
def test_an_admission_for_one_of_the_next_cycles_is_kept(ahead: int, kept: bool) -> None:
    due = AdmissionsDue(lookahead_cycles=3)
    assert due.put(at(10 + ahead), 10) is (None if kept else Refusal.LATE)
    assert due.forget() == int(kept)


def test_an_admission_is_used_in_its_cycle_and_once() -> None:
    due = AdmissionsDue(lookahead_cycles=3)
    for cycle in (12, 10, 11):
        due.put(at(cycle), 10)
    assert due.take(10) == at(10)
    assert due.take(10) is None
    assert due.take(12) == at(12)  # a cycle was passed over, and what was due in it is gone
    assert (due.take(11), due.forget()) == (None, 0)


def test_a_possibly_late_admission_is_due_at_once_also_after_a_restore(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(topics, "ADMISSION", replace(topics.ADMISSION, max_age_cycles=1))
    due, heir = AdmissionsDue(lookahead_cycles=3), AdmissionsDue(lookahead_cycles=3)
    assert (due.put(at(8), 10), due.put(at(9), 10)) == (Refusal.LATE, None)
    heir.restore(due.snapshot())
    assert due.take(10) == heir.take(10) == at(9)


def test_of_two_admissions_for_one_cycle_the_newer_counts() -> None:
    due = AdmissionsDue(lookahead_cycles=1)
    due.put(at(10, sequence=2), 10)
    due.put(at(10, sequence=3), 10)
    assert due.take(10) == at(10, sequence=3)


# --- what the gate reckons with -----------------------------------------------------------------------------


def test_there_is_a_candidate_trajectory_for_every_break_of_the_chain() -> None:
    state = server_state("fr", 20, sequence=5, q_cmd=ZEROS, q=ZEROS, dq=DQ, plan=BRAKING)
    chain = chain_of(state, 20, 22)  # nothing is admitted for the cycle after 21
    found = courses(SetpointMotion.of(state), 20, chain)
    assert list(found) == [5, 6, 7]
    sent = [branch.setpoints(np.zeros(6))[:, 0] for branch in found.values()]
    np.testing.assert_allclose(sent[0], STEP * np.cumsum([0.5, 0.25]))
    np.testing.assert_allclose(sent[1], STEP * np.cumsum([1, 0.75, 0.5, 0.25]))
    np.testing.assert_allclose(sent[2], STEP * np.cumsum([1, 0.75, 1, 0.75, 0.5, 0.25]))


def test_the_gate_continues_from_the_end_of_the_chain() -> None:
    state = server_state("fr", 20, sequence=5, q_cmd=ZEROS, q=ZEROS, dq=DQ, plan=BRAKING)
    found = motions(SetpointMotion.of(state), 20, chain_of(state, 20, 22), cycles=3)
    assert [motion.sequence for motion in found] == [5, 6, 6, 7]
    np.testing.assert_allclose([motion.dq[0] / STEP for motion in found], [1, 1, 0.75, 1])


def test_after_cycles_without_admission_the_gate_continues_from_the_brake() -> None:
    state = server_state("fr", 20, sequence=5, q_cmd=ZEROS, q=ZEROS, dq=DQ, plan=BRAKING)
    found = motions(SetpointMotion.of(state), 20, chain_of(state, 20), cycles=4)
    np.testing.assert_allclose([motion.dq[0] / STEP for motion in found], [1, 1, 0.75, 0.5, 0.25])


@pytest.mark.parametrize("cycles", [(20, 22), (22,), (21, 24)])
def test_an_admission_after_a_future_brake_is_due(cycles: tuple[int, ...]) -> None:
    state = server_state("fr", 20, sequence=5, q_cmd=ZEROS, q=ZEROS, dq=DQ, plan=BRAKING)
    chain = chain_of(state, *cycles)
    assert still_due(state, chain) == chain
    another = state.model_copy(update={"plan": Plan(dq=DQ, brake_cycles=4, step=2)})
    assert still_due(another, chain) == (chain if cycles[0] == 20 else ())  # it brakes otherwise


def test_after_an_untaken_admission_no_later_one_is_due() -> None:
    before = server_state("fr", 20, sequence=5, q_cmd=ZEROS, q=ZEROS)
    chain = chain_of(before, 20, 21, 22)
    taken = SetpointMotion.of(before).admitted(chain[0])
    now = server_state(
        "fr", 21, sequence=6, q_cmd=tuple(taken.q_cmd.tolist()), q=ZEROS, dq=DQ, plan=taken.plan
    )
    assert still_due(now, chain) == chain[1:]
    missed = server_state("fr", 21, sequence=5, q_cmd=ZEROS, q=ZEROS)
    assert still_due(missed, chain) == ()
    assert still_due(now.model_copy(update={"epoch": 2}), chain) == ()


# --- Robot Server -------------------------------------------------------------------------------------------


def ahead_by(cycles: int) -> CellDescription:
    cell = small_cell()
    return cell.model_copy(update={"gate": cell.gate.model_copy(update={"lookahead_cycles": cycles})})


class Server:
    """FR's Robot Server in a cell with a lookahead, its robot always where it was sent."""

    def __init__(self, lookahead_cycles: int) -> None:
        self.cell = ahead_by(lookahead_cycles)
        self.core = RobotServer(self.cell, "fr", process=1)
        self.q = self.cell.robots["fr"].home
        self.resets = 0
        self.stop: Any = None
        for _ in range(60):
            self.cycle()
            if self.state.phase is Phase.READY:
                return
        raise AssertionError(self.core.detail)

    @property
    def state(self) -> Any:
        return self.core.state

    def cycle(self) -> None:
        cycle = 0 if self.state is None else self.state.cycle
        self.core.take(
            Supervision(
                robot="fr",
                epoch=1,
                cycle=cycle,
                cell=str(content_identity(self.cell)),
                resets=self.resets,
                stop=self.stop,
            ),
            0.0,
        )
        (sent,) = self.core.take(Measurement(12 * cycle, self.q, self.q if cycle == 0 else None), 0.0)
        self.q = sent.q_cmd

    def give(self, *admissions: Admission) -> None:
        for admission in admissions:
            assert self.core.take(admission, 0.0) == []


def test_each_admission_is_taken_in_its_own_cycle() -> None:
    server = Server(3)
    chain = chain_of(server.state, *(server.state.cycle + later for later in range(3)))
    server.give(*reversed(chain))
    for admission in chain:
        server.cycle()
        assert (server.state.sequence, server.state.dq) == (admission.sequence, admission.dq)
    server.cycle()
    assert server.state.plan.step == 1  # then it brakes


@pytest.mark.parametrize("lost", [0, 1])
def test_after_a_lost_admission_it_brakes_and_takes_no_later_one_of_the_chain(lost: int) -> None:
    server = Server(3)
    before = server.state.sequence
    chain = chain_of(server.state, *(server.state.cycle + later for later in range(3)))
    server.give(*(admission for index, admission in enumerate(chain) if index != lost))
    for _ in range(8):
        server.cycle()
    assert server.state.sequence == before + lost
    assert server.core.counters["admission_unchained"] == 2 - lost
    assert not any(server.state.dq)


def test_admissions_from_before_a_hold_are_not_taken_after_it() -> None:
    server = Server(3)
    server.stop = "operator_stop"
    chain = chain_of(server.state, *(server.state.cycle + later for later in range(3)))
    server.give(*chain)
    server.cycle()
    assert server.state.phase is Phase.HELD
    server.stop, server.resets = None, server.resets + 1
    for _ in range(3):
        server.cycle()
    assert server.state.phase is Phase.READY
    assert "admissions" not in server.core.counters
    assert server.core.counters["admission_while_not_ready"] == 3


def test_no_decision_from_before_a_reset_takes_effect_after_it() -> None:
    server = Server(2)
    late = following(
        SetpointMotion.of(server.state), server.state.cycle, 1, follows_resets=server.state.resets + 1
    )
    server.give(late)
    server.cycle()
    assert server.core.counters["admission_unchained"] == 1


# --- the whole cell, in virtual time ---------------------------------------------------------------------------


@pytest.fixture(scope="module", params=[1, 2, 3])
def lab(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> LoadedCell:
    file = tmp_path_factory.mktemp("cell") / "ahead.yaml"
    file.write_text(f"extends: lab.yaml\ncell: ahead\ngate: {{lookahead_cycles: {request.param}}}\n")
    return LoadedCell.load(file)


def driven(lab: LoadedCell, cycles: int, loss: float, seed: int) -> tuple[VirtualCell, list[tuple[Any, Any]]]:
    """FR driven to and fro; returns the cell, and of each cycle what its client was told and what the server was."""
    cell = VirtualCell(lab)
    cell.run_until_ready()
    wire = MessageWire(seed)
    wire.link.faults = LinkFaults(drop=loss)
    cell.plug(Link.SIM_SERVER, Process.ROBOT_SERVER, wire, ["fr"], Admission)
    cell.acquire("fr", "driver")
    drawn, dq, seen = random.Random(seed), np.zeros(6), []
    for _ in range(cycles):
        cell.cycle()
        seen.append((cell.states["fr"], cell.arms["fr"].server.state))
        dq = np.clip(dq + 1e-4 * np.array([drawn.uniform(-1, 1) for _ in range(6)]), -1e-3, 1e-3)
        cell.ask("fr", dq)
    return cell, seen


@pytest.mark.long
def test_on_a_quiet_wire_every_cycle_has_an_admission_and_clients_know_its_setpoint(
    lab: LoadedCell,
) -> None:
    ahead = lab.model.description.gate.lookahead_cycles
    cell, seen = driven(lab, 60, loss=0.0, seed=3)
    counters = cell.arms["fr"].server.counters
    assert counters["admissions"] == 60 - ahead
    assert counters["braked_cycles"] == 0
    for (told, _), (_, then) in zip(seen, seen[ahead - 1 :], strict=False):
        assert told.setpoint_cycle in (None, told.cycle + ahead)
        assert (told.q_cmd if told.q_ahead is None else told.q_ahead) == then.q_cmd


@pytest.mark.by_day(4)
@pytest.mark.long
@pytest.mark.parametrize("seed", [11, 12, 13])
def test_with_lost_admissions_the_robot_stays_on_a_candidate_trajectory(lab: LoadedCell, seed: int) -> None:
    cell, seen = driven(lab, 150, loss=0.2, seed=seed)
    server, gate = cell.arms["fr"].server, cell.sim
    assert gate.counters["impossible_states_fr"] == 0
    assert server.counters["braked_cycles"] > 10
    assert server.counters["admissions"] > 30
    assert seen[-1][1].phase in (Phase.READY, Phase.ENGAGED, Phase.BRAKING)
    ahead = lab.model.description.gate.lookahead_cycles
    assert {why for why in Refusal if server.counters[why]} <= {Refusal.UNCHAINED, Refusal.LATE}
    assert (server.counters[Refusal.UNCHAINED] > 0) is (ahead > 1)


# --- what clients are told ----------------------------------------------------------------------------------------


def decided(cycle: int, dq: tuple[float, ...] = DQ) -> Verdict:
    return Verdict(
        robot="fr",
        cycle=cycle - 2,
        seq=cycle,
        outcome=Outcome.ADMITTED,
        setpoint_cycle=cycle,
        dq=dq,
        time_to_stop_s=4 * 0.012,
    )


def test_a_pending_admission_is_reported_as_the_brake() -> None:
    ahead = AdmittedAhead(3, 0.012)
    state = server_state("fr", 20, q_cmd=ZEROS, q=ZEROS, dq=DQ, plan=BRAKING)
    assert (ahead.setpoint_cycle(state), ahead.q_ahead(state)) == (21, ZEROS)
    ahead.decided(decided(22), state)
    assert ahead.setpoint_cycle(state) == 23
    assert ahead.q_ahead(state)[0] == pytest.approx(1.5 * STEP)


def test_a_robot_at_rest_waits_until_the_lookahead_is_filled() -> None:
    at_rest = Plan(dq=ZEROS, brake_cycles=1, step=1)
    state = server_state("fr", 20, q_cmd=ZEROS, q=ZEROS, plan=at_rest)
    assert AdmittedAhead(3, 0.012).setpoint_cycle(state) == 23


def test_after_an_untaken_admission_its_successors_are_not_published() -> None:
    for dq, told in ((DQ, 2 * STEP), (ZEROS, 0.0)):
        ahead = AdmittedAhead(3, 0.012)
        before = server_state("fr", 20, q_cmd=ZEROS, q=ZEROS)
        for cycle in (21, 22, 23):
            ahead.decided(decided(cycle), before)
        ahead.cycle_passed(server_state("fr", 21, q_cmd=ZEROS, q=ZEROS, dq=dq))
        state = server_state("fr", 21, q_cmd=ZEROS, q=ZEROS)
        assert ahead.q_ahead(state)[0] == pytest.approx(told)


def braking_at(cycle: int) -> Any:
    return server_state("fr", cycle, q_cmd=ZEROS, q=ZEROS, dq=DQ, plan=BRAKING)


def test_after_a_broken_chain_the_next_increment_gets_the_latest_setpoint() -> None:
    ahead = AdmittedAhead(3, 0.012)
    ahead.decided(decided(21), braking_at(20))
    ahead.cycle_passed(server_state("fr", 21, q_cmd=ZEROS, q=ZEROS, dq=ZEROS, plan=BRAKING))
    assert ahead.setpoint_cycle(braking_at(21)) == 24
    ahead.decided(
        decided(22), braking_at(21)
    )  # under way since before the break: it follows what did not happen
    assert ahead.setpoint_cycle(braking_at(21)) == 24
    assert ahead.q_ahead(braking_at(21))[0] == pytest.approx(STEP * (0.5 + 0.25))


def test_a_held_increment_takes_a_setpoint_with_its_brake() -> None:
    ahead = AdmittedAhead(3, 0.012)
    ahead.decided(decided(21), braking_at(20))
    held = Verdict(robot="fr", cycle=20, seq=22, outcome=Outcome.HELD, dq=ZEROS)
    ahead.decided(held, braking_at(20))
    assert ahead.setpoint_cycle(braking_at(20)) == 23
    assert ahead.q_ahead(braking_at(20))[0] == pytest.approx(1.75 * STEP)


def test_the_cycles_of_another_robot_server_are_counted_from_one() -> None:
    ahead = AdmittedAhead(3, 0.012)
    ahead.decided(decided(1021), braking_at(1020))
    ahead.cycle_passed(braking_at(1))
    assert ahead.setpoint_cycle(braking_at(1)) == 2


@pytest.mark.parametrize("ahead", [False, True])
def test_with_a_lookahead_the_answer_to_each_state_is_passed_on_though_two_come_in_one_cycle(
    ahead: bool,
) -> None:
    link = RobotLink(
        6, 10, 1.0, 83, CarriedMotion(np.ones(6), np.ones(6)), AdmittedAhead(2, 0.012) if ahead else None
    )
    for cycle in (20, 21):
        link.take_state(server_state("fr", cycle, q_cmd=ZEROS, q=ZEROS), 0.0)
    late, next_one, again = (
        Asked(Increment(robot="fr", seq=seq, cycle=cycle, dq=ZEROS), 1, None, came=21)
        for seq, cycle in enumerate((20, 21, 21))
    )
    assert link.offer(late) == (late, None)
    assert link.offer(next_one)[0] is (next_one if ahead else None)
    assert link.offer(again)[0] is None  # to one state there is one answer
