"""A tool that changes, changes the robot: requested by the holder, confirmed by the input, and never guessed.

The whole stack runs in virtual time; `lab-tools` couples four tools to gr.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from deltaq import Gate, GateError
from deltaq_protocol.guarded import Command
from deltaq_protocol.messages import Done, Error, IoReply, IoRequest, Outcome, Phase, ToolRequest
from deltaq_protocol.reasons import ReasonCode
from deltaq_services.sim.core import Sim
from deltaq_testing.recorded import RecordedCell
from deltaq_testing.replay import replay
from deltaq_testing.virtual_cell.cell import VirtualCell
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell
from deltaq_testing.virtual_cell.parts import Process

LOADED = LoadedCell.load("lab-tools")
GR = LOADED.model.robots["gr"]
CHANGE_CYCLES = 40
"""Longer than the emulated changer takes, and shorter than its limit."""
LATE_CYCLES = 220
STILL = np.zeros(9)
REST = 30
"""Cycles after which the drives have caught up."""


class ChangerBench:
    """The cell with a client that holds gr's lease, and never lets it run out."""

    def __init__(self, stack: VirtualCell | None = None) -> None:
        self.stack = stack or VirtualCell(LOADED)
        self.stack.run_until_ready()
        self.stack.acquire("gr", "operator")
        self.cycles(REST)

    @property
    def state(self):
        return self.stack.states["gr"]

    @property
    def krc(self):
        return self.stack.krc_arms["gr"].krc

    @property
    def watched(self) -> set[str]:
        """The tools whose bodies the gate keeps clear."""
        return {
            tool for tool, bodies in GR.tool_bodies.items() if not bodies & self.stack.sim.contacts.absent
        }

    @property
    def moves(self) -> bool:
        """Whether the gate admits a small increment."""
        return self.cycles(3, np.full(9, 1e-5))[-1] is Outcome.ADMITTED

    def cycles(self, count: int, dq: np.ndarray = STILL) -> list[Outcome]:
        outcomes = []
        for _ in range(count):
            self.stack.cycle()
            verdict = self.stack.ask("gr", dq)
            outcomes += [] if verdict is None else [verdict.outcome]
        return outcomes

    def request(self, tool: str, lease: str | None = "own"):
        """Ask for a tool; returns the answer."""
        token = self.stack._stepped["gr"].token if lease == "own" else lease
        answers = self.stack.request(ToolRequest(robot="gr", tool=tool, lease=token))
        self.cycles(1)
        assert len(answers) == 1
        return answers[0]

    def open(self) -> None:
        """Open the changer of the bare robot."""
        assert isinstance(self.request(""), Done)
        self.cycles(CHANGE_CYCLES)

    def couple(self, tool: str) -> None:
        if tool and self.state.coupled == "":
            self.open()
        answer = self.request(tool)
        assert isinstance(answer, Done), answer
        self.cycles(CHANGE_CYCLES)
        assert self.state.coupled == tool


def refused(answer: object, code: ReasonCode, *words: str) -> None:
    assert isinstance(answer, Error), answer
    assert answer.code is code, answer
    for word in words:
        assert word in answer.message, answer.message


def test_a_tool_is_counted_on_from_the_request_and_coupled_when_the_input_confirms_it() -> None:
    bench = ChangerBench()
    assert (bench.state.coupled, bench.watched) == ("", set())
    bare = np.array(bench.state.tool.position)
    refused(bench.request("valve_key"), ReasonCode.NOT_READY, "is closed")
    bench.open()
    assert bench.krc.outputs["tool_changer"]
    assert isinstance(bench.request("valve_key"), Done)
    bench.cycles(5)
    assert (bench.state.coupled, bench.watched) == ("", {"valve_key"}), (
        "not confirmed yet, but it may be there"
    )
    assert bench.cycles(3)[-1] is Outcome.REFUSED, "nothing moves while the tool is in doubt"
    bench.cycles(CHANGE_CYCLES)
    assert (bench.state.coupled, bench.watched) == ("valve_key", {"valve_key"})
    moved = np.array(bench.state.tool.position) - bare
    np.testing.assert_allclose(np.linalg.norm(moved), 0.3 - 0.1185, atol=1e-6)
    assert bench.cycles(3, np.full(9, 1e-5))[-1] is Outcome.ADMITTED
    bench.cycles(REST)
    assert isinstance(bench.request(""), Done)
    bench.cycles(5)
    assert (bench.state.coupled, bench.watched) == ("valve_key", {"valve_key"}), "it may still hang there"
    bench.cycles(CHANGE_CYCLES)
    assert (bench.state.coupled, bench.watched) == ("", set())


