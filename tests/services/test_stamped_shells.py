"""What the shells stamp: a watched gate decides as it did, and each cycle of a Robot Server has its outcome."""

from pathlib import Path

import numpy as np
import pytest

from deltaq_protocol.guarded import Request, ServerState
from deltaq_protocol.messages import Message, Phase
from deltaq_protocol.stamps import CycleOutcome, Stamps, StampStation, read_stamps
from deltaq_services.outputs import ToTopic
from deltaq_services.robot_server.guarded_link import outcome_of
from deltaq_services.sim.shell import GateStamps
from deltaq_testing.virtual_cell.cell import VirtualCell
from deltaq_testing.virtual_cell.loaded_cell import LoadedCell

CYCLES = 12


@pytest.fixture(scope="module")
def lab() -> LoadedCell:
    return LoadedCell.load("lab")


class StampedCell(VirtualCell):
    """A virtual cell whose gate is stamped as the SIM's shell does it, and that keeps all states."""

    def __init__(self, loaded: LoadedCell, stamps: Stamps | None) -> None:
        super().__init__(loaded)
        self.stamps = None if stamps is None else GateStamps(stamps, self.sim)
        self.server_states: list[ServerState] = []
        self.outputs: list[Message] = []

    def gate_takes(self, message: Message) -> list[ToTopic]:
        if isinstance(message, ServerState) and message.robot == "fr":
            self.server_states.append(message)
        if self.stamps is not None:
            self.stamps.came(message)
        outputs = super().gate_takes(message)
        for output in outputs:
            self.outputs.append(output.message)
            if self.stamps is not None:
                self.stamps.went(output.message)
        return outputs


def driven(loaded: LoadedCell, stamps: Stamps | None) -> StampedCell:
    """The floor robot moves slowly; in one cycle nobody asks, and at the end far too much is asked."""
    stack = StampedCell(loaded, stamps)
    stack.run_until_ready()
    stack.acquire("fr", "test")
    for cycle in range(CYCLES):
        stack.cycle()
        if cycle != 6:
            stack.ask("fr", np.full(6, 1e-4 if cycle < 10 else 1.0))
    stack.cycle()
    return stack


@pytest.mark.long
def test_a_stamping_gate_decides_identically(lab: LoadedCell, tmp_path: Path) -> None:
    stamps = Stamps("sim", ["fr", "gr"], 1000)
    watched, plain = driven(lab, stamps), driven(lab, None)
    assert watched.outputs == plain.outputs
    rows = read_stamps(stamps.write(tmp_path)).rows

    def of(station: StampStation) -> list[list[int]]:
        return rows[rows[:, 0] == station][:, 2:].tolist()

    asked = CYCLES - 1
    requests, begun, decided = (
        of(StampStation.REQUEST_AT_GATE),
        of(StampStation.DECISION_BEGUN),
        of(StampStation.DECIDED),
    )
    assert len(requests) == len(begun) == len(decided) == asked
    assert [row[1] for row in requests] == [row[1] for row in decided] == list(range(1, asked + 1))
    for request, begin, end in zip(requests, begun, decided, strict=True):
        assert request[2] <= begin[2] < end[2]
    assert {row[0] for row in of(StampStation.ADMISSION_OUT)} <= {row[0] for row in decided}


def test_a_heartbeat_and_a_refused_request_are_no_decisions(lab: LoadedCell, tmp_path: Path) -> None:
    stack, stamps = StampedCell(lab, None), Stamps("sim", ["fr", "gr"], 100)
    stack.run_until_ready()
    stack.stamps = GateStamps(stamps, stack.sim)
    stack.gate_takes(Request(robot="fr", cycle=1, lease_epoch=0))
    stack.gate_takes(Request(robot="fr", cycle=1, lease_epoch=1, seq=9, dq=(0.0,) * 5))
    rows = read_stamps(stamps.write(tmp_path)).rows
    assert rows[:, 0].tolist() == [StampStation.REQUEST_AT_GATE]


def test_each_cycle_of_a_robot_server_has_its_outcome(lab: LoadedCell) -> None:
    stack = driven(lab, None)
    states = stack.server_states
    outcomes = [outcome_of(state, last) for last, state in zip([None, *states], states, strict=False)]
    admissions = stack.arms["fr"].server.counters["admissions"]
    assert outcomes.count(CycleOutcome.FRESH) == admissions > 5
    assert CycleOutcome.HELD in outcomes[:3]  # before it was ready
    moving = outcomes[-(CYCLES + 1) :]
    assert moving[7] is CycleOutcome.BRAKED  # nobody had asked
    assert moving[1] is CycleOutcome.FRESH


def test_a_held_robot_and_a_missed_reply_are_distinguished(lab: LoadedCell) -> None:
    state = next(one for one in driven(lab, None).server_states if one.plan.step == 0)
    last = state.model_copy(update={"sequence": state.sequence - 1})
    assert outcome_of(state, last) is CycleOutcome.FRESH
    assert outcome_of(state, state) is CycleOutcome.BRAKED  # the same admission once more is no fresh one
    held = state.model_copy(update={"phase": Phase.HELD})
    assert outcome_of(held, last) is CycleOutcome.HELD
    missed = state.model_copy(update={"counters": state.counters | {"reply_missed": 1}})
    assert outcome_of(missed, last) is CycleOutcome.REPLY_MISSED
    assert outcome_of(missed, missed) is CycleOutcome.BRAKED
