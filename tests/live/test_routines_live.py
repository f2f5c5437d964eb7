"""A routine on a cell of real processes: stopped half-way, reset, and gone on with from Python."""

import threading

import pytest

import deltaq
from deltaq_controllers.routines.routine import RoutineError
from deltaq_controllers.routines.shell import runs_of, unfinished

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
