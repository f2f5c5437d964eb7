"""Standing orders to one Robot Server: when a stop and a reset are given, refused and done."""

import pytest
from small_cell import admission_after, server_state, small_cell

from deltaq_protocol.guarded import Admission, OrdersMemory, Plan, Supervision
from deltaq_protocol.messages import Phase
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.orders import Orders, SparedSupervision
from deltaq_services.sim.tracker import Tracker
from deltaq_services.sim.tube import DriveBounds

LAG = 4
CYCLE_S = small_cell().cycle_s
HLI_TIMEOUT = 5
TOLERANCE_OFF = 0.3
"""Further off its setpoint than any joint of the small cell may be [rad]."""


class Rig:
    """The orders to one robot, which reports what it is told to report."""

    def __init__(self, robot="fr"):
        self.robot = robot
        description = small_cell().robots[robot]
        drives = DriveBounds(LAG - 1, description.tracking_tolerance.copy(), 0.0)
        self.tracker = Tracker(robot, description, drives, CYCLE_S)
        self.orders = Orders(self.tracker, HLI_TIMEOUT)
        self.cycle = 100

    def state(self, phase=Phase.READY, **changes):
        """One cycle of the robot passes."""
        self.cycle += 1
        self.tracker.observe(server_state(self.robot, self.cycle, phase, **changes))
        self.orders.cycle_passed()
        self.orders.judge()
        return self.orders

    def settled(self, phase=Phase.READY, **changes):
        """The robot has been at rest for as long as its drives lag."""
        for _ in range(LAG):
            self.state(phase, **changes)
        return self.orders

    def repeat(self, **changes):
        """The Robot Server speaks again in the same cycle."""
        self.tracker.observe(self.tracker.state.model_copy(update=changes))
        self.orders.repeated(self.tracker.state)


@pytest.fixture
def rig():
    return Rig()


def refusal(orders):
    answer = orders.reset(1)
    assert answer is not None
    return answer[0]


def test_a_healthy_robot_gets_no_order(rig):
    orders = rig.settled()
    assert (orders.standing_stop, orders.resets, orders.outputs) == (None, 0, {})


def test_the_first_reason_of_a_stop_is_kept_until_the_robot_holds(rig):
    orders = rig.settled()
    orders.stop(ReasonCode.OPERATOR_STOP)
    orders.stop(ReasonCode.HLI_LOST)
    assert rig.state(Phase.BRAKING).standing_stop is ReasonCode.OPERATOR_STOP
    assert rig.state(Phase.HELD).standing_stop is None


def test_a_stop_during_a_reset_survives_that_reset(rig):
    orders = rig.settled(Phase.HELD)
    assert orders.reset(1) is None
    orders.stop(ReasonCode.OPERATOR_STOP)
    assert rig.state(Phase.HELD, resets=0).standing_stop is ReasonCode.OPERATOR_STOP
    assert rig.state(Phase.READY, resets=1).standing_stop is ReasonCode.OPERATOR_STOP
    assert rig.state(Phase.HELD, resets=1).standing_stop is None


@pytest.mark.parametrize("phase", [Phase.READY, Phase.ENGAGED, Phase.BRAKING])
def test_a_robot_off_its_path_is_stopped_in_every_phase_in_which_it_may_move(rig, phase):
    q = (0.1 + TOLERANCE_OFF, *(0.1,) * 5)
    assert rig.state(phase, q=q).standing_stop is ReasonCode.TRACKING_ERROR


@pytest.mark.parametrize("phase", [Phase.OFFLINE, Phase.HELD])
def test_a_robot_that_may_not_move_is_not_stopped_again(rig, phase):
    rig.orders.hli_heard()
    for _ in range(HLI_TIMEOUT + 2):
        rig.state(phase, q=(0.1 + TOLERANCE_OFF,) * 6)
    assert rig.orders.standing_stop is None


def test_an_hli_may_be_silent_for_its_timeout_and_no_cycle_longer(rig):
    rig.orders.hli_heard()
    for _ in range(HLI_TIMEOUT):
        rig.state()
    assert rig.orders.standing_stop is None
    assert rig.state().standing_stop is ReasonCode.HLI_LOST


def test_every_heartbeat_of_the_hli_restarts_its_timeout(rig):
    for _ in range(3 * HLI_TIMEOUT):
        rig.orders.hli_heard()
        rig.state()
    for _ in range(HLI_TIMEOUT - 1):
        rig.state()
    assert rig.orders.standing_stop is None


