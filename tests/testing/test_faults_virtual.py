"""Faults in virtual time: what they do to a robot at cruising speed, and what it takes to go on."""

from pathlib import Path

import pytest

from deltaq_emulator.faults import LinkFaults
from deltaq_services.phases import MAY_MOVE
from deltaq_testing.faults.catalogue import CATALOGUE, UnknownFaultError, fault_named
from deltaq_testing.faults.mover import CRUISE_RAD_S
from deltaq_testing.faults.panel import load_rsi_cell
from deltaq_testing.faults.report import BY_ITSELF
from deltaq_testing.faults.virtual import markdown, run_fault, run_table
from deltaq_testing.virtual_cell.cell import VirtualCell
from deltaq_testing.virtual_cell.parts import Link, MessageWire, Process

BRAKE_S = CRUISE_RAD_S / 10.9
"""A1 of the floor robot brakes at 10.9 rad/s^2."""
ROUND_TRIP_CYCLES = 3
"""From a state over an admission to the setpoint in the KRC."""


@pytest.fixture(scope="module")
def lab():
    return load_rsi_cell("lab")


@pytest.fixture(scope="module")
def with_lookahead(lab, tmp_path_factory):
    """The same by its lookahead."""
    cells = {1: lab}
    for cycles in (2, 3):
        file = tmp_path_factory.mktemp("cell") / "ahead.yaml"
        file.write_text(f"extends: lab.yaml\ncell: ahead\ngate: {{lookahead_cycles: {cycles}}}\n")
        cells[cycles] = load_rsi_cell(file)
    return cells


@pytest.fixture(scope="module")
def ahead(with_lookahead):
    """The same with a lookahead of 2."""
    return with_lookahead[2]


def assert_braked_at_once_along_the_brake(row, cycle_s=0.012):
    assert row.good
    assert row.motion.braked_after_cycles <= ROUND_TRIP_CYCLES
    assert row.motion.rest_after_s <= BRAKE_S + (ROUND_TRIP_CYCLES + 1) * cycle_s
    assert row.motion.travel_rad <= CRUISE_RAD_S * (BRAKE_S / 2 + (ROUND_TRIP_CYCLES + 1) * cycle_s)
    assert row.kept.abrupt_cycles == 0


@pytest.mark.by_day(3)
@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "reason", "named_s", "recovery"),
    [
        ("operator-stop", "operator_stop", 0.05, "reset"),
        ("controller-dead", "controller_lost", 0.05, "restart of the controller, reset"),
        ("controller-frozen", "controller_lost", 1.1, "reset"),
        ("hli-dead", "hli_lost", 0.6, "restart of the hli, reset"),
        ("hli-frozen", "hli_lost", 0.6, "reset"),
        ("hli-begins-in-the-past", "hli_lost", 0.6, "restart of the hli, reset"),
        ("hli-sim-cut", "hli_lost", 0.6, "reset"),
        ("sim-dead", "gate_lost", 0.6, "restart of the sim, reset"),
        ("sim-frozen", "gate_lost", 0.6, "reset"),
        ("sim-server-cut", "gate_lost", 0.6, "reset"),
    ],
)
def test_a_loss_brakes_the_robot_at_once_and_holds_it_with_its_reason(lab, name, reason, named_s, recovery):
    row = run_fault(fault_named(name), lab, "fr")
    assert_braked_at_once_along_the_brake(row)
    assert (row.phase, row.reason, row.recovery) == ("held", reason, recovery)
    assert row.named_after_s <= named_s


@pytest.mark.by_day(2)
@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "later_cycles"),
    [
        ("operator-stop", 0),
        ("controller-dead", 0),
        ("controller-frozen", 1),
        ("hli-dead", 1),
        ("sim-dead", 1),
    ],
)
def test_with_a_lookahead_admissions_in_flight_are_executed_first_and_a_stop_is_as_quick(
    lab, ahead, name, later_cycles
):
    row, before = run_fault(fault_named(name), ahead, "fr"), run_fault(fault_named(name), lab, "fr")
    assert row.good
    assert (row.phase, row.reason, row.recovery) == (before.phase, before.reason, before.recovery)
    assert row.motion.braked_after_cycles == before.motion.braked_after_cycles + later_cycles
    assert row.motion.rest_after_s == pytest.approx(before.motion.rest_after_s + later_cycles * 0.012)


@pytest.mark.long
def test_with_a_lookahead_a_gate_one_cycle_late_costs_nothing(ahead):
    row = run_fault(fault_named("sim-slow"), ahead, "fr")
    assert row.good
    assert (row.phase, row.motion.braked_after_cycles) == ("engaged", None)


