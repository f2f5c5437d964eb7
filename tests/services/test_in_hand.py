"""An increment in hand: the gate, real Robot Servers' cores behind it, and anything that may happen between them."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
from gate_rig import SMALL, Rig
from hypothesis import given, settings
from hypothesis import strategies as st
from small_cell import server_state

from deltaq_protocol.guarded import Admission, Plan, Request
from deltaq_protocol.messages import Outcome, Phase, Reason, Verdict
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.inbox import Inbox

DECIDED = (Outcome.ADMITTED, Outcome.SCALED, Outcome.HELD)


@pytest.fixture
def rig():
    return Rig()


def missed(rig):
    """FR's admission comes too late for its cycle."""
    rig.mail["fr"] = (None, rig.mail["fr"][1])
    rig.cycle()


def test_an_admission_that_came_too_late_is_decided_once_more_for_the_next_cycle(rig):
    first = rig.request(seq=1)
    at_rest = rig.state.q_cmd
    assert first.setpoint_cycle == rig.state.cycle + 1
    missed(rig)
    assert rig.state.q_cmd == at_rest
    again = rig.alive()
    assert (again.seq, again.outcome) == (1, Outcome.ADMITTED)
    assert again.setpoint_cycle == first.setpoint_cycle + 1
    rig.cycle()
    assert rig.state.dq == SMALL
    assert rig.sim.counters["in_hand_fr"] == 1


def test_each_increment_that_is_kept_in_hand_is_counted(rig):
    for count in (1, 2, 3):
        rig.request()
        missed(rig)
        assert rig.alive().outcome is Outcome.ADMITTED
        rig.cycle()
        assert rig.sim.counters["in_hand_fr"] == count


def test_an_admission_that_was_taken_is_not_decided_again(rig):
    rig.request()
    rig.cycle()
    assert rig.alive() is None
    rig.cycle()
    assert rig.state.dq != SMALL
    assert rig.sim.counters["in_hand_fr"] == 0


def test_it_is_late_by_one_cycle_and_not_by_two(rig):
    rig.request()
    missed(rig)
    assert rig.alive().outcome is Outcome.ADMITTED
    missed(rig)
    assert rig.alive() is None


def test_a_newer_increment_takes_its_place_and_it_is_told_that_it_went_into_no_cycle(rig):
    rig.request(seq=1)
    missed(rig)
    newer = rig.request(seq=2)
    assert (newer.seq, newer.outcome) == (2, Outcome.ADMITTED)
    older = next(said for said in rig.said if isinstance(said, Verdict))
    assert (older.seq, older.outcome, older.setpoint_cycle) == (1, Outcome.REFUSED, None)
    assert older.reasons[0].code is ReasonCode.SUPERSEDED


def test_with_a_silent_hli_nothing_is_used_from_hand(rig):
    rig.request()
    missed(rig)
    rig.cycle()
    stale = rig.verdict()
    told = {"what": "cycle", "value": rig.state.cycle - 2, "bound": rig.state.cycle - 1}
    assert stale.reasons == (Reason(code=ReasonCode.STALE_CYCLE, **told),)
    assert rig.alive() is None
    assert rig.state.phase is Phase.READY


def test_nothing_goes_from_one_lease_into_the_next(rig):
    rig.request()
    missed(rig)
    verdict = rig.alive(lease_epoch=2)
    assert verdict.reasons == (Reason(code=ReasonCode.LEASE_NOT_HELD, what="lease"),)
    assert rig.alive() is None


def test_nothing_outlives_a_stop_or_a_reset(rig):
    rig.request()
    missed(rig)
    rig.command(kind="stop")
    assert rig.verdict().reasons[0].code is ReasonCode.STOPPED
    rig.alive()
    rig.cycle()
    rig.cycle()
    assert rig.state.phase is Phase.HELD
    rig.request()
    rig.command(kind="reset", robot="fr")
    rig.cycle()
    rig.cycle()
    assert rig.state.phase is Phase.READY
    assert rig.alive() is None


def test_a_reset_of_a_robot_that_moves_ends_what_is_in_hand(rig):
    rig.request()
    rig.request(seq=9)
    rig.command(kind="reset", robot="fr")
    assert rig.verdict().reasons[0].code is ReasonCode.STOPPED
    missed(rig)
    assert rig.alive() is None


def test_nothing_outlives_the_robot_server(rig):
    rig.request()
    rig.restart_server("fr")
    rig.cycle()
    assert rig.alive() is None


# --- anything that may happen ------------------------------------------------------------------------------

REQUESTS = st.tuples(
    st.sampled_from([0, 0, 0, 1, 3]), st.sampled_from([0, 0, 0, 1]), st.sampled_from([0, 0, 1])
)
ROUNDS = st.tuples(
    st.sampled_from(["cycle", "cycle", "missed"]),
    st.sampled_from([True, True, False]),
    st.lists(REQUESTS, max_size=2),
    st.sampled_from([None, None, None, None, None, None, "lease", "stop", "reset"]),
)
"""A cycle, a heartbeat in it or not, requests, and what ends that they are in hand."""