def test_an_hli_without_any_message_is_not_missed(rig):
    for _ in range(HLI_TIMEOUT + 5):
        rig.state()
    assert rig.orders.standing_stop is None


def test_a_robot_without_a_state_is_not_reset(rig):
    assert refusal(rig.orders) is ReasonCode.UNREACHABLE


def test_a_silent_krc_is_a_persistent_cause_until_its_next_cycle(rig):
    rig.settled(Phase.HELD)
    rig.repeat(reason=ReasonCode.KRC_LOST)
    assert refusal(rig.orders) is ReasonCode.CAUSE_STANDS
    rig.state(Phase.HELD)
    assert rig.orders.reset(1) is None


def test_a_repeated_state_without_a_lost_krc_is_no_cause(rig):
    rig.settled(Phase.HELD)
    rig.repeat(reason=ReasonCode.OPERATOR_STOP)
    assert rig.orders.reset(1) is None


def test_an_overtaken_state_says_nothing_about_the_krc(rig):
    orders = rig.settled(Phase.HELD)
    orders.repeated(server_state("fr", rig.cycle - 1, Phase.HELD, reason=ReasonCode.KRC_LOST))
    assert orders.reset(1) is None


def test_a_stop_that_no_state_shows_yet_refuses_a_reset(rig):
    orders = rig.settled()
    orders.stop(ReasonCode.OPERATOR_STOP)
    assert refusal(orders) is ReasonCode.NOT_AT_REST


def test_a_held_robot_that_still_moves_is_not_reset(rig):
    rig.settled(Phase.HELD)
    rig.state(Phase.HELD, plan=Plan(dq=(0.001,) * 6, brake_cycles=3, step=0))
    assert refusal(rig.orders) is ReasonCode.NOT_AT_REST


def test_a_held_robot_off_its_setpoint_is_not_reset_and_the_joint_is_named(rig):
    orders = rig.settled(Phase.HELD, q=(0.1, 0.1, 0.1 + TOLERANCE_OFF, 0.1, 0.1, 0.1))
    code, message = orders.reset(1)
    assert code is ReasonCode.CAUSE_STANDS
    assert message.startswith("joint 3 of fr is 0.3000 rad off its setpoint, at most ")


def test_a_joint_of_a_gantry_is_off_its_setpoint_in_metres():
    orders = Rig("gr").settled(Phase.HELD, q=(0.1 + TOLERANCE_OFF,) + 8 * (0.1,))
    assert orders.reset(1)[1].startswith("joint 1 of gr is 0.3000 m off its setpoint, at most ")


def test_a_reset_asks_for_one_more_than_the_robot_has_had(rig):
    orders = rig.settled(Phase.HELD, resets=4)
    assert orders.reset(1) is None
    assert orders.resets == 5


def test_a_reset_is_done_when_the_robot_shows_it_and_is_answered_once(rig):
    orders = rig.settled(Phase.HELD)
    orders.reset(11)
    orders.reset(12)
    assert orders.fulfilled() == []
    assert rig.state(Phase.READY, resets=0).fulfilled() == []  # this one the robot has not shown
    assert rig.state(Phase.HELD, resets=1).fulfilled() == []
    assert rig.state(Phase.READY, resets=1).fulfilled() == [11, 12]
    assert orders.fulfilled() == []


def test_a_reset_of_a_robot_that_is_not_held_is_done_at_once_and_resets_nothing(rig):
    orders = rig.settled()
    assert orders.reset(7) is None
    assert orders.resets == 0
    assert orders.fulfilled() == [7]


def test_no_reset_is_done_before_the_robots_first_state(rig):
    assert rig.orders.fulfilled() == []


def test_the_reset_count_of_an_earlier_gate_is_adopted(rig):
    assert rig.state(resets=3).resets == 3


def test_a_stop_is_answered_when_the_robot_shows_it_and_once(rig):
    orders = rig.settled()
    for id_ in (31, 32, 31):
        orders.answer_when_stopped(id_)
    assert (orders.awaits_stop(31), orders.awaits_stop(33)) == (True, False)
    assert orders.latched() == []
    assert rig.state(Phase.BRAKING).latched() == []
    assert rig.state(Phase.HELD).latched() == [31, 32]
    assert not orders.awaits_stop(31)
    assert orders.latched() == []


