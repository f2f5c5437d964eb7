"""Faults over real processes, zenoh and UDP: the table's live half, and a fault in a cell that is up."""

import json

import pytest
from commands import PROGRAM
from ran import ran

from deltaq_testing.faults.catalogue import CATALOGUE, fault_named
from deltaq_testing.faults.panel import inject
from deltaq_testing.private_cell import write_private_cell
from studies.live_faults.run import live_table

pytestmark = pytest.mark.live


@pytest.mark.nightly
def test_real_processes_survive_a_frozen_gate_and_a_dead_robot_server(tmp_path):
    file = write_private_cell(tmp_path)
    faults = [fault_named("robot-server-dead"), fault_named("sim-frozen")]
    dead, frozen = live_table(file, "fr", faults=faults).rows
    assert (frozen.good, frozen.reason, frozen.recovery) == (True, "gate_lost", "reset")
    assert frozen.motion.rest_after_s < 0.3
    assert (dead.good, dead.phase) == (True, "offline")
    assert dead.motion.travel_rad < 0.1
    assert dead.motion.rest_after_s > 0.03  # along its brake, not at once
    assert dead.recovery == "restart of the robot-server, KRC: restart, reset"


@pytest.mark.nightly
def test_a_time_of_day_set_back_brakes_no_robot(tmp_path):
    (row,) = live_table(write_private_cell(tmp_path), "fr", faults=[fault_named("wall-clock-back")]).rows
    assert row.good
    assert (row.reason, row.recovery) == (None, "by itself")


@pytest.mark.nightly
def test_a_jumping_clock_of_the_hli_holds_the_robot_despite_broken_sessions(tmp_path):
    faults = [fault_named("hli-clock-forward")]
    (row,) = live_table(write_private_cell(tmp_path), "fr", faults=faults).rows
    assert (row.good, row.phase, row.reason) == (True, "held", "controller_lost")
    assert row.recovery == "reset"


@pytest.mark.nightly
@pytest.mark.timeout(0)
def test_no_fault_of_a_real_process_breaks_a_limit_or_a_distance(tmp_path):
    table = live_table(write_private_cell(tmp_path), "fr", faults=CATALOGUE)
    assert [row.fault for row in table.rows if not row.good] == []


def test_a_fault_is_injected_into_a_running_cell_and_lifted(ready_stack):
    command = [
        PROGRAM,
        "fault",
        "inject",
        "krc-cut",
        "--robot",
        "fr",
        "--cell",
        str(ready_stack.file),
        "--json",
    ]
    done = ran(command)
    found = json.loads(done.stdout)
    assert (found["phase"], found["reason"]) == ("held", "krc_lost")
    again = inject(fault_named("krc-hiccup"), ready_stack.cell, "fr", 0.0)
    assert again.krc_state == "RSI running"  # nothing is cut any more