@dataclass
class Watch:
    """What was asked for, decided and taken, and what must not be: all in FR's cycles."""

    rig: Rig
    lease_epoch: int = 1
    seq: int = 0
    asked: dict[int, tuple[int, int, int]] = field(default_factory=dict)
    """Of each sequence number the cycle that it answers, the newest when it came, and the lease."""
    barred: int = 0
    """Sequence numbers up to this one came before a stop, a reset or another lease."""
    behind: dict[int, int] = field(default_factory=dict)
    """Of each admission the sequence number that it was asked for with."""
    taken: list[int] = field(default_factory=list)
    followed: int = 0

    def request(self, age: int, ahead: int, overtakes: int) -> None:
        """Answer a state of this age, or one that is still to come, after the HLI had this state or the next."""
        self.seq += 1
        cycle = max(0, self.rig.state.cycle - age + ahead)
        newest = self.rig.state.cycle + overtakes
        self.asked[self.seq] = (cycle, newest, self.lease_epoch)
        self.hear(
            Request(
                robot="fr",
                cycle=cycle,
                newest=newest,
                lease_epoch=self.lease_epoch,
                seq=self.seq,
                dq=SMALL,
            )
        )

    def heartbeat(self, age: int, _: int) -> None:
        cycle = self.rig.state.cycle - age
        self.hear(Request(robot="fr", cycle=cycle, lease_epoch=self.lease_epoch))

    def hear(self, message: Request) -> None:
        self.rig.said = []
        self.rig.deliver(self.rig.sim.on_request(message))
        self.judge()

    def cycle(self) -> None:
        self.rig.cycle()
        self.judge()
        if self.rig.state.sequence not in (0, self.followed):
            self.followed = self.rig.state.sequence
            self.taken.append(self.behind[self.followed])
        assert len(self.taken) == len(set(self.taken)), f"used twice: {self.taken}"

    def missed(self) -> None:
        self.rig.mail["fr"] = (None, self.rig.mail["fr"][1])
        self.cycle()

    def lease(self) -> None:
        self.lease_epoch += 1
        self.barred = self.seq
        self.heartbeat(0, 0)

    def stop(self) -> None:
        self.rig.command(kind="stop")
        self.barred = self.seq

    def reset(self) -> None:
        reply = self.rig.command(kind="reset", robot="fr")
        if reply is None or reply.accepted:
            self.barred = self.seq

    def judge(self) -> None:
        """Whatever was decided was allowed to be."""
        newest = self.rig.state.cycle
        for index, said in enumerate(self.rig.said):
            if not isinstance(said, Verdict) or said.robot != "fr" or said.outcome not in DECIDED:
                continue
            answers, came, lease_epoch = self.asked[said.seq]
            assert said.cycle == newest
            assert said.seq > self.barred, "it was asked for before a stop, a reset or under another lease"
            assert lease_epoch == self.lease_epoch
            waited = newest > max(answers, came)
            assert not waited or newest - answers <= 1, "late by two cycles"
            assert said.seq == max(self.asked), "a newer one had come"
            if said.outcome is not Outcome.HELD:
                admission = self.rig.said[index - 1]
                assert isinstance(admission, Admission)
                self.behind[admission.sequence] = said.seq


@pytest.mark.long
@settings(max_examples=40, deadline=None)
@given(st.lists(ROUNDS, max_size=25))
def test_an_increment_is_never_used_twice_nor_late_by_two_cycles_and_the_newest_wins(rounds):
    watch = Watch(Rig())
    for cycle, is_heard, requests, end in rounds:
        getattr(watch, cycle)()
        if is_heard:
            watch.heartbeat(0, 0)
        for request in requests:
            watch.request(*request)
        if end is not None:
            getattr(watch, end)()


# --- with a lookahead ---------------------------------------------------------------------------------------


def waiting(decided_cycle, step, lookahead_cycles=3):
    """The setpoint that an increment goes into, told by the cycle before it, on the state of cycle 20."""
    inbox = Inbox(joints=6, max_age_cycles=10, lookahead_cycles=lookahead_cycles)
    inbox.decided_cycle = decided_cycle
    state = server_state("fr", 20, plan=Plan(dq=(1e-4,) * 6, brake_cycles=4, step=step))
    inbox.put(Request(robot="fr", cycle=20, lease_epoch=1, seq=1, dq=(0.0,) * 6), 20)
    return inbox.goes_after(state), inbox.due(state)


@pytest.mark.parametrize(
    ("decided_cycle", "step", "goes_after", "due"),
    [
        (21, 0, 22, True),  # the next one
        (22, 0, 23, False),  # as much is in flight as may be
        (19, 0, 20, True),  # the last that was in flight is being sent
        (19, 4, 20, True),  # it was held: the chain goes on all the same
        (18, 1, 20, True),  # it brakes: on at once
        (18, 4, 22, True),  # it rests, and can wait
    ],
)
def test_an_increment_goes_into_the_setpoint_behind_those_in_flight(decided_cycle, step, goes_after, due):
    assert waiting(decided_cycle, step) == (goes_after, due)


@pytest.mark.parametrize("decided_cycle", [19, 20, 22])
def test_where_the_chain_broke_as_much_is_in_flight_again_as_may_be(decided_cycle):
    inbox = Inbox(joints=6, max_age_cycles=10, lookahead_cycles=3)
    inbox.decided_cycle = decided_cycle
    inbox.cycle_passed(20, missed=False)
    assert inbox.decided_cycle == decided_cycle
    inbox.cycle_passed(20, missed=True)
    assert inbox.goes_after(server_state("fr", 20)) == 22
