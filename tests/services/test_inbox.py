"""Which request of a robot is decided, on which state, and what is said to the others."""

from dataclasses import dataclass, field

import pytest
from gate_rig import SMALL, Rig
from hypothesis import given, settings
from hypothesis import strategies as st
from small_cell import server_state

from deltaq_cell.load import load_cell
from deltaq_protocol.guarded import Admission, Plan, Request
from deltaq_protocol.messages import Outcome, Phase, Reason, Verdict
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.gated_robot import GatedRobot
from deltaq_services.sim.inbox import Inbox

HERE = 100
"""The cycle of the newest state."""


def request(cycle=HERE, seq=1, lease_epoch=3, dq=(0.0,) * 6):
    return Request(robot="fr", cycle=cycle, lease_epoch=lease_epoch, seq=seq, dq=dq)


def state(cycle=HERE, phase=Phase.READY):
    return server_state("fr", cycle, phase)


@pytest.fixture
def inbox():
    return Inbox(joints=6, max_age_cycles=10)


def holding(inbox, **fields):
    inbox.put(request(**fields), HERE)
    return inbox


def test_the_first_request_is_valid_with_any_number(inbox):
    assert inbox.fault(request(seq=0, lease_epoch=0)) is None


@pytest.mark.parametrize(("dq", "count"), [((0.0,) * 5, 5), ((0.0,) * 7, 7), (None, 0)])
def test_a_wrong_number_of_joints_is_reported_with_the_right_one(inbox, dq, count):
    told = Reason(code=ReasonCode.BAD_SHAPE, what="dq", value=count, bound=6)
    assert inbox.fault(request(dq=dq)) == told


def test_an_outdated_lease_is_reported_with_the_present_one(inbox):
    told = Reason(code=ReasonCode.LEASE_NOT_HELD, what="lease_epoch", value=2, bound=3)
    assert holding(inbox, lease_epoch=3).fault(request(lease_epoch=2, seq=9)) == told


@pytest.mark.parametrize("seq", [4, 5])
def test_a_repeated_sequence_number_is_reported_with_the_newest(inbox, seq):
    told = Reason(code=ReasonCode.REPLAYED_SEQUENCE, what="seq", value=seq, bound=5)
    assert holding(inbox, seq=5).fault(request(seq=seq)) == told


def test_the_next_number_and_a_newer_lease_are_valid(inbox):
    holding(inbox, seq=5)
    assert inbox.fault(request(seq=6)) is None
    assert inbox.fault(request(seq=0, lease_epoch=4)) is None


def test_a_newer_request_replaces_the_waiting_one(inbox):
    first, second = request(seq=1), request(seq=2)
    assert inbox.put(first, HERE) is None
    assert inbox.put(second, HERE) is first
    assert inbox.take() is second
    assert inbox.take() is None


@pytest.mark.parametrize(("ahead", "due"), [(-50, True), (0, True), (1, False), (2, False), (3, True)])
def test_a_request_that_overtook_its_state_by_little_waits_for_it(inbox, ahead, due):
    assert holding(inbox, cycle=HERE + ahead).due(state()) is due


def test_nothing_is_due_without_a_request_or_on_a_decided_state(inbox):
    assert not inbox.due(state())
    holding(inbox)
    inbox.decided_cycle = HERE
    assert not inbox.due(state())


def test_a_carried_over_request_is_due_after_the_hlis_first_message_of_the_cycle(inbox):
    holding(inbox).decided_cycle = HERE
    assert inbox.cycle_passed(HERE + 1, missed=False) is None
    assert not inbox.due(state(HERE + 1))
    assert inbox.heartbeat(request(dq=None), HERE + 1) is None  # said before that state came
    assert not inbox.due(state(HERE + 1))
    assert inbox.heartbeat(request(HERE + 1, dq=None), HERE + 1) is None
    assert inbox.due(state(HERE + 1))


def test_a_heartbeat_may_slightly_overtake_its_state_and_a_distant_one_is_ignored(inbox):
    holding(inbox).decided_cycle = HERE
    assert inbox.heartbeat(request(HERE + 50, lease_epoch=9, dq=None), HERE) is None
    inbox.cycle_passed(HERE + 1, missed=False)
    assert not inbox.due(state(HERE + 1))
    holding(inbox, seq=2)
    inbox.heartbeat(request(HERE + 1, dq=None), HERE)
    assert inbox.due(state(HERE + 1))


def test_by_two_cycles_a_heartbeat_may_overtake_its_state(inbox):
    holding(inbox, cycle=HERE + 2)
    inbox.spoken_cycle = HERE
    inbox.heartbeat(request(HERE + 2, lease_epoch=3, dq=None), HERE)
    assert inbox.due(state(HERE + 2))