def test_requests_that_are_refused() -> None:
    bench = ChangerBench()
    refused(bench.request("valve_key", lease=None), ReasonCode.LEASE_NOT_HELD, "holder of the lease")
    refused(bench.request("valve_key", lease="guessed"), ReasonCode.LEASE_NOT_HELD)
    refused(bench.request("hammer"), ReasonCode.MALFORMED, "'hammer'", "gripper, valve_key")
    answers = bench.stack.request(ToolRequest(robot="fr", tool="gripper"))
    refused(answers[0], ReasonCode.MALFORMED, "fr has no tool changer")
    bench.cycles(5, np.full(9, 1e-4))
    refused(bench.request("valve_key"), ReasonCode.NOT_AT_REST, "gr moves")
    bench.cycles(REST // 2)
    refused(bench.request("valve_key"), ReasonCode.NOT_AT_REST)  # the drives are still catching up
    bench.cycles(2 * REST)
    bench.open()
    assert isinstance(bench.request("valve_key"), Done)
    refused(bench.request(""), ReasonCode.NOT_READY, "has not confirmed")
    bench.cycles(CHANGE_CYCLES)
    refused(bench.request("gripper"), ReasonCode.NOT_READY, "valve_key is coupled; release it first")
    assert bench.state.coupled == "valve_key"


def test_the_changers_output_cannot_be_switched_as_others_can() -> None:
    bench = ChangerBench()
    token = bench.stack._stepped["gr"].token
    (answer,) = bench.stack.request(IoRequest(robot="gr", outputs={"tool_changer": True}, lease=token))
    refused(answer, ReasonCode.NOT_PERMITTED, "tool_changer")
    answers = bench.stack.request(IoRequest(robot="gr", outputs={"gripper": True}, lease=token))
    bench.cycles(10)
    assert isinstance(answers[0], IoReply)
    assert bench.krc.outputs == {"gripper": True, "tool_changer": False}


def test_the_gate_itself_switches_the_changer_by_no_other_command() -> None:
    bench = ChangerBench()
    sim = bench.stack.sim
    cycles = {name: robot.tracker.state.cycle for name, robot in sim.robots.items()}
    fields = {"epoch": sim.epoch, "cycles": cycles, "outputs": {"tool_changer": True}, "tool": "valve_key"}
    for kind, robot in (("io", "gr"), ("io", None), ("tool", None)):
        command = Command(id=sim.newest_id + 1, kind=kind, robot=robot, **fields)
        (answer,) = sim.take(command)
        assert answer.message.code is ReasonCode.NOT_PERMITTED
    assert sim.robots["gr"].orders.outputs == {}
    assert bench.watched == set()


def test_no_tool_is_coupled_while_it_is_not_known_where_another_robot_is() -> None:
    bench = ChangerBench()
    bench.open()
    bench.stack.process(Process.ROBOT_SERVER, "fr").kill()
    sim = bench.stack.process(Process.SIM, "")
    sim.kill()
    sim.start()
    bench.cycles(3 * REST)
    refused(bench.request("valve_key"), ReasonCode.NOT_READY, "does not know where fr is")
    assert bench.watched == set()


def over_a_block(tmp_path: Path, top_m: float) -> ChangerBench:
    """The cell with a block under gr's tool, which points straight down at home."""
    file = tmp_path / "block.yaml"
    x, y, _ = GR.forward(GR.home)[:3, 3].tolist()
    block = (
        f"{{shape: {{kind: box, size_m: [0.3, 0.3, 0.2]}}, pose: {{position_m: [{x}, {y}, {top_m - 0.1}]}}}}"
    )
    file.write_text(f"extends: lab-tools\ncell: block\nstructure:\n  block: {block}\n")
    return ChangerBench(VirtualCell(file))


FACE_M = float(GR.forward(GR.home)[2, 3])


def test_a_tool_that_would_be_too_near_is_refused_with_pair_distance_and_bound(tmp_path: Path) -> None:
    bench = over_a_block(tmp_path, FACE_M - 0.2)
    bench.open()
    answer = bench.request("valve_key")  # 0.185 m long
    refused(answer, ReasonCode.CLEARANCE, "gr/valve_key_fork", "structure/block", "0.0093 m", "0.0500 m")
    assert (bench.state.coupled, bench.watched, bench.krc.outputs["tool_changer"]) == ("", set(), True)
    bench.couple("vibration_sensor")  # 0.095 m long
    near = bench.stack.sim.nearest()
    assert near is not None
    assert near.pair == ("gr/link_6", "gr/link_4") or "gr/vibration_sensor_probe" in near.pair


@pytest.mark.parametrize(("tool", "length_m"), [("", 0.0), ("valve_key", 0.185)])
def test_the_gate_keeps_the_bodies_of_the_coupled_tool_clear_and_no_others(
    tmp_path: Path, tool: str, length_m: float
) -> None:
    bench = over_a_block(tmp_path, FACE_M - 0.4)
    bench.couple(tool)
    down = np.zeros(9)
    down[2] = -0.002
    bench.cycles(300, down)
    room_m = GR.forward(np.array(bench.state.q))[2, 3] - length_m - (FACE_M - 0.4)
    assert 0.05 < room_m < 0.056


def test_a_robot_whose_changer_does_not_confirm_in_time_is_held_by_name() -> None:
    bench = ChangerBench()
    bench.open()
    bench.krc._change_tool = lambda: None  # the emulated changer is stuck
    assert isinstance(bench.request("valve_key"), Done)
    bench.cycles(LATE_CYCLES)
    assert (bench.state.phase, bench.state.reason) == (Phase.HELD, ReasonCode.TOOL_MISMATCH)
    assert (bench.state.coupled, bench.watched) == ("", {"valve_key"}), "it may be half on"
    answers = bench.stack.reset("gr")
    bench.cycles(2)
    refused(answers[0], ReasonCode.CAUSE_STANDS, "tool_locked", "valve_key is locked")
    assert isinstance(bench.request(""), Done)  # the input says so already
    bench.cycles(3)
    bench.stack.reset("gr")
    bench.cycles(5)
    assert (bench.moves, bench.state.coupled, bench.watched) == (True, "", set())


def test_a_late_confirmation_counts_but_the_robot_stays_held() -> None:
    bench = ChangerBench()
    bench.open()
    bench.krc._change_tool = lambda: None
    bench.request("valve_key")
    bench.cycles(LATE_CYCLES)
    bench.krc.set_input("tool_locked", True)
    bench.cycles(3)
    assert (bench.state.phase, bench.state.coupled) == (Phase.HELD, "valve_key")
    bench.stack.reset("gr")
    bench.cycles(5)
    assert bench.moves


def test_a_tool_that_falls_off_in_motion_holds_the_robot_and_its_bodies_stay() -> None:
    bench = ChangerBench()
    bench.couple("gripper")
    bench.cycles(5, np.full(9, 1e-4))
    bench.krc.set_input("tool_locked", False)
    bench.cycles(REST)
    assert (bench.state.phase, bench.state.reason) == (Phase.HELD, ReasonCode.TOOL_MISMATCH)
    assert (bench.state.coupled, bench.watched) == ("gripper", {"gripper"})
    refused(bench.request("valve_key"), ReasonCode.NOT_READY, "release it first")
    bench.cycles(REST)
    answers = bench.stack.reset("gr")
    bench.cycles(5)
    refused(answers[0], ReasonCode.CAUSE_STANDS, "tool_locked")
    bench.request("")  # it lies on the floor: nothing is coupled
    bench.cycles(REST)
    bench.stack.reset("gr")
    bench.cycles(5)
    assert (bench.moves, bench.state.coupled) == (True, "")


def test_a_tool_that_nobody_asked_for_is_unknown_until_it_is_named() -> None:
    bench = ChangerBench()
    bench.krc.set_input("tool_locked", True)
    bench.cycles(REST)
    assert (bench.state.phase, bench.state.reason) == (Phase.HELD, ReasonCode.TOOL_MISMATCH)
    assert (bench.state.coupled, bench.watched) == (None, set(GR.tool_bodies))
    answers = bench.stack.reset("gr")
    bench.cycles(2)
    refused(answers[0], ReasonCode.CAUSE_STANDS, "not known")
    bench.couple("camera_head")
    bench.stack.reset("gr")
    bench.cycles(5)
    assert (bench.moves, bench.watched) == (True, {"camera_head"})


@pytest.mark.parametrize("process", [Process.SIM, Process.HLI, Process.ROBOT_SERVER])
def test_every_process_knows_the_tool_again_after_a_restart(process: Process) -> None:
    bench = ChangerBench()
    bench.couple("valve_key")
    bench.stack.process(process, "gr").kill()
    for _ in range(10):
        bench.stack.cycle()
    bench.stack.process(process, "gr").start()
    for _ in range(300):
        bench.stack.cycle()
    assert (bench.state.coupled, bench.watched) == ("valve_key", {"valve_key"})
    assert bench.krc.inputs["tool_locked"], "no restart may drop a tool"


def test_without_gate_and_robot_server_the_tool_is_unknown_and_nothing_moves() -> None:
    bench = ChangerBench()
    bench.couple("valve_key")
    both = [bench.stack.process(which, "gr") for which in (Process.SIM, Process.ROBOT_SERVER)]
    for each in both:
        each.kill()
    bench.stack.cycle()
    for each in both:
        each.start()
    for _ in range(300):
        bench.stack.cycle()
    assert (bench.state.coupled, bench.watched) == (None, set(GR.tool_bodies))
    assert bench.krc.inputs["tool_locked"]
    bench.stack.acquire("gr", "operator")
    answers = bench.stack.reset("gr")
    bench.cycles(3)
    if bench.state.phase is Phase.HELD:
        refused(answers[0], ReasonCode.CAUSE_STANDS, "not known")
    assert Outcome.ADMITTED not in bench.cycles(20, np.full(9, 1e-5))
    bench.couple("valve_key")
    bench.stack.reset("gr")
    bench.cycles(5)
    assert bench.cycles(20, np.full(9, 1e-5))[-1] is Outcome.ADMITTED


def test_a_gate_that_ends_during_a_change_leaves_no_tool_that_the_next_one_overlooks() -> None:
    bench = ChangerBench()
    bench.open()
    bench.request("valve_key")
    bench.cycles(3)
    bench.stack.process(Process.SIM, "").kill()
    for _ in range(CHANGE_CYCLES):
        bench.stack.cycle()
    assert bench.krc.inputs["tool_locked"]
    bench.stack.process(Process.SIM, "").start()
    for _ in range(50):
        bench.stack.cycle()
    assert (bench.state.coupled, bench.watched) == (None, set(GR.tool_bodies))


def test_a_recorded_change_replays_bit_for_bit(tmp_path: Path) -> None:
    file = tmp_path / "change.mcap"
    stack = RecordedCell("lab-tools", None, file)
    bench = ChangerBench(stack)
    bench.couple("valve_key")
    bench.cycles(10, np.full(9, 1e-4))
    bench.krc.set_input("tool_locked", False)
    bench.cycles(10)
    stack.writer.close()
    result = replay(file)
    assert result.good, result
    assert result.messages > 300


def test_a_snapshot_restores_the_tool_in_the_middle_of_a_change() -> None:
    bench = ChangerBench()
    bench.open()
    bench.request("valve_key")
    bench.cycles(2)
    other = Sim(LOADED.model, 77)
    other.restore(bench.stack.sim.snapshot())
    assert other.snapshot() == bench.stack.sim.snapshot()
    assert other.contacts.absent == bench.stack.sim.contacts.absent
    assert (other._proximity._active == bench.stack.sim._proximity._active).all()


def test_an_allowed_contact_and_an_absent_tool_do_not_disturb_one_another() -> None:
    bench = ChangerBench()
    contacts, active = bench.stack.sim.contacts, bench.stack.sim._proximity._active
    before = active.copy()
    contacts.switch("changer_in_stands", True)
    assert active.sum() < before.sum()
    bench.couple("valve_key")
    contacts.switch("changer_in_stands", False)
    with_key = active.sum()
    assert with_key > before.sum()
    bench.couple("")
    assert (active == before).all()


def test_the_other_robot_keeps_clear_of_a_tool_that_may_be_there() -> None:
    between = ChangerBench().stack.sim._proximity.between.values()
    named = {body.name for groups in between for group in groups for pair in group.pairs for body in pair}
    assert set().union(*GR.tool_bodies.values()) <= named


def test_the_gate_alone_counts_on_the_tools_that_it_is_given() -> None:
    gate = Gate.from_cell("lab-tools", tools={"gr": "valve_key"})
    step = gate.step({"gr": np.full(9, 1e-5)})["gr"]
    assert step.verdict.outcome is Outcome.ADMITTED
    with pytest.raises(GateError, match=r"tools\.gr: must be one of gripper, .*, got hammer"):
        Gate.from_cell("lab-tools", tools={"gr": "hammer"})
