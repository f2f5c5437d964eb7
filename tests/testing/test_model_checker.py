"""The explorer: what holds of Robot Server and SIM within its bounds, and that it can find what does not."""

import json
import re
import shlex
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from deltaq_proofs.model_checker.attacked import AttackedSystem
from deltaq_proofs.model_checker.explore import explore
from deltaq_proofs.model_checker.one_joint import CYCLE_S, IPOC_STEP, STEP
from deltaq_proofs.model_checker.rsi_line import SECOND_AT
from deltaq_proofs.model_checker.safety_monitor import Property
from deltaq_proofs.model_checker.seeded_bugs import (
    BROKEN,
    ChainIsNotLookedAt,
    ResetIgnoresRest,
    SessionIsTakenInAnyPhase,
    SilentGateIsIgnored,
)
from deltaq_proofs.model_checker.system import System
from deltaq_protocol.messages import Phase
from deltaq_services.robot_server.mode_probe import KinematicMode
from deltaq_services.robot_server.session import Belief, Run

MOST_CYCLES = 40
LONG_TO_BE_FOUND = (ChainIsNotLookedAt, ResetIgnoresRest, SessionIsTakenInAnyPhase, SilentGateIsIgnored)
PAGE = Path(__file__).parents[2] / "docs" / "notes" / "what-is-proved-of-the-phases.md"


def documented():
    blocks = re.findall(r"^```sh\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return [line for block in blocks for line in block.splitlines()]


def tabulated():
    """What each row of the page's tables says, by the titles of its columns."""
    titles, rows = [], []
    for line in PAGE.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("| ").split("|")]
        if not line.startswith("|"):
            titles = []
        elif not titles:
            titles = [cell.partition(" on one path")[0] for cell in cells]
        elif set(line) != set("| -"):
            rows.append(dict(zip(titles, cells, strict=True)))
    return rows


def takes_long(row):
    return int(row["states"]) > 6_000


@pytest.mark.long
@pytest.mark.parametrize(
    "row",
    [pytest.param(row, marks=pytest.mark.nightly if takes_long(row) else ()) for row in tabulated()],
    ids=lambda row: "-".join(f"{title} {cell}" for title, cell in row.items()),
)
def test_every_property_holds_in_the_documented_states(row):
    faults, attacks = int(row["faults"]), row.get("attacks")
    system = System(int(row.get("lookahead", 1))) if attacks is None else AttackedSystem(int(attacks))
    bounded = row["cycles"] != "any number"
    found = explore(system, faults, int(row["cycles"]) if bounded else MOST_CYCLES)
    assert found.counterexample is None
    assert found.complete is not bounded
    assert (found.states, found.moves) == (int(row["states"]), int(row["moves"]))


def test_every_table_of_the_page_is_checked():
    assert len(tabulated()) == 9