def test_a_request_that_overtook_its_state_is_due_when_the_state_comes(inbox):
    holding(inbox, cycle=HERE + 2)
    inbox.cycle_passed(HERE + 1, missed=False)
    assert not inbox.due(state(HERE + 1))
    inbox.cycle_passed(HERE + 2, missed=False)
    assert inbox.due(state(HERE + 2))


def test_a_late_message_does_not_undo_a_newer_message_of_the_hli(inbox):
    inbox.heartbeat(request(HERE + 1, dq=None), HERE)
    holding(inbox).decided_cycle = HERE
    inbox.cycle_passed(HERE + 1, missed=False)
    assert inbox.due(state(HERE + 1))


def test_a_request_for_a_distant_cycle_does_not_count_for_the_cycles_before(inbox):
    holding(inbox, cycle=HERE + 50, seq=1).take()
    holding(inbox, seq=2).decided_cycle = HERE
    inbox.cycle_passed(HERE + 1, missed=False)
    assert not inbox.due(state(HERE + 1))


def test_a_request_that_waited_in_the_hli_waits_for_its_state_in_the_gate_too(inbox):
    inbox.put(request(seq=1).model_copy(update={"newest": HERE + 1}), HERE)
    assert not inbox.due(state())
    inbox.cycle_passed(HERE + 1, missed=False)
    assert inbox.due(state(HERE + 1))


def test_a_heartbeat_of_another_lease_removes_the_waiting_request(inbox):
    waiting = request()
    inbox.put(waiting, HERE)
    assert inbox.heartbeat(request(lease_epoch=0, dq=None), HERE) is waiting
    assert inbox.waiting is None


def test_an_answer_to_a_state_older_than_the_last_is_not_carried_over(inbox):
    late = request()
    inbox.put(late, HERE)
    assert inbox.cycle_passed(HERE + 1, missed=False) is None
    assert inbox.cycle_passed(HERE + 2, missed=False) is late
    assert inbox.waiting is None


@pytest.mark.parametrize(
    ("answers", "missed", "comes_back"), [(HERE, True, True), (HERE, False, False), (HERE - 1, True, False)]
)
def test_a_request_with_a_missed_admission_returns_if_late_by_one_cycle_only(
    inbox, answers, missed, comes_back
):
    decided = inbox.decided = request(answers)
    assert inbox.cycle_passed(HERE + 1, missed) is None
    assert inbox.waiting is (decided if comes_back else None)
    assert inbox.decided is None


def test_a_missed_request_does_not_return_after_a_newer_one_another_lease_or_a_reset(inbox):
    def missed():
        inbox.cycle_passed(HERE + 1, missed=True)
        return inbox.waiting

    newer = request(seq=2)
    inbox.decided = request()
    inbox.put(newer, HERE)
    assert missed() is newer
    assert inbox.forget() is newer
    inbox.decided = request()
    inbox.heartbeat(request(lease_epoch=4, dq=None), HERE)
    assert missed() is None
    inbox.decided = request()
    assert inbox.forget() is None
    assert missed() is None
    inbox.decided = request()
    inbox.begin_anew()
    assert missed() is None


@pytest.mark.parametrize("cycle", [0, 1])
def test_even_the_first_states_of_all_are_decided(inbox, cycle):
    assert holding(inbox, cycle=cycle).due(state(cycle))


def test_a_request_for_a_distant_cycle_is_answered_with_the_present_one(inbox):
    told = Reason(code=ReasonCode.FUTURE_CYCLE, what="cycle", value=HERE + 3, bound=HERE)
    assert holding(inbox, cycle=HERE + 3).fault_on(state(), stopping=False) == told


def test_a_request_may_answer_a_state_of_the_greatest_age_and_none_older(inbox):
    assert holding(inbox, cycle=HERE - 10).fault_on(state(), stopping=False) is None
    told = Reason(code=ReasonCode.STALE_CYCLE, what="cycle", value=HERE - 11, bound=HERE - 10)
    assert holding(inbox, cycle=HERE - 11).fault_on(state(), stopping=False) == told


@pytest.mark.parametrize(
    ("phase", "stopping", "code"),
    [
        (Phase.OFFLINE, False, ReasonCode.NOT_READY),
        (Phase.HELD, False, ReasonCode.STOPPED),
        (Phase.READY, True, ReasonCode.STOPPED),
        (Phase.ENGAGED, True, ReasonCode.STOPPED),
    ],
)
def test_a_request_to_a_robot_that_may_not_move_has_its_reason(inbox, phase, stopping, code):
    assert holding(inbox).fault_on(state(phase=phase), stopping) == Reason(code=code)


@pytest.mark.parametrize("phase", [Phase.READY, Phase.ENGAGED, Phase.BRAKING])
def test_a_robot_that_may_move_is_decided(inbox, phase):
    assert holding(inbox).fault_on(state(phase=phase), stopping=False) is None


