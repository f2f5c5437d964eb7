"""A routine on a cell of real processes: stopped half-way or under a fault, reset, and gone on with from Python."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import pytest

import deltaq
from deltaq_controllers.routines.routine import RoutineError
from deltaq_controllers.routines.shell import runs_of, unfinished
from deltaq_protocol.errors import DeltaqError
from deltaq_testing.faults.catalogue import CATALOGUE
from deltaq_testing.live import applies_live
from deltaq_testing.schedule import TimedFault

pytestmark = pytest.mark.live


def wait_until(cell, holds):
    for _ in cell.states("gr"):
        if holds():
            return


def stop_once_it_may_touch(cell):
    wait_until(cell, lambda: cell.status().contacts)
    cell.stop()


def test_a_routine_that_is_stopped_ends_held_and_goes_on_after_a_reset(ready_stack, monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    with deltaq.connect(ready_stack.cell.hli) as cell, cell.lease("gr") as robot:
        with pytest.raises(RoutineError, match="turn is for valve, and gauge_1 is a gauge"):
            robot.run_routine("turn", "gauge_1")
        stop = threading.Thread(target=stop_once_it_may_touch, args=(cell,))
        stop.start()
        with pytest.raises(RoutineError, match=r"hold: held at step .* operator_stop") as stopped:
            robot.run_routine("hold", "point_1", hold_s=20)
        stop.join()
        place = stopped.value.report["place"]
        assert 0 < place < stopped.value.report["steps"]
        wait_until(cell, lambda: not cell.status().contacts)  # the gate tells now and then
        assert unfinished("lab")["place"] == place
        for name in cell.robots:
            cell.reset(name)
        report = robot.run_routine("hold", "point_1", first=place, hold_s=1)
        assert report["end"] == "done"
        assert [run["end"] for run in runs_of("lab")] == ["held", "done"]


NEAR_THE_LEVER = """
title: Go near the lever and back
kinds: [lever]
steps:
  - move_to: approach
  - contact: allow
  - {move_tool: {z_m: 0.05}, speed: 0.1}
  - move_tool: {z_m: 0}
  - contact: forbid
abort:
  - move_tool: {z_m: 0}
  - contact: forbid
"""


def near_the_lever(live_cell, file, first=0):
    """How the run ended, or what went wrong."""
    try:
        with deltaq.connect(live_cell.url) as cell, cell.lease("gr") as robot:
            return robot.run_routine(str(file), "lever_1", first=first)["end"]
    except DeltaqError as error:
        return str(error)


@pytest.mark.nightly
@pytest.mark.deltaq(robot="gr")
@pytest.mark.parametrize("fault", [row for row in CATALOGUE if applies_live(row)], ids=lambda row: row.name)
def test_a_routine_under_a_fault_ends_at_rest_and_goes_on(live_cell, monkeypatch, tmp_path, fault):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    file = tmp_path / "near.yaml"
    file.write_text(NEAR_THE_LEVER, encoding="utf-8")
    name = live_cell.model.description.cell
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(near_the_lever, live_cell, file)
        with deltaq.connect(live_cell.url) as cell:
            contacts = ()
            while not (contacts or running.done()):
                time.sleep(0.2)
                with suppress(DeltaqError):  # the planner in this process may leave no time for the answer
                    contacts = cell.status().contacts
        live_cell.suffer(TimedFault(fault, at_s=live_cell.time_s + 0.3, for_s=1.0))
        live_cell.run(4.0)
        end = running.result(timeout=120)
    (run,) = runs_of(name)
    print(f"\n{fault.name}: {end}")
    live_cell.run(1.0)
    assert run["place"] >= 2, end
    assert end == "done" or live_cell.rested_within(cycles=100)
    assert live_cell.recover()
    if run["end"] != "done":
        assert near_the_lever(live_cell, file, run["place"]) == "done"
    live_cell.run(0.1)
    assert live_cell.kept_clear()
    assert live_cell.kept_limits()
