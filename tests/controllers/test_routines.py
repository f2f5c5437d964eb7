"""Routines: what is refused before anything moves, what the interpreter does, and runs in the lab in virtual time."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from virtual_routine import VirtualRoutine

from deltaq_cell.cell_model import CellModel
from deltaq_controllers.interface import RobotView, View
from deltaq_controllers.routines.planner import (
    PlanRequest,
    RoutinePlanner,
    ToolPlace,
    WorkFrame,
    lines_after,
    unreachable,
)
from deltaq_controllers.routines.routine import RoutineError, job_for, load_routine, shipped
from deltaq_controllers.routines.run import (
    AllowRequest,
    LookRequest,
    RoutineRun,
    RunEnd,
    SeenCycle,
    SwitchRequest,
    sight_of_equipment,
)
from deltaq_controllers.routines.shell import record_file, runs_of, unfinished
from deltaq_protocol.messages import Sight, ViewTarget

LAB = CellModel.load("lab")
GR = LAB.robots["gr"]


def job(routine: str | Path, equipment: str = "", **numbers: float):
    return job_for(LAB.description, routine, equipment, **numbers)


def written(folder: Path, steps: str, kinds: str = "[]") -> Path:
    file = folder / "mine.yaml"
    file.write_text(f"title: mine\nkinds: {kinds}\nsteps:\n{steps}\n", encoding="utf-8")
    return file


@pytest.mark.parametrize(
    ("routine", "equipment", "numbers", "message"),
    [
        ("trun", "valve_1", {}, "no routine 'trun'; there are .*did you mean 'turn'"),
        ("turn", "valve_2", {}, "no equipment 'valve_2' in cell lab; for turn it has valve_1, valve_3"),
        ("turn", "gauge_1", {}, "turn is for valve, and gauge_1 is a gauge"),
        ("park", "valve_1", {}, "park is done without equipment"),
        ("turn", "valve_1", {"quarter_turn": 1}, "no parameter 'quarter_turn'.*did you mean 'quarter_turns'"),
        ("turn", "valve_1", {"quarter_turns": 9}, "quarter_turns: 9 is more than the valve has, 8"),
        ("turn", "valve_1", {"quarter_turns": 0.5}, "quarter_turns: 0.5 is no whole number"),
        ("turn", "valve_1", {"quarter_turns": math.nan}, "quarter_turns: nan is not from -40 to 40"),
        ("hold", "point_1", {"hold_s": 601}, "hold_s: 601 is not from 0 to 600"),
    ],
)
def test_a_wrong_request_names_what_there_is(routine, equipment, numbers, message) -> None:
    with pytest.raises(RoutineError, match=message):
        job(routine, equipment, **numbers)


@pytest.mark.parametrize(
    ("steps", "message"),
    [
        (
            "  - move_too: approach",
            r"mine.yaml:4: steps.0.move_too: not a field here; did you mean 'move_tool'",
        ),
        ("  - {move_to: home, io: {gripper: true}}", "mine.yaml:4: steps.0: a step does one of move_to"),
        ("  - {wait_for: {for_s: .nan}}", "mine.yaml:4: steps.0.wait_for.for_s"),
        ("  - {move_to: home, within_s: 0}", "steps.0.within_s.*greater than 0"),
        ("  - {move_to: home, within_s: .inf}", "steps.0.within_s"),
        ("  - {move_to: approach}", "move_to approach: the equipment has no approach pose"),
        ("  - {move_to: [0, 0]}", "gr has 9 joints, got 2"),
        ("  - {move_to: [9, 0, 0, 0, 0, 0, 0, 0, 0]}", "e1 at 9 is not from 0 to 1.54"),
        ("  - {io: {griper: true}}", "gr has no output 'griper'; it has gripper, tool_changer"),
        ("  - {wait_for: {inputs: {door: true}}}", "gr has no input 'door'"),
        ("  - {wait_for: {for_s: hold_s}}", "'hold_s' is no number"),
        ("  - {look: equipment}", "there is no equipment to look at"),
        ("  - {repeat: 5000, steps: [{move_to: home}]}", "repeat 5000 is not from -1000 to 1000"),
        (
            "  - {repeat: 900, steps: [{repeat: -900, steps: [{move_to: home}]}]}",
            "more than 1000 steps, repetitions included",
        ),
    ],
)
def test_an_unsound_routine_is_refused_with_its_place(tmp_path: Path, steps: str, message: str) -> None:
    with pytest.raises(RoutineError, match=message):
        job(written(tmp_path, steps))


def test_every_shipped_routine_says_what_it_is_for_and_the_lab_reaches_all_its_equipment() -> None:
    assert set(shipped()) == {
        "fetch_tool",
        "hold",
        "look_at",
        "park",
        "press",
        "put_tool",
        "read_gauge",
        "turn",
    }
    assert all(load_routine(name)[1].title for name in shipped())
    assert unreachable(LAB) == {}


def test_an_approach_out_of_reach_and_one_in_a_body_are_named() -> None:
    item = LAB.description.equipment["valve_3"]
    for position_m, why in (((-0.4, -2.34, 3.9), "out of reach"), ((-0.4, -2.34, 1.3), "too near")):
        assert item.approach is not None
        moved = item.model_copy(
            update={"approach": item.approach.model_copy(update={"position_m": position_m})}
        )
        cell = replace(LAB, description=LAB.description.model_copy(update={"equipment": {"valve_3": moved}}))
        assert why in unreachable(cell)["valve_3"]


def test_a_place_of_the_tool_turns_about_the_spindle_and_comes_back() -> None:
    frame = WorkFrame(LAB, LAB.description.equipment["valve_1"])
    place = ToolPlace(0.01, -0.02, 0.05, np.deg2rad(70.0))
    assert frame.place(frame.pose(place)) == pytest.approx(place) or np.allclose(
        [*vars(frame.place(frame.pose(place))).values()], [*vars(place).values()], atol=1e-9
    )
    straight, turned = (frame.pose(ToolPlace(z_m=0.1, turn_rad=turn)) for turn in (0.0, 1.0))
    # the tool is on the spindle's axis: turning moves nothing but its orientation
    np.testing.assert_allclose(straight[:3, 3], turned[:3, 3], atol=1e-9)


def test_lines_at_the_equipment_are_straight_keep_off_other_bodies_and_touch_only_when_they_may() -> None:
    turn = job("turn", "valve_3")
    planner = RoutinePlanner(LAB, turn)
    to = next(i for i, plain in enumerate(turn.steps) if plain.step.move_to is not None)
    ahead = lines_after(turn.steps, to, touching=False)
    q = planner.plan(PlanRequest(turn.steps[to], GR.home, False, ahead), {}).path[-1]
    line = next(plain for plain in turn.steps if plain.step.move_tool is not None)
    with pytest.raises(RoutineError, match=r"gr/tool_finger_\d would be .* from structure/wheel_3"):
        planner.plan(PlanRequest(line, q, touching=False), {})
    path = planner.plan(PlanRequest(line, q, touching=True), {}).path
    tips = np.array([GR.forward(at)[:3, 3] for at in path])
    assert np.ptp(tips[:, :2], axis=0).max() < 1e-6
    assert tips[0, 2] - tips[-1, 2] == pytest.approx(0.14, abs=1e-6)


# The interpreter by itself: no cell, no clock.


class Bench:
    """A run whose robot stands still; `go` lets it see some cycles and answers nothing."""

    def __init__(self, file: Path, equipment: str = "", first: int = 0) -> None:
        self.run = RoutineRun(job(file, equipment), GR, 0.204, 0.012, first)
        self.cycle, self.q, self.seen = 0, GR.home.copy(), {}

    def go(self, cycles: int = 1, q=None):
        out = None
        for _ in range(cycles):
            self.cycle += 1
            own = RobotView(self.cycle, 0.012 * self.cycle, self.q if q is None else q, self.q)
            out = self.run.advance(SeenCycle(View(own), is_still=True, **self.seen))
            if out is not None:
                break
        return out


def test_requests_are_made_one_after_the_other_and_each_outcome_is_told(tmp_path: Path) -> None:
    bench = Bench(
        written(
            tmp_path, "  - io: {gripper: true}\n  - look: equipment\n  - wait_for: {for_s: 1}", "[gauge]"
        ),
        "gauge_1",
    )
    assert bench.go() == SwitchRequest({"gripper": True})
    assert bench.go(50) is None  # not asked twice
    bench.run.take({})
    assert bench.go(2) == LookRequest(True)
    bench.run.take(None)
    assert bench.go(80) is None
    assert bench.run.end is None
    bench.go(20)
    assert bench.run.end is RunEnd.DONE
    assert [outcome.text for outcome in bench.run.outcomes] == [
        "io gripper on",
        "look equipment",
        "wait_for for_s 1",
    ]
    assert bench.run.outcomes[-1].seconds == pytest.approx(1.0, abs=0.05)


def test_a_time_limit_ends_the_run_with_its_step_and_a_pause_does_not_count(tmp_path: Path) -> None:
    bench = Bench(written(tmp_path, "  - {wait_for: {sight: fresh}, within_s: 1}"))
    bench.seen = {"sight": Sight.HIDDEN}
    bench.go(40)
    bench.run.pause()
    bench.go(400)
    assert bench.run.end is None
    bench.run.pause(False)
    bench.go(60)
    assert bench.run.end is RunEnd.FAILED
    assert bench.run.why == (
        "step 1 of 1, wait_for sight fresh: took longer than its limit, 1 s (the camera's sight is view_hidden)"
    )


def test_equipment_counts_as_seen_from_another_distance_while_it_is_in_the_picture() -> None:
    fr, missed = LAB.robots["fr"], Sight.OUT_OF_REACH
    T_world_camera = fr.camera_pose(fr.home)
    for angle_deg, seen in ((20.0, Sight.FRESH), (25.0, missed)):
        aside = 3.0 * math.tan(math.radians(angle_deg))
        x, y, z, _ = (T_world_camera @ (0.0, aside, 3.0, 1.0)).tolist()
        target = ViewTarget(focus_m=(x, y, z))
        assert sight_of_equipment(fr, fr.home, missed, target) is seen
        assert sight_of_equipment(fr, fr.home, Sight.HIDDEN, target) is Sight.HIDDEN
    assert sight_of_equipment(fr, fr.home, Sight.FRESH, ViewTarget(leader="gr")) is None


def test_a_request_that_is_refused_fails_its_step(tmp_path: Path) -> None:
    bench = Bench(written(tmp_path, "  - io: {gripper: true}"))
    bench.go()
    bench.run.take(RoutineError("not_permitted: needs the operator's token"))
    bench.go(3)
    assert (bench.run.end, bench.run.place) == (RunEnd.FAILED, 0)
    assert "not_permitted" in bench.run.why


def test_a_hold_ends_the_run_and_another_takes_it_up_with_the_contact_that_was_allowed(
    tmp_path: Path,
) -> None:
    steps = "  - contact: allow\n  - wait_for: {for_s: 5}\n  - contact: forbid"
    bench = Bench(written(tmp_path, steps, "[valve]"), "valve_1")
    assert bench.go() == AllowRequest("gripper_on_valves", True)
    bench.run.take(None)
    bench.go(10)
    bench.seen = {"held": "stopped"}
    bench.go()
    assert (bench.run.end, bench.run.place, bench.run.contact_allowed) == (RunEnd.HELD, 1, True)
    again = Bench(tmp_path / "mine.yaml", "valve_1", first=bench.run.place)
    assert again.go() == AllowRequest("gripper_on_valves", True)
    again.run.take(None)
    assert again.go(450) == AllowRequest("gripper_on_valves", False)


def test_giving_up_does_the_steps_that_make_it_safe(tmp_path: Path) -> None:
    file = written(tmp_path, "  - wait_for: {for_s: 60}")
    file.write_text(file.read_text() + "abort:\n  - io: {gripper: false}\n")
    bench = Bench(file)
    bench.go(5)
    bench.run.abort()
    assert bench.go(3) == SwitchRequest({"gripper": False})
    bench.run.take({})
    bench.go(2)
    assert bench.run.end is RunEnd.ABORTED
    assert [outcome.end for outcome in bench.run.outcomes] == [RunEnd.ABORTED, RunEnd.DONE]


def test_a_drive_that_stays_behind_its_setpoints_is_an_end_stop_and_a_lagging_one_is_not(
    tmp_path: Path,
) -> None:
    bench = Bench(written(tmp_path, "  - {wait_for: {drive_lag: 0.7}}"))
    tolerance = GR.description.tracking_tolerance
    for _ in range(60):  # moving, measured as late as its drives are
        bench.q = bench.q + 0.2 * tolerance
        bench.go(q=bench.q - 2.0 * tolerance)
    assert bench.run.end is None
    stood = bench.q - 2.0 * tolerance
    for _ in range(30):
        bench.q = bench.q + 0.2 * tolerance
        bench.go(q=stood)
    assert bench.run.end is RunEnd.DONE


def test_repetitions_turn_the_way_that_is_asked_for() -> None:
    turns = [plain.step.move_tool.turn_deg for plain in job("turn", "valve_1", quarter_turns=-2).steps
             if plain.step.move_tool is not None and plain.step.move_tool.turn_deg]  # fmt: skip
    assert turns == [-90.0, -90.0]


# Whole runs in virtual time.


def test_a_valve_is_turned_in_the_lab_and_nothing_else_is_touched() -> None:
    lab = VirtualRoutine()
    run, record = lab.run(job("turn", "valve_1"))
    assert run.end is RunEnd.DONE
    assert record.room_m > 0.0
    assert record.touched
    assert not lab.contacts


def test_a_stop_half_way_ends_held_and_the_rest_is_done_after_a_reset() -> None:
    lab = VirtualRoutine()
    hold = job("hold", "point_1")
    index = next(i for i, plain in enumerate(hold.steps) if plain.step.move_tool is not None)

    def stop(run: RoutineRun, _cycle: int) -> None:
        if run.place == index and run.done > 0.5:
            lab.stack.stop()

    run, _ = lab.run(hold, each=stop)
    assert (run.end, run.place) == (RunEnd.HELD, index)
    assert "operator_stop" in run.why
    lab.reset("gr")
    rest, record = lab.run(hold, first=run.place)
    assert rest.end is RunEnd.DONE
    assert record.room_m > 0.0


def test_an_aborted_routine_backs_out_and_forbids_the_contact() -> None:
    lab = VirtualRoutine()
    press = job("press", "lever_1")

    def give_up(run: RoutineRun, _cycle: int) -> None:
        if run.present is not None and run.present.step.wait_for is not None:
            run.abort()

    run, record = lab.run(press, each=give_up)
    assert run.end is RunEnd.ABORTED
    assert not lab.contacts
    assert record.room_m > 0.0
    at = GR.forward(np.array(lab.stack.states["gr"].q))[2, 3]
    assert at == pytest.approx(0.58, abs=1e-3)


def test_a_record_with_lines_that_are_no_run_gives_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert runs_of("lab") == []
    run = dict.fromkeys(("time", "routine", "source", "equipment", "numbers", "end", "why"), "")
    run |= {"robot": "gr", "place": 2, "steps": 5}
    file = record_file("lab")
    file.parent.mkdir()
    torn = json.dumps(run)[:30].encode()
    file.write_bytes(b"\n".join([b"\xff", b"[]", b"{}", json.dumps(run).encode(), torn]))
    assert runs_of("lab") == [run]
    assert unfinished("lab", "gr") == run