# How old what a robot is asked for may be: the lesser of what the table of topics and the cell say.

LAB = load_cell("lab")


def made(cycle_s, **changes):
    gate = LAB.gate.model_copy(update=changes)
    return GatedRobot("fr", LAB.robots["fr"], gate, cycle_s)


@pytest.mark.parametrize(
    ("cycle_s", "max_request_age_s", "cycles"),
    [(0.012, 0.12, 10), (0.012, 0.06, 5), (0.012, 9.0, 10), (0.004, 0.12, 10), (0.004, 0.02, 5)],
)
def test_the_stricter_of_table_and_cell_bounds_the_age_of_requests_and_commands(
    cycle_s, max_request_age_s, cycles
):
    robot = made(cycle_s, max_request_age_s=max_request_age_s)
    assert robot.max_age_cycles == cycles
    assert robot.inbox._max_age_cycles == cycles


# An increment in hand: the gate, real Robot Servers' cores behind it, and anything that may happen between them.

DECIDED = (Outcome.ADMITTED, Outcome.SCALED, Outcome.HELD)


@pytest.fixture
def rig():
    return Rig()


def missed(rig):
    """FR's admission comes too late for its cycle."""
    rig.mail["fr"] = (None, rig.mail["fr"][1])
    rig.cycle()


def test_an_increment_with_a_late_admission_is_decided_again_for_the_next_cycle(rig):
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


def test_each_carried_over_increment_is_counted(rig):
    for count in (1, 2, 3):
        rig.request()
        missed(rig)
        assert rig.alive().outcome is Outcome.ADMITTED
        rig.cycle()
        assert rig.sim.counters["in_hand_fr"] == count


def test_an_increment_with_a_taken_admission_is_not_decided_again(rig):
    rig.request()
    rig.cycle()
    assert rig.alive() is None
    rig.cycle()
    assert rig.state.dq != SMALL
    assert rig.sim.counters["in_hand_fr"] == 0


def test_an_increment_is_carried_over_by_one_cycle_and_not_by_two(rig):
    rig.request()
    missed(rig)
    assert rig.alive().outcome is Outcome.ADMITTED
    missed(rig)
    assert rig.alive() is None


def test_a_newer_increment_replaces_a_carried_over_one_and_its_client_learns_it(rig):
    rig.request(seq=1)
    missed(rig)
    newer = rig.request(seq=2)
    assert (newer.seq, newer.outcome) == (2, Outcome.ADMITTED)
    older = next(said for said in rig.said if isinstance(said, Verdict))
    assert (older.seq, older.outcome, older.setpoint_cycle) == (1, Outcome.REFUSED, None)
    assert older.reasons[0].code is ReasonCode.SUPERSEDED


def test_with_a_silent_hli_no_increment_is_carried_over(rig):
    rig.request()
    missed(rig)
    rig.cycle()
    stale = rig.verdict()
    told = {"what": "cycle", "value": rig.state.cycle - 2, "bound": rig.state.cycle - 1}
    assert stale.reasons == (Reason(code=ReasonCode.STALE_CYCLE, **told),)
    assert rig.alive() is None
    assert rig.state.phase is Phase.READY


def test_no_increment_is_carried_over_into_the_next_lease(rig):
    rig.request()
    missed(rig)
    verdict = rig.alive(lease_epoch=2)
    assert verdict.reasons == (Reason(code=ReasonCode.LEASE_NOT_HELD, what="lease"),)
    assert rig.alive() is None


def test_no_carried_over_increment_survives_a_stop_or_a_reset(rig):
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


def test_a_reset_of_a_moving_robot_drops_its_carried_over_increment(rig):
    rig.request()
    rig.request(seq=9)
    rig.command(kind="reset", robot="fr")
    assert rig.verdict().reasons[0].code is ReasonCode.STOPPED
    missed(rig)
    assert rig.alive() is None


def test_no_carried_over_increment_survives_its_robot_server(rig):
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
def test_an_increment_gets_the_setpoint_after_those_in_flight(decided_cycle, step, goes_after, due):
    assert waiting(decided_cycle, step) == (goes_after, due)


@pytest.mark.parametrize("decided_cycle", [19, 20, 22])
def test_after_a_broken_chain_the_lookahead_is_filled_again(decided_cycle):
    inbox = Inbox(joints=6, max_age_cycles=10, lookahead_cycles=3)
    inbox.decided_cycle = decided_cycle
    inbox.cycle_passed(20, missed=False)
    assert inbox.decided_cycle == decided_cycle
    inbox.cycle_passed(20, missed=True)
    assert inbox.goes_after(server_state("fr", 20)) == 22