@pytest.mark.long
def test_increments_of_nan_brake_the_robot_and_their_sender_keeps_the_lease(lab):
    row = run_fault(fault_named("controller-nan-flood"), lab, "fr")
    assert_braked_at_once_along_the_brake(row)
    assert (row.phase, row.reason, row.recovery) == ("ready", None, BY_ITSELF)


@pytest.mark.long
def test_a_slow_gate_counts_as_lost_and_its_robot_resumes_with_a_quick_one(lab):
    row = run_fault(fault_named("sim-slow"), lab, "fr")
    assert_braked_at_once_along_the_brake(row)
    assert (row.phase, row.reason, row.recovery) == ("ready", None, BY_ITSELF)


@pytest.mark.long
def test_a_jump_of_the_controller_exceeds_no_limit(lab):
    row = run_fault(fault_named("controller-leap"), lab, "fr")
    assert row.good
    assert row.kept.abrupt_cycles == 0


@pytest.mark.long
def test_the_robot_of_a_dead_robot_server_is_braked(lab):
    row = run_fault(fault_named("robot-server-dead"), lab, "fr")
    assert row.good
    assert 0.03 < row.motion.rest_after_s < 0.1
    assert row.kept.abrupt_cycles == 0
    assert row.recovery == "restart of the robot-server, KRC: restart, reset"


@pytest.mark.long
def test_lost_replies_stop_the_robot_for_a_cycle_without_a_jump(lab):
    row = run_fault(fault_named("krc-replies-lost"), lab, "fr")
    assert row.good
    assert 0 < row.kept.abrupt_cycles <= 2 * row.kept.unanswered_cycles
    assert row.recovery == BY_ITSELF


@pytest.mark.long
def test_duplicated_telegrams_change_nothing(lab):
    row = run_fault(fault_named("krc-duplicating"), lab, "fr")
    assert row.good
    assert row.motion.braked_after_cycles is None


@pytest.mark.long
def test_an_earlier_reset_does_not_reset_a_restarted_robot_server(lab):
    stack = VirtualCell(lab)
    arm = stack.arms["fr"]

    def cycle(count):
        for _ in range(count):
            stack.cycle()

    cycle(60)
    stack.stop()
    cycle(60)
    stack.reset("fr")
    cycle(60)
    assert arm.state.phase in MAY_MOVE
    arm.kill()
    cycle(10)
    arm.start()
    arm.krc.restart()  # the process beside the one that died has ended its motion
    cycle(60)
    stack.stop()
    cycle(60)
    assert arm.state.phase == "held"  # nobody has reset it


@pytest.mark.long
def test_a_delayed_reset_releases_no_robot(lab):
    stack, to_sim = VirtualCell(lab), MessageWire()
    stack.plug(Link.HLI_SIM, Process.SIM, to_sim, ("fr", None))

    def cycle(duration_s):
        for _ in range(round(duration_s / 0.012)):
            stack.cycle()

    cycle(0.6)
    stack.stop()
    cycle(0.6)
    stack.reset("fr")  # the first command tells the HLI which gate this is
    cycle(0.6)
    assert stack.arms["fr"].state.phase in MAY_MOVE
    stack.stop()
    cycle(0.6)
    assert stack.arms["fr"].state.phase == "held"
    to_sim.link.faults = LinkFaults(delay_s=0.3)  # the HLI is still heard, 0.3 s late
    asked = stack.reset("fr")
    cycle(0.6)
    assert [answer.code for answer in asked] == ["stale_cycle"]
    assert stack.arms["fr"].state.phase == "held"


@pytest.mark.nightly
@pytest.mark.parametrize(
    "fault", [fault for fault in CATALOGUE if fault.virtual], ids=lambda fault: fault.name
)
@pytest.mark.parametrize("lookahead_cycles", [1, 2, 3])
def test_no_fault_breaks_a_limit_or_a_distance_and_the_robot_moves_again_after_each(
    with_lookahead, lookahead_cycles, fault
):
    assert run_fault(fault, with_lookahead[lookahead_cycles], "fr").good


@pytest.mark.nightly
@pytest.mark.timeout(0)
def test_the_table_in_the_documents_agrees_with_the_command():
    page = Path(__file__).parents[2] / "docs" / "notes" / "fault-table.md"
    assert markdown(run_table("lab")) in page.read_text(encoding="utf-8")


def test_names_in_the_catalogue_are_unique():
    assert len({fault.name for fault in CATALOGUE}) == len(CATALOGUE)


def test_a_cell_without_krcs_is_refused_with_a_remedy():
    with pytest.raises(UnknownFaultError, match=r"driver is 'kinematic'.*--cell lab"):
        load_rsi_cell("dawm")


def test_an_unknown_robot_is_refused():
    with pytest.raises(UnknownFaultError, match="no robot 'r2' in cell lab; it has fr, gr"):
        run_table("lab", "r2", faults=[fault_named("operator-stop")])
