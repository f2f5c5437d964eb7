"""Faults over real processes, zenoh and UDP: the table's live half, and a fault in a cell that is up."""

import json
import subprocess

import pytest
from commands import PROGRAM

from deltaq_cell.load import load_cell
from deltaq_launch.private_cell import write_private_cell
from deltaq_protocol.errors import ServiceUnreachableError
from deltaq_verification.faults.catalogue import CATALOGUE, UnknownFaultError, fault_named
from deltaq_verification.faults.clocks import NoCompilerError
from deltaq_verification.faults.inject import inject
from deltaq_verification.faults.table import run_table

pytestmark = pytest.mark.live


@pytest.mark.nightly
def test_a_frozen_gate_and_a_dead_robot_server_are_survived_by_real_processes(tmp_path):
    file = write_private_cell(tmp_path)
    faults = [fault_named("robot-server-dead"), fault_named("sim-frozen")]
    dead, frozen = run_table(file, "fr", faults=faults, live=True).rows
    assert (frozen.good, frozen.reason, frozen.recovery) == (True, "gate_lost", "reset")
    assert frozen.motion.rest_after_s < 0.3
    assert (dead.good, dead.phase) == (True, "offline")
    assert dead.motion.travel_rad < 0.1
    assert dead.motion.rest_after_s > 0.03  # along its brake, not at once
    assert dead.recovery == "restart of the robot-server, KRC: restart, reset"


@pytest.mark.nightly
def test_a_time_of_day_that_is_set_back_in_every_service_brakes_nobody(tmp_path):
    (row,) = run_table(
        write_private_cell(tmp_path), "fr", faults=[fault_named("wall-clock-back")], live=True
    ).rows
    assert row.good
    assert (row.reason, row.recovery) == (None, "by itself")


@pytest.mark.nightly
def test_an_hli_whose_clock_leaps_has_the_robot_held_though_its_sessions_broke_as_it_said_so(tmp_path):
    faults = [fault_named("hli-clock-forward")]
    (row,) = run_table(write_private_cell(tmp_path), "fr", faults=faults, live=True).rows
    assert (row.good, row.phase, row.reason) == (True, "held", "controller_lost")
    assert row.recovery == "reset"


def test_clocks_cannot_be_set_without_a_compiler(tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(NoCompilerError, match="leave out the faults of clocks"):
        run_table(write_private_cell(tmp_path), "fr", faults=[fault_named("wall-clock-drift")], live=True)


@pytest.mark.nightly
@pytest.mark.timeout(0)
def test_no_fault_of_a_real_process_passes_a_limit_or_touches(tmp_path):
    table = run_table(write_private_cell(tmp_path), "fr", faults=CATALOGUE, live=True)
    assert [row.fault for row in table.rows if not row.good] == []


def test_a_fault_is_injected_into_a_cell_that_is_up_and_lifted_again(ready_stack):
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
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert (found["phase"], found["reason"]) == ("held", "krc_lost")
    again = inject(fault_named("krc-hiccup"), ready_stack.cell, "fr", 0.0)
    assert again.krc_state == "RSI running"  # nothing is cut any more


def test_a_fault_that_no_panel_can_inject_is_refused_before_anything_is_asked():
    with pytest.raises(UnknownFaultError, match=r"sim-dead cannot be injected .* allowed are krc-cut, "):
        inject(fault_named("sim-dead"), load_cell("lab"), "fr", 0.0)


@pytest.mark.parametrize(
    ("name", "live", "way"),
    [
        ("sim-slow", True, "live"),
        ("hli-clock-back", True, "live"),
        ("hli-sim-broken", False, "virtual"),
        ("wall-clock-back", False, "virtual"),
        ("krc-server-cut", False, "virtual"),
    ],
)
def test_a_fault_that_cannot_be_had_this_way_is_told(name, live, way):
    with pytest.raises(UnknownFaultError, match=f"can be had .*{way}"):
        run_table("lab", "fr", faults=[fault_named(name)], live=live)


def test_a_cell_that_is_not_up_is_told(tmp_path):
    description = load_cell(write_private_cell(tmp_path))
    with pytest.raises(ServiceUnreachableError):
        inject(fault_named("krc-hiccup"), description, "fr", 0.0)