@pytest.mark.parametrize("phase", [Phase.HELD, Phase.OFFLINE])
def test_a_robot_that_takes_no_admission_shows_a_stop_already(rig, phase):
    orders = rig.settled(phase)
    orders.answer_when_stopped(31)
    assert not orders.awaits_stop(31)
    assert orders.latched() == []


def test_a_hold_that_a_reset_is_about_to_end_answers_no_stop(rig):
    orders = rig.settled(Phase.HELD)
    orders.reset(11)
    orders.answer_when_stopped(31)
    assert rig.state(Phase.HELD).latched() == []
    assert orders.awaits_stop(31)
    assert rig.state(Phase.HELD, resets=1).latched() == [31]


def test_a_robot_without_a_state_confirms_no_stop(rig):
    rig.orders.answer_when_stopped(31)
    assert rig.orders.awaits_stop(31)
    assert rig.orders.latched() == []


def test_of_many_waiting_stops_the_last_are_answered(rig):
    orders = rig.settled()
    for id_ in range(100):
        orders.answer_when_stopped(id_)
    assert rig.state(Phase.HELD).latched() == list(range(36, 100))


def test_only_given_orders_are_remembered(rig):
    nothing = OrdersMemory(
        standing_stop=None, resets=0, outputs={}, cycles_without_hli=None, krc_silent=False, awaited_resets=()
    )
    assert rig.orders.snapshot() == nothing
    assert rig.state().snapshot() == nothing


def test_orders_continue_from_a_restored_snapshot(rig):
    orders = rig.settled(Phase.HELD, resets=2)
    orders.outputs["gripper"] = True
    orders.hli_heard()
    orders.cycle_passed()
    orders.reset(21)
    orders.answer_when_stopped(22)
    orders.stop(ReasonCode.HLI_LOST)
    rig.repeat(reason=ReasonCode.KRC_LOST)
    memory = orders.snapshot()
    heir = Orders(rig.tracker, HLI_TIMEOUT)
    heir.restore(memory)
    assert heir.snapshot() == memory
    assert (memory.standing_stop, memory.resets, memory.outputs) == (
        ReasonCode.HLI_LOST,
        3,
        {"gripper": True},
    )
    assert (memory.cycles_without_hli, memory.krc_silent) == (1, True)
    assert (memory.awaited_resets, memory.awaited_stops) == ((21,), (22,))
    heir.outputs["gripper"] = False
    assert orders.outputs == {"gripper": True}


def sent_of(spared, cycles, admits=True, robot="fr", **orders):
    """In which of these cycles the supervision is sent; each may end with an admission."""
    told = []
    for cycle in range(cycles):
        if not spared.spares(Supervision(robot=robot, epoch=1, cycle=cycle, **orders)):
            told.append(cycle)
        if admits:
            admission: Admission = admission_after(server_state(robot, cycle), [0.0] * 6, 1)
            assert not spared.spares(admission)
    return told


def test_supervision_is_sent_in_every_cycle_without_an_admission_before_it():
    assert sent_of(SparedSupervision(40), 5, admits=False) == [0, 1, 2, 3, 4]


def test_during_admissions_repeated_orders_are_sent_every_fourth_cycle():
    assert sent_of(SparedSupervision(40), 10) == [0, 4, 8]


def test_stops_and_changed_orders_are_never_omitted():
    spared = SparedSupervision(40)
    assert sent_of(spared, 3, stop=ReasonCode.OPERATOR_STOP) == [0, 1, 2]
    for changed in ({"resets": 1}, {"outputs": {"gripper": True}}, {"cell": "other"}, {}):
        assert sent_of(spared, 3, **changed) == [0]


def test_later_changes_of_an_outputs_map_do_not_affect_the_comparison():
    spared, outputs = SparedSupervision(40), {"gripper": False}
    assert sent_of(spared, 2, outputs=outputs) == [0]
    outputs["gripper"] = True
    assert sent_of(spared, 2, outputs=outputs) == [0]


def test_an_admission_of_one_robot_omits_no_order_of_another():
    spared = SparedSupervision(40)
    sent_of(spared, 1)
    assert sent_of(spared, 3, admits=False, robot="gr") == [0, 1, 2]


def test_with_short_timeouts_no_order_is_omitted():
    assert sent_of(SparedSupervision(3), 4) == [0, 1, 2, 3]