@pytest.mark.nightly
@pytest.mark.parametrize(
    "line",
    documented(),
    ids=[line.partition("model ")[2] for line in documented()],
)
def test_the_documented_commands_find_every_property_true(line):
    command = [sys.executable, *shlex.split(line)[1:]]
    ended = subprocess.run([*command, "--json"], capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert json.loads(ended.stdout)["holds"]


@pytest.mark.long
@pytest.mark.parametrize(
    "broken",
    [
        pytest.param(one, marks=pytest.mark.nightly if one.system in LONG_TO_BE_FOUND else ())
        for one in BROKEN
    ],
    ids=lambda broken: broken.system.__name__,
)
def test_a_broken_system_is_detected(broken):
    found = explore(broken.system(), broken.faults, cycles=10)
    assert found.counterexample is not None
    assert found.counterexample.violation.broken is broken.breaks


@pytest.mark.nightly
@pytest.mark.parametrize(
    "broken",
    [one for one in BROKEN if issubclass(one.system, AttackedSystem)],
    ids=lambda broken: broken.system.__name__,
)
def test_the_intact_system_holds_beyond_the_depth_of_every_counterexample(broken):
    found = explore(broken.system(), broken.faults, cycles=10)
    assert found.counterexample is not None
    assert explore(AttackedSystem(), broken.faults, found.cycles + 1).counterexample is None


@pytest.mark.nightly
@pytest.mark.timeout(0)
@pytest.mark.parametrize(("attacks", "faults", "cycles"), [(1, 0, 7), (2, 0, 5), (1, 1, 4)])
def test_with_more_attacks_every_property_holds(attacks, faults, cycles):
    assert explore(AttackedSystem(attacks), faults, cycles).counterexample is None


def with_changed(part, **changes):
    """The snapshot of a part in which some attributes have other values."""
    changed = part.snapshot()
    vars(changed).update(changes)
    return changed


def test_the_wires_state_key_covers_all_memory_of_the_driver():
    line = AttackedSystem(1).start(0).line
    fixed = {"_codec", "_counters", "_plausible", "_near", "_most", "_widest", "_zero"}
    of_one_call = {"unmoved", "implausible", "fault", "detail"}
    of_the_origin = {"_lower", "_upper"}
    of_none = {"_outputs", "meter"}  # none are sent, and no cycle is measured
    told = {"session", "_origin", "_sent", "_earlier", "_opened"}
    assert set(vars(line.driver)) == told | fixed | of_one_call | of_the_origin | of_none
    fixed = {"_given_step", "_plausible", "_near", "_cycle_s", "_silence_s", "_silence_cycles", "_least_s"}
    assert set(vars(line.driver.session)) == {"belief", "step", "last", "_time_s", "_run"} | fixed
    assert set(vars(line.peer)) == {"address", "_heard_s"} | {"stranger", "_krc_address", "_silence_s"}


def _changed_sessions(line):
    session = line.driver.session
    changes = {
        "belief": Belief.DOUBTED,
        "step": IPOC_STEP + 1,
        "last": session.last._replace(ipoc=session.last.ipoc - IPOC_STEP),
        "_time_s": session._time_s - CYCLE_S,
        "_run": Run(1, session._time_s, None, session.last),
    }
    sessions = [with_changed(session, **{name: value}) for name, value in changes.items()]
    return [{"driver": with_changed(line.driver, session=one)} for one in sessions]


def _changed_drivers(line):
    origin, sent = line.driver._origin, line.driver._sent
    changes = {
        "_origin": origin + STEP,
        "_sent": sent + STEP,
        "_earlier": ((origin, sent),),
        "_opened": True,
    }
    return [{"driver": with_changed(line.driver, **{name: value})} for name, value in changes.items()]


def _changed_peers(line):
    changes = {"address": SECOND_AT, "_heard_s": line.peer._heard_s - CYCLE_S}
    return [{"peer": with_changed(line.peer, **{name: value})} for name, value in changes.items()]


@pytest.mark.parametrize("changed", [_changed_sessions, _changed_drivers, _changed_peers])
def test_states_of_the_wire_that_differ_in_one_field_are_distinguished(changed):
    system = AttackedSystem(1)
    system_state = system.start(0)
    assert system.start(0).key() == system_state.key()
    for change in changed(system_state.line):
        other = replace(system_state, line=replace(system_state.line, **change))
        assert other.key() != system_state.key(), change


def test_states_of_the_wire_that_differ_in_an_earlier_correction_are_distinguished():
    system_state = AttackedSystem(1).start(0)
    line, driver = system_state.line, system_state.line.driver
    keys = {
        replace(
            system_state,
            line=replace(
                line, driver=with_changed(driver, _earlier=((driver._origin, driver._sent + more),))
            ),
        ).key()
        for more in (0.0, STEP)
    }
    assert len(keys) == 2


@pytest.mark.long
def test_a_counterexample_is_a_shortest_path():
    late = next(broken for broken in BROKEN if broken.system.__name__ == "LateIsTaken")
    found = explore(late.system(), late.faults, cycles=10).counterexample
    assert found is not None
    turns = len(found.moves)
    assert turns % 3 == 1  # it ends with the telegram that moved the robot
    shorter = explore(late.system(), late.faults, cycles=turns // 3)
    assert shorter.counterexample is None


@pytest.mark.long
def test_every_phase_is_reached():
    system, phases = System(), set()
    frontier, seen = [system.start(0)], set()
    while frontier and phases != set(Phase):
        system_state = frontier.pop(0)
        if system_state.server.state is not None:
            phases.add(system_state.server.state.phase)
        for move in system.moves(system_state):
            assert move.system_state is not None
            key = repr(move.system_state.key())
            if key not in seen:
                seen.add(key)
                frontier.append(move.system_state)
    assert phases == set(Phase)


def test_the_state_key_covers_all_memory_of_the_robot_server():
    told = {
        "state": {
            "process", "_motion", "_epoch", "_phase", "_reason", "_cycle", "_q_reset", "_told", "_state",
        },
        "key": {
            "_cycles_without_gate", "_cycles_missed", "_settling", "_resets", "motion_stop", "_admissions",
        },
        "nobody sets one": {"outputs", "_tool"},
        "none since the robot is kinematic": {"_mode", "_lag", "_pulses", "_unwatched"},
        "handed to each cycle": {"_supervision"},
        "no crash brake": {"guarded"},
        "fixed": {
            "robot", "counters", "containment", "_identity", "_bounds", "_new_mode", "_new_lag_watch",
            "_gate_timeout_cycles", "_krc_timeout_cycles",
        },
    }  # fmt: skip
    assert set(vars(System().start(0).server)) == set.union(*told.values())


@pytest.mark.parametrize("system", [System, AttackedSystem])
def test_the_explored_robot_has_a_mode_without_memory(system):
    system_state = system().start(0)
    while system_state.server.state is None:
        system_state = next(system().moves(system_state)).system_state
    assert isinstance(system_state.server._mode, KinematicMode)
    assert not vars(system_state.server._mode)


@pytest.mark.long
@pytest.mark.nightly
def test_the_command_prints_its_findings_and_exits_with_1_for_a_counterexample():
    command = [sys.executable, "-m", "deltaq_proofs.model_checker", "--json", "--broken", "LateIsTaken"]
    ended = subprocess.run([*command, "--cycles", "4"], capture_output=True, text=True, check=False)
    assert ended.returncode == 1, ended.stderr
    printed = json.loads(ended.stdout)
    assert printed["holds"] is False
    assert printed["faults"] == 1  # what it takes to see it
    assert printed["counterexample"]["moves"][-1].startswith("telegram")
    assert set(printed["properties"]) == {one.name.lower() for one in Property}
